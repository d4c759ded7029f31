"""A spoke-leg micro rover on the Moon: MuJoCo walk, photorealistic stereo, rosbag2 record."""

__version__ = '0.1.0'
