"""What the rover is: one description that makes MJCF, URDF, meshes and sensor mounts."""
