"""The walk: MuJoCo simulation, contacts, IMU truth and IMU noise."""
