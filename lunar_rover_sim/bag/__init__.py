"""rosbag2 files without ROS: write, read, recover, content hash."""
