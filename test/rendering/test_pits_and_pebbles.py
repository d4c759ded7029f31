"""Small craters and pebbles in the picture: dips and bumps, and each with its shadow."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

ELEVATION_DEG = 12.0


def ground(**covers):
    """Return the radiance over the median of level ground with these, before the rover.

    The sun stands behind the upper edge of the image.
    """
    detail = DetailConfig(**{'relief_rms_slope': 0.0, 'pebble_cover': 0.0, 'pit_cover': 0.0,
                             'bounce': False, 'smooth_outlines': False, **covers})
    config = scene.config(ELEVATION_DEG, 0.0, detail=detail, camera=CameraConfig(480, 360, 45.0))
    with Renderer(scene.plane(257, far=False), scene.ROVER, config) as renderer:
        frame = renderer.render(RoverPose(scene.pose(z=0.5, pitch_deg=40.0)), 0, ('radiance',))
    return frame.radiance / np.median(frame.radiance)


def around_shadows(picture, away=3):
    """Return the mean radiance before and behind shadows, seen from the sun, and their share.

    Before and behind are so many pixels beyond their upper and lower edges.
    """
    dark = picture < 0.3
    inner = dark[away + 1:-away - 1]
    first = inner & ~dark[away:-away - 2]
    last = inner & ~dark[away + 2:-away]
    before = picture[1:-2 * away - 1][first]
    behind = picture[2 * away + 1:-1][last]
    return before.mean(), behind.mean(), dark.mean()


def test_level_ground_has_neither_and_rough_ground_has_shadows_too():
    assert np.all(np.abs(ground() - 1.0) < 0.35)
    assert np.mean(ground(relief_rms_slope=0.16) < 0.3) > 0.05


def test_pits_are_lit_on_the_side_away_from_the_sun():
    """The wall towards the sun is in shadow, the one that faces it is bright.

    Most pits are old, too shallow for a shadow: the bright walls of the fresh are soft, too.
    """
    before, behind, share = around_shadows(ground(pit_cover=0.16))
    assert 0.003 < share < 0.1
    assert behind > 1.15 * before and behind > 1.0


def test_pebbles_are_lit_on_the_side_towards_the_sun():
    """They cover half their cover or more, and their shadows are some times as long."""
    before, behind, share = around_shadows(ground(pebble_cover=0.035))
    assert 0.02 < share < 0.2
    assert before > 1.1 * behind and behind == pytest.approx(1.0, abs=0.15)
