"""rosbag2 files without ROS: writing, reading, recovery, content hash."""
