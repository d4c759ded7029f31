"""What the rover is: one description that makes the MJCF and the URDF."""
