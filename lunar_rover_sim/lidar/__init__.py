"""What a LiDAR or time-of-flight camera is: beams, ray casting on the world, returns, scans."""
