"""rosbag2 files: write, read, hash, check, preview; needs no ROS at run time."""
