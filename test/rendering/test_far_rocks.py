"""Rocks beyond the fine ground in the picture: they are there, and as large as they should be."""

import camera_scene as scene
import numpy as np
import pytest
import worlds

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.rendering.labels import LABEL_FIRST_ROCK
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.world.far_rocks import far_rocks

FLAT = {'relief': {'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0}, 'craters': {'density': 0.0}}


@pytest.fixture(scope='module')
def world():
    return worlds.small(**FLAT)


@pytest.fixture(scope='module')
def frame(world):
    """Seen from 8 m above the ground, with the sun in the back."""
    camera = CameraConfig(width=640, height=480)
    config = scene.config(20.0, 180.0, camera=camera)
    pose = scene.pose(z=8.0, pitch_deg=4.0)
    with Renderer(world, scene.ROVER, config) as renderer:
        return renderer.render(RoverPose(pose), layers=('radiance', 'depth', 'label'))


def test_rocks_are_drawn_to_300_m(world, frame):
    rocks = far_rocks(world, 300.0)
    index = frame.label - LABEL_FIRST_ROCK - len(world.rocks)
    seen = np.unique(index[index >= 0])
    away = np.abs(rocks.position_m[seen, :2]).max(axis=1)
    assert np.histogram(away, [6.4, 30.0, 100.0, 200.0, 300.0])[0].min() >= 20
    # The depth is that of the rock.
    for i in seen[::29]:
        depth = np.median(frame.depth_m[index == i])
        assert depth == pytest.approx(rocks.position_m[i, 0], rel=0.1, abs=2.0)


def test_rocks_look_as_large_as_they_are(world, frame):
    """The area of the middle-distance rocks together, from their diameters."""
    rocks = far_rocks(world, 300.0)
    index = frame.label - LABEL_FIRST_ROCK - len(world.rocks)
    pixels = np.bincount(index[index >= 0], minlength=len(rocks))
    depth = rocks.position_m[:, 0]
    chosen = np.flatnonzero((pixels > 0) & (depth > 60.0) & (depth < 150.0))
    focal = CameraConfig().focal_px
    # About 0.6 of a rock's height is above the ground (RockConfig.burial), 0.6 of its width high.
    expected = np.sum((rocks.diameter_m[chosen] * focal / depth[chosen])**2)
    assert len(chosen) > 50
    assert 0.2 < pixels[chosen].sum() / expected < 0.8


def test_shadows_darken_the_ground_beyond_its_edge(world):
    """The same ground with and without far rocks, under a low sun from the side."""
    camera = CameraConfig(width=320, height=240)
    pose = RoverPose(scene.pose(z=8.0, pitch_deg=10.0))
    share = []
    for far_m in (0.0, 300.0):
        detail = scene.DetailConfig(relief_rms_slope=0.0, pebble_cover=0.0, pit_cover=0.0,
                                    bounce=False, far_rocks_m=far_m)
        config = scene.config(5.0, 90.0, camera=camera, detail=detail)
        with Renderer(world, scene.ROVER, config) as renderer:
            frame = renderer.render(pose, layers=('radiance', 'depth', 'label'))
        ground = (frame.label == 1) & (frame.depth_m > 20.0) & (frame.depth_m < 120.0)
        lit = np.percentile(frame.radiance[ground], 90)
        share.append(np.mean(np.clip(1.0 - frame.radiance[ground] / lit, 0.0, 1.0)))
    # Rocks cover 1 % and cast shadows six times as long as they are high.
    assert 0.01 < share[1] - share[0] < 0.15
