"""Draws states for `bench_render.py --against`, in a process of its own for each checkout.

It imports only what old checkouts have as well, wherever they have it.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
import time

import numpy as np

from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario


def main(name, *settings):
    """Draw the states that numbers in lines of stdin name; print ms of CPU for each."""
    states = dict(np.load(sys.stdin.readline().strip()))
    scenario = Scenario.load(name, settings)
    # The ground of another recipe lies higher or lower.
    place = states['T_world_base'][:, :3, 3]
    place[:, 2] = states['clearance_m'] + scenario.load_world().height_at(place[:, :2])
    if hasattr(scenario, 'renderer'):
        made = scenario.renderer()
    else:   # before 1.0
        made = importlib.import_module(
            'lunar_rover_sim.rendering.renderer').Renderer.from_scenario(scenario)
    with made as renderer:
        def draw(k):
            renderer.render(RoverPose(*(states[field.name][k]
                                        for field in dataclasses.fields(RoverPose))), k)
        for k in range(4):      # programs are compiled
            draw(k)
        print('ready', flush=True)
        for line in sys.stdin:
            start = time.process_time()
            draw(int(line))
            print(1e3 * (time.process_time() - start), flush=True)


if __name__ == '__main__':
    main(*sys.argv[1:])
