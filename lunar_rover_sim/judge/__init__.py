"""How well it went: trajectories, images and maps against truth, SLAM systems, studies."""
