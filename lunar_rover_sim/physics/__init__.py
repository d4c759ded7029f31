"""The walk: MuJoCo model, contact, simulation, and the IMU with its noise."""
