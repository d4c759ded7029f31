"""What is drawn on rocks: facets of their own, soil at the foot and on what faces up."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination import hapke
from lunar_rover_sim.illumination.config import ReflectanceConfig
from lunar_rover_sim.rendering.labels import LABEL_FIRST_ROCK
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

SIDE = 0.8              # of the block before the cameras [m]; the other one looks 8 px wide
AZIMUTH_DEG = 125.0
ROUGH = dataclasses.replace(scene.SMOOTH, relief_rms_slope=0.11)


def draw(detail):
    """Return the frame of a near and a far block of basalt on light soil, lit from the side."""
    stones = scene.rocks([(2.3, 0.0, 0.5 * SIDE), (34.0, 13.0, 0.5 * SIDE)], SIDE)
    world = scene.plane(cell_m=0.2, stones=stones)
    config = scene.config(30.0, AZIMUTH_DEG, detail=detail, camera=CameraConfig(320, 240, 50.0),
                          reflectance=ReflectanceConfig(rocks='basalt'))
    with Renderer(world, scene.ROVER, config) as renderer:
        return renderer.render(RoverPose(scene.pose(z=0.9, pitch_deg=8.0)), 0,
                               ('radiance', 'label', 'normal', 'depth'))


@pytest.fixture(scope='module')
def frames():
    return draw(ROUGH), draw(scene.SMOOTH)


@pytest.fixture(scope='module')
def looks(frames):
    """Return what roughness and soil make of the radiance, (h, w), and heights above ground [m].

    The latter are NaN off the face of the near block that looks at the cameras.
    """
    rough, smooth = frames
    ratio = rough.radiance.astype(float) / np.maximum(smooth.radiance, 1e-6)
    face = (smooth.label == LABEL_FIRST_ROCK) & (smooth.normal[..., 0] < -0.9)
    height = np.full(face.shape, np.nan)
    rows = np.nonzero(face.any(axis=1))[0]
    top, foot = rows[0], rows[-1]
    height[face] = SIDE * (foot - np.nonzero(face)[0]) / (foot - top)
    return ratio, height


def test_faces_are_broken_into_facets_of_a_fifth_of_the_rock(looks):
    """Patches of a brightness of their own, whose mean is that of the face."""
    ratio, height = looks
    rows, columns = np.nonzero(height > 0.3 * SIDE)
    face = ratio[rows[0]:rows[-1], columns.min() + 2:columns.max() - 1]
    px = face.shape[1]      # a diameter
    assert px > 80
    # Lumps and grain are finer than a twentieth of the rock.
    patches = gaussian_filter(face, 0.04 * px)
    patches = patches / patches.mean() - 1.0
    assert 0.08 < patches.std() < 0.4
    assert 0.8 < face.mean() < 1.2

    def correlation(lag):
        shift = round(lag * px)
        return np.mean(patches[:, shift:] * patches[:, :-shift]) / patches.var()
    assert correlation(0.05) > 0.6 and abs(correlation(0.35)) < 0.35
    # Within a facet brightness is even: most of it changes at its borders.
    change = np.abs(np.diff(gaussian_filter(face, 0.015 * px), axis=1))
    assert np.quantile(change, 0.5) < 0.4 * np.quantile(change, 0.95)


def test_rocks_of_a_few_pixels_have_none(frames):
    """Nine pixels of 0.8 m at 34 m: what is drawn on the face is averaged."""
    rough, smooth = frames
    far = smooth.label == LABEL_FIRST_ROCK + 1
    assert 20 < far.sum() < 200
    rows = np.nonzero((far & (smooth.normal[..., 0] < -0.9)).any(axis=1))[0]
    far[(rows[0] + rows[-1]) // 2:] = False         # above the soil at the foot
    middle = far & (smooth.normal[..., 0] < -0.9)
    ratio = rough.radiance[middle] / smooth.radiance[middle]
    assert middle.sum() > 15 and ratio.std() < 0.03


def test_soil_lies_at_the_foot(looks):
    """It reflects as soil does, with a slope between that of the face and of the ground."""
    ratio, height = looks
    foot, above = (np.mean(ratio[(height > low * SIDE) & (height < high * SIDE)])
                   for low, high in ((0.0, 0.04), (0.35, 0.95)))
    sun = sun_direction(AZIMUTH_DEG, 30.0)
    view = np.array([-1.0, 0.0, 0.15])
    view /= np.linalg.norm(view)

    def light(matter, normal):
        return float(hapke.reflectance(normal @ sun, normal @ view, sun @ view,
                                       hapke.parameter_set(matter),
                                       theta_deg=hapke.parameter_set('basalt').theta_deg))
    expected = light('highland', np.array([-0.5, 0.0, 0.87])) \
        / light('basalt', np.array([-1.0, 0.0, 0.0]))
    assert expected > 1.3
    assert foot / above == pytest.approx(expected, rel=0.2)
    # It ends at a seventh of the diameter or so.
    edge = np.mean(ratio[(height > 0.25 * SIDE) & (height < 0.35 * SIDE)])
    assert edge == pytest.approx(above, rel=0.15)


def test_soil_lies_thinly_on_what_faces_up(frames):
    """Half of it on a level top."""
    rough, smooth = frames
    top = (smooth.label == LABEL_FIRST_ROCK) & (smooth.normal[..., 2] > 0.99)
    ground = (smooth.label == 1) & (smooth.depth_m < 12.0) & (smooth.depth_m > 3.0)
    assert top.sum() > 100 and ground.sum() > 1000
    share = np.mean(rough.radiance[top]) / np.mean(smooth.radiance[top])
    assert 1.1 < share < 1.7
