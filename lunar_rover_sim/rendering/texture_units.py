"""The texture units of the scene: each texture is always bound to the same one."""

(HEIGHTS, GROUND, MATTER, TILE_A, TILE_B, GROUND_DEPTH, ROVER_SHADOW, LAMP_DEPTH,
 RELIEF_FACTOR) = range(9)
PRINTS, SOIL, FAR_PRINTS, TOUCHED, CUT = range(9, 14)
CRATER_CELLS, CRATER_LIST = range(14, 16)
ROVER_OWN = 16
BASE, RELIEF, SHAPE_A, SHAPE_B = range(17, 21)
