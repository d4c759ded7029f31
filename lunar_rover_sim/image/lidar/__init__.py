"""LiDAR and time-of-flight cameras: beams, ray casting on the world, returns, scans."""
