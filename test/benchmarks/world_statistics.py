"""Slopes, craters, rocks and albedo of ten worlds of scenarios: `world_statistics.py OUT NAME...`.

Seeds 1 to 10; OUT is JSON, a list of ten for each scenario.
"""

from __future__ import annotations

import json
import pathlib
import sys

import numpy as np

from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.shade import rms_slope_deg
from lunar_rover_sim.run.scenario import Scenario


def statistics(world: World) -> dict[str, float]:
    """Return the figures of one world."""
    row: dict[str, float] = {}
    for baseline in (0.025, 0.05, 0.1, 0.3, 1.0, 3.0):
        row[f'slope_{baseline:g}m_deg'] = rms_slope_deg(world.ground, baseline)
    for baseline in (17.6, 70.4):
        row[f'slope_{baseline:g}m_deg'] = rms_slope_deg(world.levels[-1], baseline)
    place = np.abs(world.craters.position_m).max(axis=1, initial=0.0)
    for low, half in ((0.15, 25.6), (0.5, 25.6), (2.0, 200.0), (15.0, 1000.0)):
        large = (world.craters.diameter_m >= low) & (place <= half)
        row[f'craters_above_{low:g}m'] = int(large.sum())
    for low in (0.03, 0.1, 0.3):
        row[f'rocks_above_{low:g}m'] = int((world.rocks.diameter_m >= low).sum())
    row['albedo_mean'] = float(world.albedo.mean(dtype=float))
    row['albedo_rms'] = float(world.albedo.std(dtype=float))
    return row


if __name__ == '__main__':
    result = {name: [statistics(build_world(Scenario.load(name).world, seed))
                     for seed in range(1, 11)] for name in sys.argv[2:]}
    pathlib.Path(sys.argv[1]).write_text(json.dumps(result, indent=1))
