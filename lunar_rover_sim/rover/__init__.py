"""The rover: one description, from which MJCF, URDF, meshes and sensor mounts are made."""
