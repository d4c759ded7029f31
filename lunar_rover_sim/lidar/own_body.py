"""Beams that end on the rover that carries the sensor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import MAST_RADIUS_M

_DECK_M = 0.02      # the deck of solar cells and what stands on it, over the chassis
_HEAD_M = 0.02      # half the height of the stereo head
_HEAD_DEPTH_M = 0.04


def hidden_by_body(rover: RoverDescription, T_base_lidar: Array,
                   direction: Array) -> NDArray[np.bool_]:
    """Return which of (n, 3) beams meet the chassis with its deck, the mast, or its head.

    These are taken as boxes, a little larger than they are drawn. Legs, which move, hide nothing.
    """
    origin = T_base_lidar[:3, 3]
    rays = direction @ T_base_lidar[:3, :3].T
    chassis, (x, y, z) = rover.chassis, rover.stereo.position_m
    half = 0.5 * np.array([chassis.length_m, chassis.width_m, chassis.height_m])
    r, wide = MAST_RADIUS_M, 0.5 * rover.stereo.baseline_m + _HEAD_M
    boxes = [(-half, half + [0.0, 0.0, _DECK_M])]
    if z > half[2]:
        boxes += [(np.array([x - r, y - r, half[2]]), np.array([x + r, y + r, z])),
                  (np.array([x - _HEAD_DEPTH_M, y - wide, z - _HEAD_M]),
                   np.array([x, y + wide, z + _HEAD_M]))]
    hidden = np.zeros(len(rays), bool)
    for low, high in boxes:
        with np.errstate(divide='ignore', invalid='ignore'):
            a, b = (low - origin) / rays, (high - origin) / rays
        enter = np.nanmax(np.fmin(a, b), axis=1)
        leave = np.nanmin(np.fmax(a, b), axis=1)
        hidden |= (enter <= leave) & (leave > 0.0)
    return hidden
