"""The texture units of the scene: each texture is always bound to the same one."""

TILE_A, OBJECT_DEPTH, ROVER_SHADOW, LAMP_DEPTH, ROVER_OWN = range(5)
