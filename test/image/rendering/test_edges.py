"""Edges of ground, rocks, rover and shadows: few steps, against 8 x 8 times the pixels.

With two samples along a side of a pixel errors are about 0.4 of those with one.
"""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK, rover_links
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.description import RoverDescription, StereoMount
from lunar_rover_sim.rover.pose import RoverPose

FINER = 8
WIDTH, HEIGHT = 160, 120
# A rover whose cameras see its own deck and front legs.
LOOKING_DOWN = RoverDescription(stereo=StereoMount(position_m=(-0.02, 0.0, 0.22), pitch_deg=45.0))


def draw(world, rolls_deg, finer=1, smooth=True, samples=1, rover=scene.ROVER, z=0.1,
         sun_deg=(40.0, 150.0), view_deg=70.0):
    """Return left radiance, label and depth of each roll, with so many pixels per pixel.

    samples: along a side of a pixel
    """
    camera = CameraConfig(width=WIDTH * finer, height=HEIGHT * finer,
                          horizontal_fov_deg=view_deg)
    detail = dataclasses.replace(scene.SMOOTH, smooth_outlines=smooth, supersampling=samples)
    frames = []
    with Renderer(world, rover, scene.config(*sun_deg, camera=camera, detail=detail)) as renderer:
        for roll in np.radians(rolls_deg):
            pose = se3(matrix_from_wxyz(wxyz_from_rpy(roll, 0.0, 0.0)), (0.0, 0.0, z))
            frame = renderer.render(RoverPose(pose, np.full(4, 0.5)),
                                    layers=('radiance', 'label', 'depth'))
            frames.append((frame.radiance.astype(float), frame.label, frame.depth_m))
    return frames


def means(fine):
    return fine.reshape(HEIGHT, FINER, WIDTH, FINER).mean((1, 3))


def errors(world, rolls_deg, within, **options):
    """Return RMS errors at outlines and how many pixels these are.

    Errors are those with steps, without, and without at two samples along a side of a pixel.
    within: of radiance, label and depth, whether pixels belong to what has the outlines
    """
    square, count = np.zeros(3), 0
    drawn = [draw(world, rolls_deg, smooth=smooth, samples=samples, **options)
             for smooth, samples in ((False, 1), (True, 1), (True, 2))]
    for fine, *frames in zip(draw(world, rolls_deg, FINER, **options), *drawn):
        share = means(within(*fine).astype(float))
        edge = (share > 0.0) & (share < 1.0)
        edge[:3] = edge[-3:] = edge[:, :3] = edge[:, -3:] = False
        count += np.count_nonzero(edge)
        square += [np.sum((frame[0] - means(fine[0]))[edge]**2) for frame in frames]
    return np.sqrt(square / count), count


def stones():
    """Blocks at several distances, before the ground and before the sky."""
    return scene.plane(stones=scene.rocks([(1.2, 0.3, 0.0), (2.0, -0.6, 0.1), (3.5, 0.8, 0.2),
                                           (3.0, -0.1, 0.1)], 0.6), shape=scene.block())


def test_outlines_of_rocks_are_as_bright_as_their_share():
    (stepped, smooth, two), count = errors(
        stones(), [3.0, 12.0, -20.0], lambda radiance, label, depth: label >= LABEL_FIRST_ROCK)
    assert count > 500
    assert smooth < 0.45 * stepped and two < 0.25 * stepped


def test_outlines_of_the_rover_are_as_bright_as_their_share():
    (stepped, smooth, two), count = errors(
        scene.plane(), [0.0, 10.0], lambda radiance, label, depth: rover_links(label),
        rover=LOOKING_DOWN, z=0.12)
    assert count > 300
    # Glints and the rover's shadow on itself have edges of their own, beside its outlines.
    assert smooth < 0.8 * stepped and two < 0.6 * stepped, (stepped, smooth, two)


def ridge():
    """A wavy ridge before ground that rises behind it."""
    axis = (np.arange(513) - 256) * 0.025
    x, y = axis[None], axis[:, None]
    crest = (0.16 + 0.05 * np.sin(2.6 * y)) * np.exp(-((x - 2.0) / 0.25)**2)
    return scene.plane(heights=crest + 0.25 * np.maximum(x - 2.8, 0.0), far=False)


def test_ridges_before_other_ground_are_as_bright_as_their_share():
    (stepped, smooth, two), count = errors(
        ridge(), [2.0, -9.0], lambda radiance, label, depth: depth < 2.4,
        sun_deg=(25.0, 0.0), view_deg=20.0)
    assert count > 150
    assert smooth < 0.45 * stepped and two < 0.25 * stepped


@pytest.mark.parametrize('elevation_deg', [2.0, 6.0])
def test_edges_of_shadows_are_as_bright_as_their_share(elevation_deg):
    """Shadows of a hill and of posts, across the view."""
    axis = (np.arange(513) - 256) * 0.025
    hill = 0.12 * np.exp(-((axis[None] - 2.2)**2 + (axis[:, None] - 0.9)**2) / 0.12)
    post = scene.block(half=(0.05, 0.05, 0.12))
    world = scene.plane(heights=hill, shape=post, stones=scene.rocks(
        [(1.0, 0.25, 0.05), (1.4, 0.5, 0.05)], 1.0))
    (stepped, smooth, two), _ = errors(
        world, [2.0, -9.0],
        lambda radiance, label, depth: (label == 1) & (radiance < 0.4 * np.median(radiance)),
        sun_deg=(elevation_deg, 75.0), view_deg=20.0)
    assert smooth < 0.45 * stepped and two < 0.25 * stepped, (stepped, smooth, two)


def test_only_outlines_change():
    """Pixels whose eight neighbours show the same surface are those without smoothing."""
    (smooth, label, _), = draw(stones(), [5.0], sun_deg=(88.0, 0.0))
    (stepped, *_), = draw(stones(), [5.0], smooth=False, sun_deg=(88.0, 0.0))
    same = np.ones(label.shape, bool)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            same &= np.roll(label, (dy, dx), (0, 1)) == label
    assert same.mean() > 0.8 and np.any(smooth != stepped)
    np.testing.assert_array_equal(smooth[same], stepped[same])
    assert smooth.min() >= 0.0 and stepped.min() >= 0.0
