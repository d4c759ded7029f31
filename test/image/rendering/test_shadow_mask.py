"""The shadow mask is that of the picture: grid, rocks, rover, and relief below the grid."""

from collections.abc import Iterator
import dataclasses

import camera_scene as scene
import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.frame import RIGHT_TRUTH, StereoFrame
from lunar_rover_sim.image.rendering.labels import LABEL_GROUND
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

WIDTH, HEIGHT = 160, 120
FINER = 4
EXPOSURE_S = 2e-3       # the median of near ground across the sun is at 206 of 255
PICTURE = ('left', 'right', 'depth', 'radiance')
# Across the sun, and away from it with the shadow of the rover ahead.
STATES = [RoverPose(scene.pose(0.4, -0.3, 0.25, 110.0)),
          RoverPose(scene.pose(-1.0, 0.5, 0.25, 200.0))]


def renderer_of(times: int = 1, samples: int = 1, **groups) -> Renderer:
    """Return a renderer with relief and without noise or stray light; times: the pixels of it."""
    sensor = dataclasses.replace(scene.IDEAL, exposure_mode='fixed', exposure_s=EXPOSURE_S)
    return Renderer(worlds.small(), scene.ROVER, scene.config(
        sun=scene.RELIEF_SUN, camera=CameraConfig(width=WIDTH * times, height=HEIGHT * times),
        detail=DetailConfig(supersampling=samples), sensor=sensor,
        lens=LensConfig(scatter_share=0.0, veil_share=0.0), **groups))


@pytest.fixture(scope='module')
def renderer() -> Iterator[Renderer]:
    """Return a renderer for pictures of 320 by 240."""
    with renderer_of(2) as drawn:
        yield drawn


def near(frame: StereoFrame, reach_m: float = 3.0) -> Array:
    """Return where ground nearer than `reach_m` is seen."""
    assert frame.depth_m is not None
    return (frame.label == LABEL_GROUND) & (frame.depth_m < reach_m)


def seen(frame: StereoFrame) -> Array:
    """Return the (h, w) share of the sun that the mask has."""
    assert frame.shadow is not None
    return frame.shadow[..., 0] / 255.0


@pytest.mark.parametrize('state', STATES)
def test_black_ground_is_in_shadow(renderer: Renderer, state: RoverPose) -> None:
    """Black pixels near the camera, and only they, are in the shadow of the mask.

    Lit ground has less than a tenth of white only where the sun grazes its slope. Without the
    relief below the grid, 3 % and 72 % of the black pixels would be dark in the mask.
    """
    frame = renderer.render(state, 0, (*PICTURE, 'label', 'shadow'))
    assert frame.left is not None and frame.radiance is not None
    share, ground = seen(frame), near(frame)
    black, dark = ground & (frame.left < 25), ground & (share < 0.02)
    assert black.sum() > 2000 and dark.sum() > 2000
    assert (share[black] < 0.5).mean() > 0.993 and (share[black] < 0.1).mean() > 0.95
    lit = np.median(frame.radiance[ground & (share > 0.9)])
    assert (frame.radiance[dark] > 0.1 * lit).mean() < 0.03


@pytest.mark.parametrize('state', STATES)
def test_mask_is_the_mean_of_a_finer_one(renderer: Renderer, state: RoverPose) -> None:
    """Of 16 times the pixels, in the mean over near ground, and pixel by pixel."""
    with renderer_of() as coarse, renderer_of(FINER) as fine:
        frame, other = (drawn.render(state, 0, ('depth', 'label', 'shadow'))
                        for drawn in (coarse, fine))
    blocks = (HEIGHT, FINER, WIDTH, FINER)
    mean = seen(other).reshape(blocks).mean(axis=(1, 3))
    ground = near(frame) & near(other).reshape(blocks).all(axis=(1, 3))
    apart = (seen(frame) - mean)[ground]
    assert 0.5 < mean[ground].mean() < 0.9 and ground.sum() > 5000
    assert abs(apart.mean()) < 0.06 and np.sqrt(np.mean(apart**2)) < 0.16


@pytest.mark.parametrize('samples', [1, 2])
def test_picture_does_not_depend_on_the_mask(samples: int) -> None:
    """Ground with relief and tracks, rocks, the rover's shadow: the same bit by bit."""
    with renderer_of(samples=samples) as drawn:
        drawn.follow(scene.trodden(drawn.world))
        for state in (RoverPose(scene.pose()), *STATES):
            alone = drawn.render(state, 0, PICTURE)
            for more in (('shadow',), ('right_shadow',), ('label', 'shadow', *RIGHT_TRUTH)):
                beside = drawn.render(state, 0, (*PICTURE, *more))
                for name in PICTURE:
                    np.testing.assert_array_equal(beside.layer(name), alone.layer(name), name)


def test_mask_needs_no_picture(renderer: Renderer) -> None:
    """It is the same alone, of either camera, and beside pictures."""
    for state in STATES:
        both = renderer.render(state, 0, (*PICTURE, 'label', 'shadow', 'right_shadow'))
        for name in ('shadow', 'right_shadow'):
            alone = renderer.render(state, 0, (name,))
            assert alone.label is None and alone.left is None
            np.testing.assert_array_equal(alone.layer(name), both.layer(name))


def test_no_sun_lights_nothing() -> None:
    """Where the sun does not shine, none of it is seen."""
    world = scene.plane(257, heights=scene.hills(257))
    dark = scene.SunConfig(elevation_deg=6.0, irradiance=0.0)
    with Renderer(world, scene.ROVER, scene.config(sun=dark)) as drawn:
        frame = drawn.render(STATES[0], 0, ('label', 'shadow'))
    assert frame.shadow is not None and (frame.label == LABEL_GROUND).any()
    assert not frame.shadow.any()
