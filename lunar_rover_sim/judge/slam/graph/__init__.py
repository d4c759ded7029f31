"""A stereo odometry with a memory: a graph of keyframes, closed by loops, with covariances."""
