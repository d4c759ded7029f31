"""The world: relief, craters, rocks and albedo, in one folder for physics and camera."""
