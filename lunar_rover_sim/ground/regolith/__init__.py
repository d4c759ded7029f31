"""Ground that gives: soils, the forces they bear, and the tracks that stay in them."""
