"""What rocks look like: their faces, soil at the foot and on what faces up."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
from resolution import finer_camera
from scipy.spatial.transform import Rotation
import worlds

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shapes import library
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.illumination.config import ReflectanceConfig
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.rock_pass import facets
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


def test_what_is_drawn_is_what_is_lit():
    """Normals are those of the mesh, so that no face towards the sun is black."""
    for shape in library()[::5]:
        data = facets(shape)
        corners = data[:, :3].reshape(-1, 3, 3)
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face /= np.linalg.norm(face, axis=1, keepdims=True)
        cosine = np.einsum('ij,ikj->ik', face, data[:, 3:].reshape(-1, 3, 3))
        assert cosine.min() > 0.8


def test_faces_towards_the_sun_are_lit():
    """A boulder of each kind, the sun behind the camera: nothing of it is black."""
    shapes = library()
    for index in (0, 4, 8, 12):
        stones = scene.rocks([(2.0, 0.0, 0.3)], SIDE)
        world = scene.plane(cell_m=0.2, stones=stones, shape=shapes[index])
        config = scene.config(20.0, 180.0, detail=ROUGH, camera=CameraConfig(320, 240, 50.0))
        with Renderer(world, scene.ROVER, config) as renderer:
            frame = renderer.render(RoverPose(scene.pose(z=0.4)), 0,
                                    ('radiance', 'label', 'shadow', 'normal'))
        towards = frame.normal @ sun_direction(180.0, 20.0)
        rock = (frame.label == LABEL_FIRST_ROCK) & (frame.shadow[..., 1] == 0) & (towards > 0.3)
        seen = frame.radiance[rock]
        assert rock.sum() > 3000
        assert np.quantile(seen, 0.01) > 0.25 * np.median(seen)


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
    # Of a level surface: the mean of grains and lumps, some of which turn away, is less.
    assert foot / above == pytest.approx(expected, rel=0.25)
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


@pytest.mark.parametrize('azimuth_deg', [0.0, 90.0, 180.0], ids=['towards', 'across', 'away'])
def test_specks_are_those_of_finer_images(azimuth_deg):
    """A thousand turned rocks of 0.7 to 4 px: what they cover, and the light that they send."""
    rng, shapes = np.random.default_rng(4), library()
    far_m, beside = np.meshgrid(np.linspace(9.0, 20.0, 32), np.linspace(-0.3, 0.3, 32))
    m, x = far_m.size, far_m.ravel()
    stones = Rocks(rng.integers(0, len(shapes), m, np.int32), np.arange(m, dtype=np.int32),
                   np.stack([x, x * beside.ravel(), np.full(m, 0.01)], axis=-1),
                   Rotation.random(m, rng).as_quat()[:, [3, 0, 1, 2]], np.ones(m, np.float32),
                   rng.uniform(0.03, 0.09, m))
    world = dataclasses.replace(scene.plane(cell_m=0.2, stones=stones), rock_shapes=shapes)
    config = scene.config(15.0, azimuth_deg, camera=CameraConfig(320, 240, 40.0))
    state, sums = RoverPose(scene.pose(z=2.0, pitch_deg=8.0)), []
    with Renderer(world, scene.ROVER, config) as renderer:
        for camera, pixels in ((renderer, 1), (finer_camera(renderer, 4), 16)):
            frame = camera.render(state, 0, ('radiance', 'label'))
            rock = frame.label >= LABEL_FIRST_ROCK
            sums.append((rock.sum() / pixels, frame.radiance[rock].sum() / pixels))
    (area, light), (true_area, true_light) = sums
    assert true_area > 1000
    assert area == pytest.approx(true_area, rel=0.1)
    # Faces that look at the sun send 60; those that turn away from it, a hundredth.
    assert light / area == pytest.approx(true_light / true_area, rel=0.1, abs=0.5)


def test_shadows_darken_the_ground_beyond_its_edge(world):
    """The same ground with and without far rocks, under a low sun from the side."""
    camera = CameraConfig(width=320, height=240)
    pose = RoverPose(scene.pose(z=8.0, pitch_deg=10.0))
    frames = []
    for far_m in (0.0, 300.0):
        detail = scene.DetailConfig(relief_rms_slope=0.0, pebble_cover=0.0, pit_cover=0.0,
                                    bounce=False, far_rocks_m=far_m)
        config = scene.config(5.0, 90.0, camera=camera, detail=detail)
        with Renderer(world, scene.ROVER, config) as renderer:
            frames.append(renderer.render(pose, layers=('radiance', 'depth', 'label')))
    bare, frame = frames
    ground = (frame.label == 1) & (frame.depth_m > 20.0) & (frame.depth_m < 120.0)
    darker = np.mean(1.0 - frame.radiance[ground] / bare.radiance[ground])
    # Rocks cover 1 %, and cast shadows eleven times as long as they are high, 0.4 of their length;
    # those below 30 cm are left out.
    assert 0.005 < darker < 0.15
