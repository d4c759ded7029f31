"""Physics: the MuJoCo model, contact with the ground, the simulation, and the IMU."""
