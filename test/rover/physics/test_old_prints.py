"""Feet on the walls of old prints: they stand on them, and leave their lean behind."""

import numpy as np
from physics_scene import ROVER, simulate
import pytest

from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.ground.regolith.soil import PRESETS

R = ROVER.legs.tip_radius_m
SOIL = GroundConfig(model='regolith', weak_slopes=False)


def on_walls(simulation, rises):
    """Let a rover down on walls of 31 deg that rise along x (0) or y (1); return its lowest tips.

    They are compacted, 30 mm below the untouched ground where the tips are: they bear.
    """
    model, data = simulation.model, simulation.data
    tips = [geom for geom in range(model.ngeom) if '_tip_' in model.geom(geom).name
            and model.geom(geom).bodyid[0] <= 5 and data.geom_xpos[geom][2] < 2.0 * R]
    assert len(tips) == 4
    data.qpos[2] += 0.05
    data.qvel[:] = 0.0
    simulation.advance(1)
    for geom in tips:
        # 16 cm around each foot; the feet are farther apart.
        first = np.round(data.geom_xpos[geom][:2] / 0.005).astype(int) - 16
        across = (np.arange(33) - 16) * 0.005
        change = np.tile(0.6 * across - 0.03, (33, 1))
        change = change.T if rises else change
        simulation.overlay.put(int(first[0]), int(first[1]), change,
                               -PRESETS['highland'].compacted * change)
    data.qpos[2] -= 0.0637      # a tenth of a millimetre above the walls
    data.qvel[:] = 0.0
    simulation.advance(300)
    return tips


def test_a_tip_stands_on_the_wall_of_an_old_print():
    with simulate(ground=SOIL) as simulation:
        tips = on_walls(simulation, 0)
        cosine = 1.0 / np.hypot(1.0, 0.6)
        for geom in tips:
            x, y, z = simulation.data.geom_xpos[geom]
            above = (z - float(simulation.overlay.height_change([x, y]))) * cosine - R
            assert abs(above) < 0.0005


@pytest.mark.parametrize('rises', [0, 1])
def test_the_lean_of_a_wall_is_left_behind_by_a_tip_that_moves_on(rises):
    """Moved along the wall, 30 mm in the ground, it stands on its own track, which is level."""
    with simulate(ground=SOIL) as simulation:
        on_walls(simulation, rises)
        data = simulation.data

        def leans():
            """Return the slopes of the planes under the tips along x and y, (4, 2)."""
            normal = np.array([matrix_from_wxyz(q)[:, 2] for q in data.mocap_quat])
            return -(normal[:, :2] / normal[:, 2:])[data.mocap_pos[:, 2] > -1.0]

        before = leans()
        assert before.shape == (4, 2)
        assert np.all((0.5 < before[:, rises]) & (before[:, rises] < 0.6))
        np.testing.assert_allclose(before[:, 1 - rises], 0.0, atol=0.02)
        for _ in range(30):
            data.qpos[1 - rises] += 0.001
            data.qvel[:] = 0.0
            simulation.advance(2)
        after = leans()
        assert np.all((0.0 < after[:, rises]) & (after[:, rises] < 0.5 * before[:, rises]))
        np.testing.assert_allclose(after[:, 1 - rises], 0.0, atol=0.05)
