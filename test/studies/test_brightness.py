"""One brightness: drawn ground has the mean radiance of Hapke's law at every distance."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.studies.brightness import brightness, DIRECTIONS_DEG, views

EDGES_M = (0.4, 0.7, 1.2, 2.0, 3.5, 7.0, 20.0)


@pytest.fixture(scope='module', params=['baseline', 'feature_sparse'])
def renderers(request):
    """Return renderers of a level plane with and without the relief of a scenario below the grid.

    `flat` has the same relief as `baseline`.
    """
    detail = dataclasses.replace(Scenario.load(request.param).render_node.detail, bounce=False)
    world, camera = scene.plane(), CameraConfig(width=320, height=240)
    with Renderer(world, scene.ROVER, scene.config(6.0, 60.0, detail=detail,
                                                   camera=camera), 1) as renderer, \
            Renderer(world, scene.ROVER, scene.config(6.0, 60.0, camera=camera)) as plain:
        yield renderer, plain


@pytest.mark.parametrize('elevation_deg', [2.0, 6.0, 15.0])
def test_drawn_ground_is_as_bright_as_the_law(renderers, elevation_deg):
    renderer, plain = renderers
    for each in renderers:
        each.set_sun(60.0, elevation_deg)
    for direction in DIRECTIONS_DEG:
        curve = brightness(renderer, plain, views(renderer, direction), EDGES_M)
        np.testing.assert_allclose(curve.ratio, 1.0, atol=0.1, err_msg=direction)
        assert np.all(curve.shadow < 0.8)


def test_no_haze_in_shadows():
    """Ground 0.9 m inside the shadow of a wall, 9 m away, gets none of the sun."""
    n, cell = 513, 0.05
    heights = np.zeros((n, n), np.float32)
    heights[380:384] = 0.4          # its shadow reaches 3.8 m towards -y at 6 deg
    world = scene.plane(n, cell, heights=heights, far=False)
    with Renderer(world, scene.ROVER, scene.config(6.0, 90.0)) as renderer:
        pose = scene.pose(-9.0, 6.2 - 0.9, 0.1)
        frame = renderer.render(RoverPose(pose), 0, ('radiance', 'depth'))
        lit = renderer.render(RoverPose(scene.pose(-9.0, -3.0, 0.1)), 0, ('radiance', 'depth'))
    middle = slice(310, 330)
    near = (frame.depth_m[:, middle] > 8.0) & (frame.depth_m[:, middle] < 12.0)
    usual = np.median(lit.radiance[:, middle][near])
    assert near.sum() > 50 and np.max(frame.radiance[:, middle][near]) < 0.02 * usual
