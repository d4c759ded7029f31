"""The rover: one description for MJCF, URDF and meshes; its physics in MuJoCo; its gait."""
