"""Sequences for SLAM programs: EuRoC, TUM, KITTI, TartanAir, and their settings files."""
