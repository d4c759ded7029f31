"""The texture units of the scene: each texture is always bound to the same one."""

HEIGHTS, TILE_A, OBJECT_DEPTH, ROVER_SHADOW, LAMP_DEPTH, SOIL, CUT, ROVER_OWN = range(8)
