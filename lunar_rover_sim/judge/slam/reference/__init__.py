"""A compact stereo and mono visual odometry: a reference that every machine has."""
