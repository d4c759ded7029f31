"""What a rover sees: light, cameras, the renderer, stereo matching, LiDAR."""
