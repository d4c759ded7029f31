"""Craters drawn into ground that a test has made."""

import scipy.ndimage

from lunar_rover_sim.ground.world import stamping
from lunar_rover_sim.ground.world.config import CraterConfig
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.spline import Area


def stamp(ground: Area, craters: Craters, config: CraterConfig) -> None:
    """Draw craters into heights; planes are fitted to the heights, smoothed."""
    ratio, smooth = stamping.COARSER, ground.values
    for _ in range(2):
        smooth = scipy.ndimage.uniform_filter(smooth, ratio + 1, mode='nearest')
    first = [-(-f // ratio) for f in ground.first]
    start = [ratio * c - f for c, f in zip(first, ground.first)]
    coarse = Area(smooth[start[1]::ratio, start[0]::ratio].copy(), (first[0], first[1]),
                  ratio * ground.cell_m)
    stamping.stamp(ground, craters, config, coarse)
