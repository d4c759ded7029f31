"""Gravity at the surface [m/s^2]."""

MOON_MPS2, EARTH_MPS2 = 1.62, 9.81
