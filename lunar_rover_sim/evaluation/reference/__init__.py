"""A compact stereo and mono visual odometry: a yardstick that every machine has."""
