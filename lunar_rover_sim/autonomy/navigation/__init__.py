"""Navigation: an elevation map of what the rover sees, plans over it, and how it follows them."""
