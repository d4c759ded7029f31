"""Where to go: velocity profiles and waypoint pursuit on odometry."""
