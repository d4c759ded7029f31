"""A start moved by a picometre: the walk on soil stays as near, on any processor."""

import numpy as np
from physics_scene import make_world, rough_heights, simulate, soft, trot
import pytest

from lunar_rover_sim.physics.config import StartPose

MOVED_M = 1e-12


@pytest.mark.parametrize('preset', ['highland', 'highland_loose'])
def test_a_walk_on_untouched_soil_does_not_amplify_rounding(preset):
    """Over hills: 1e-8 m after 5 s is asked; two runs of 3 s are 1e-9 m apart at most here.

    A law that switches between forces is 3 mm off after a quarter of a second.
    """
    world, ends = make_world(rough_heights(3)), []
    for moved in (0.0, MOVED_M):
        with simulate(world, ground=soft(preset), start=StartPose(x_m=0.3, y_m=-0.2)) as walk:
            walk.data.qpos[0] += moved
            ends.append(trot(walk, 3.0).position_m)
    assert np.linalg.norm(ends[0][:2] - [0.3, -0.2]) > 0.2
    assert np.linalg.norm(ends[1] - ends[0]) < 1e-8
