"""What the Moon is: relief, craters, rocks, albedo, in one folder for physics and camera."""
