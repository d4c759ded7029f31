"""Outlines of rocks: no steps, against 8 x 8 times the pixels, and nothing else is touched."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.rendering.frame import LABEL_FIRST_ROCK
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

FINER = 8
WIDTH, HEIGHT = 160, 120


def draw(world, roll_deg, finer=1):
    """Return left radiance and label, with so many pixels per pixel."""
    camera = CameraConfig(width=WIDTH * finer, height=HEIGHT * finer)
    pose = se3(matrix_from_wxyz(wxyz_from_rpy(np.radians(roll_deg), 0.0, 0.0)), (0.0, 0.0, 0.1))
    with Renderer(world, scene.ROVER, scene.config(40.0, 150.0, camera=camera)) as renderer:
        frame = renderer.render(RoverPose(pose), layers=('radiance', 'label'))
    return frame.radiance.astype(float), frame.label


def means(fine):
    return fine.reshape(HEIGHT, FINER, WIDTH, FINER).mean((1, 3))


def stones():
    """Blocks at several distances, before the ground and before the sky."""
    return scene.plane(stones=scene.rocks([(1.2, 0.3, 0.0), (2.0, -0.6, 0.1), (3.5, 0.8, 0.2),
                                           (3.0, -0.1, 0.1)], 0.6), shape=scene.block())


@pytest.mark.parametrize('roll_deg', [3.0, 12.0, -20.0])
def test_outlines_of_rocks_are_as_bright_as_their_share(roll_deg):
    """RMS error at the outlines, relative to that of pixels that are all rock or none."""
    world = stones()
    radiance, label = draw(world, roll_deg)
    fine, fine_label = draw(world, roll_deg, FINER)
    true, share = means(fine), means((fine_label >= LABEL_FIRST_ROCK).astype(float))
    edge = (share > 0.0) & (share < 1.0)
    edge[:3] = edge[-3:] = edge[:, :3] = edge[:, -3:] = False
    whole = fine_label >= LABEL_FIRST_ROCK
    own = means(np.where(whole, fine, 0.0)) / np.maximum(share, 1e-9)
    rest = means(np.where(whole, 0.0, fine)) / np.maximum(1.0 - share, 1e-9)
    stepped = np.where(label >= LABEL_FIRST_ROCK, own, rest)
    before = np.sqrt(np.mean((stepped - true)[edge]**2))
    now = np.sqrt(np.mean((radiance - true)[edge]**2))
    assert np.count_nonzero(edge) > 150
    assert now < 0.45 * before


def test_only_outlines_change():
    """Pixels whose eight neighbours show the same surface are those of the rock alone."""
    world = stones()
    radiance, label = draw(world, 0.0)
    bare, _ = draw(scene.plane(), 0.0)
    near_rock = np.zeros(label.shape, bool)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            near_rock |= np.roll(label, (dy, dx), (0, 1)) >= LABEL_FIRST_ROCK
    lit = ~near_rock & (radiance > 0.5 * bare)      # the rest lies in the shadow of a rock
    assert lit.mean() > 0.5
    np.testing.assert_array_equal(radiance[lit], bare[lit])
    assert radiance.min() >= 0.0
