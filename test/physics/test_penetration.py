"""Depth of the tips along the normal, on slopes of any direction and far below the surface."""

import mujoco
import numpy as np
from physics_scene import make_world, ROVER, simulate
import pytest

from lunar_rover_sim.frames import matrix_from_wxyz
from lunar_rover_sim.physics.config import StartPose
from lunar_rover_sim.physics.penetration import TipPenetration


def sloping_world(east, north, n=41, cell_m=0.25):
    axis = (np.arange(n) - (n - 1) / 2) * cell_m
    return make_world(east * axis + north * axis[:, None], cell_m)


@pytest.mark.parametrize('east,north', [(0.0, 0.0), (0.3, 0.0), (0.0, -0.3), (0.2, 0.25)])
def test_a_deep_tip_is_measured_square_to_the_slope(east, north):
    """Lowered by a length, a tip goes in by that length times the cosine of the slope.

    The least of the lowered tips is known from geometry: centre and radius against the plane.
    """
    world = sloping_world(east, north)
    cosine = 1.0 / np.sqrt(1.0 + east**2 + north**2)
    with simulate(world, start=StartPose(settle_s=0.0)) as simulation:
        tips, data, model = TipPenetration(simulation, world.ground), simulation.data, \
            simulation.model
        geoms = [g for g in range(model.ngeom) if '_tip_' in model.geom(g).name]
        assert len(geoms) == 12
        for depth in (0.02, 0.05):
            data.qpos[2] -= depth
            mujoco.mj_forward(model, data)
            centre = data.geom_xpos[geoms]
            above = (centre[:, 2] - east * centre[:, 0] - north * centre[:, 1]) * cosine
            expected = ROVER.legs.tip_radius_m - above.min()
            assert expected > 0.8 * depth * cosine
            assert tips.deepest_m() == pytest.approx(expected, abs=1e-4)
            data.qpos[2] += depth


def test_nothing_touched_is_no_depth():
    world = sloping_world(0.0, 0.0)
    with simulate(world) as simulation:
        tips = TipPenetration(simulation, world.ground)
        simulation.data.qpos[2] += 0.5
        mujoco.mj_forward(simulation.model, simulation.data)
        assert simulation.data.ncon == 0 and tips.deepest_m() == 0.0


@pytest.mark.parametrize('east,north', [(0.0, 0.0), (0.25, 0.0), (0.0, 0.25), (-0.15, 0.2)])
@pytest.mark.parametrize('yaw_deg', [0.0, 50.0])
def test_the_rover_starts_square_to_the_slope_just_above_it(east, north, yaw_deg):
    world = sloping_world(east, north)
    with simulate(world, start=StartPose(yaw_deg=yaw_deg, settle_s=0.0)) as simulation:
        state = simulation.state
        rotation = matrix_from_wxyz(state.orientation_wxyz)
        normal = np.array([-east, -north, 1.0]) / np.sqrt(1.0 + east**2 + north**2)
        np.testing.assert_allclose(rotation[:, 2], normal, atol=1e-6)
        heading = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
        assert heading == pytest.approx(yaw_deg, abs=1e-6)
        # All upright spokes are as far from the ground: 1 mm of clearance, and no contact.
        assert simulation.data.ncon == 0 or simulation.data.contact.dist.min() > 0.0
        data, model = simulation.data, simulation.model
        geoms = [g for g in range(model.ngeom) if '_tip_' in model.geom(g).name]
        centre = data.geom_xpos[geoms]
        gap = (centre @ normal) - ROVER.legs.tip_radius_m
        # A millimetre on level ground; on a slope the least that surely touches nothing.
        assert 0.0 < gap.min() < (0.0011 if east == north == 0.0 else 0.006)
        np.testing.assert_allclose(np.sort(gap)[:4], gap.min(), atol=1e-6)
