"""Drawing: OpenGL finds rocks and the rover, compiled loops find the ground and light all."""
