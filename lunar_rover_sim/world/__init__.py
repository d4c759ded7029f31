"""What the Moon is: relief, craters, rocks, albedo, in one folder that physics and camera share."""
