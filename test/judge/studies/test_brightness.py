"""One brightness: that of Hapke's law at every distance, and of finer images."""

import contextlib
import dataclasses

from brightness import brightness, DIRECTIONS_DEG, views
import camera_scene as scene
import numpy as np
import pytest
from resolution import against_finer, finer_camera

from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

SCENARIOS = ('baseline', 'feature_sparse')
SUNS_DEG = (2.0, 6.0, 15.0)
EDGES_M = (0.4, 0.7, 1.2, 2.0, 3.5, 7.0, 20.0)


@pytest.fixture(scope='module')
def planes():
    """Return name → renderer of ground of gentle waves, and a camera of 4 x 4 times the pixels.

    Slopes of 0.8 deg turn to the sun and away from it. The renderer draws the relief of the
    scenario below the grid; the one named `plain` draws none, and has no finer camera. `flat` has
    the same relief as `baseline`.
    """
    axis = (np.arange(513) - 256) * 0.025
    waves = 0.006 * (np.sin(axis / 0.6)[None] + np.sin(axis / 0.6 + 1.0)[:, None])
    inside = np.clip((6.4 - np.abs(axis)) / 1.5, 0.0, 1.0)
    waves *= inside[:, None] * inside
    world, camera = scene.plane(heights=waves), CameraConfig(width=320, height=240)
    with contextlib.ExitStack() as stack:
        result = {'plain': (stack.enter_context(Renderer(
            world, scene.ROVER, scene.config(SUNS_DEG[0], 60.0, camera=camera))), None)}
        for name in SCENARIOS:
            detail = dataclasses.replace(Scenario.load(name).render_node.detail, bounce=False)
            renderer = stack.enter_context(Renderer(world, scene.ROVER, scene.config(
                SUNS_DEG[0], 60.0, detail=detail, camera=camera), 1))
            result[name] = renderer, finer_camera(renderer, 4)
        yield result


@pytest.fixture(scope='module', params=SUNS_DEG)
def sun(planes, request):
    """Set the sun of all."""
    for renderer, _ in planes.values():
        if renderer.config.sun.elevation_deg != request.param:
            renderer.set_sun(60.0, request.param)


@pytest.fixture(params=SCENARIOS)
def renderers(planes, sun, request):
    """Return the renderer of a scenario, the plain one, and the finer camera of the first."""
    renderer, finer = planes[request.param]
    return renderer, planes['plain'][0], finer


@pytest.mark.parametrize('direction', DIRECTIONS_DEG)
def test_drawn_ground_is_as_bright_as_the_law(renderers, direction):
    renderer, plain, _ = renderers
    curve = brightness(renderer, plain, views(renderer, direction), EDGES_M)
    np.testing.assert_allclose(curve.ratio, 1.0, atol=0.1)
    assert np.all(curve.shadow < 0.8)


@pytest.mark.parametrize('direction', DIRECTIONS_DEG)
def test_drawn_ground_is_as_bright_as_in_finer_images(renderers, direction):
    """A pixel is twice as large here as in 640 x 480, where the means agree within 5 %.

    As many pixels are in shadow, within 6 points; within 9 at 1.2 to 2 m, where textures of what
    is seen begin, whose texels are larger than the finer pixels. Few are nearer than 0.7 m.
    """
    renderer, _, finer = renderers
    curve = against_finer(renderer, finer, views(renderer, direction, 1), EDGES_M[1:])
    bright = curve.finer_radiance > 0.3 * curve.law     # otherwise few pixels make the mean
    assert bright.sum() >= 4
    np.testing.assert_allclose(curve.ratio[bright], 1.0, atol=0.08)
    allowed = np.where(np.array(EDGES_M[1:-1]) == 1.2, 0.09, 0.06)
    assert np.all(np.abs(curve.shadow_difference) < allowed)


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
