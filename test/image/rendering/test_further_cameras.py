"""Cameras besides the stereo pair, in the same world."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
import scipy.ndimage

from lunar_rover_sim.base.errors import ConfigError, RenderError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.chase import ChaseCameraConfig, ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import CameraConfig, FurtherCameraConfig
from lunar_rover_sim.image.camera.mount import BodyMount, MovingMount
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.labels import rover_links
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

SMALL = CameraConfig(width=160, height=120)
CHASE = ChaseConfig(camera=ChaseCameraConfig(width=192, height=108))
LAYERS = ('left', 'radiance', 'depth', 'label')


@pytest.fixture(scope='module')
def world():
    """Hills with nothing on them."""
    return scene.plane(heights=scene.hills())


@pytest.fixture(scope='module')
def renderer(world):
    """Return a renderer whose sun stands in the north-east."""
    config = RenderConfig(camera=SMALL, sun=scene.SunConfig(azimuth_deg=50.0), detail=scene.SMOOTH)
    with Renderer(world, scene.ROVER, config) as renderer:
        yield renderer


def drawn_pair(renderer: Renderer, state: RoverPose, k: int) -> StereoFrame:
    """Return a frame of the pair."""
    return renderer.render(state, k, LAYERS)


def test_it_sees_what_the_pair_sees(renderer: Renderer) -> None:
    """With mount, camera and light of the left camera, radiance and depth are the same pixels."""
    state = RoverPose(scene.pose(0.3, 0.2, 0.15, 40.0))
    further = renderer.add_camera(FurtherCameraConfig(camera=SMALL), BodyMount(renderer.rig))
    for azimuth_deg in (50.0, 200.0, 50.0):
        renderer.set_sun(azimuth_deg, 6.0)
        pair, other = drawn_pair(renderer, state, 0), further.render(state, 0, LAYERS)
        for layer in ('radiance', 'depth_m', 'label'):
            assert np.array_equal(getattr(pair, layer), getattr(other, layer)), layer
        assert not np.array_equal(pair.left, other.left)    # it has noise of its own


def test_it_leaves_the_pair_alone(world, renderer: Renderer) -> None:
    """Images of the pair are the same, also when another camera draws between begin and finish."""
    states = [RoverPose(scene.pose(0.2 * k, 0.0, 0.2, 20.0 * k)) for k in range(3)]
    alone = [drawn_pair(renderer, state, k) for k, state in enumerate(states)]
    mount = ChaseMount(CHASE, 50.0, world)
    chase = renderer.add_camera(CHASE, mount)
    among = []
    for k, state in enumerate(states):
        mount.follow(state, k * 10**8)
        chase.render(state, k)
        renderer.begin(state, k, LAYERS)
        if k:
            with pytest.raises(RenderError, match='two frames are under way'):
                chase.render(state, k)
            among.append(renderer.finish())
    among.append(renderer.finish())
    for one, other in zip(alone, among):
        assert np.array_equal(one.left, other.left)
        assert np.array_equal(one.depth_m, other.depth_m)


def test_it_shows_the_whole_rover(world, renderer: Renderer) -> None:
    """Every link projects into the image, near its middle; the ground meets the feet."""
    state = RoverPose(scene.pose(0.0, 0.0, 0.3))
    mount = ChaseMount(CHASE, 50.0, world)
    mount.follow(state)
    frame = renderer.add_camera(CHASE, mount).render(state, 0, LAYERS)
    assert frame.label is not None
    rows, columns = np.nonzero(rover_links(frame.label))
    assert 0 < rows.min() and rows.max() < 107 and 0 < columns.min() and columns.max() < 191
    assert 0.02 < rover_links(frame.label).mean() < 0.5
    assert abs(columns.mean() - 95.5) < 15 and abs(rows.mean() - 53.5) < 15


@pytest.mark.parametrize('moving', [True, False])
def test_motion_blur(moving: bool) -> None:
    """A camera that moves with the rover blurs the ground, one that stands blurs the rover."""
    sensor = scene.SensorConfig(exposure_mode='fixed', exposure_s=0.02, shot_noise=False,
                                read_noise=False, fixed_pattern=False)
    config = FurtherCameraConfig(camera=CameraConfig(width=320, height=240), sensor=sensor)
    T = scene.pose(0.0, 0.0, 0.2)
    state = RoverPose(T, linear_velocity_mps=np.array([1.0, 0.0, 0.0]))
    mount = MovingMount()
    chase = ChaseMount(ChaseConfig(), 50.0, scene.plane())
    chase.follow(state)

    def drawn(velocity: Array, of: RoverPose) -> tuple[Array, Array]:
        mount.place(chase.T_world_camera, velocity)
        frame = further.render(of, 0, LAYERS)
        assert frame.left is not None and frame.label is not None
        return frame.left.astype(float), rover_links(frame.label)

    config_of_pair = RenderConfig(camera=SMALL, sun=scene.RELIEF_SUN)
    with Renderer(scene.plane(), scene.ROVER, config_of_pair) as renderer:
        further = renderer.add_camera(config, mount)
        sharp, rover = drawn(np.zeros(3), RoverPose(T))
        blurred, _ = drawn(np.array([1.0, 0.0, 0.0]) if moving else np.zeros(3), state)
    inside = np.zeros_like(rover)
    inside[10:-10, 10:-10] = True
    changed = np.abs(blurred - sharp)
    still, moved = (rover, ~rover) if moving else (~rover, rover)
    assert np.mean(changed[moved & inside]) > 3.0 * np.mean(changed[still & inside])


def test_samples_draw_thin_parts(renderer: Renderer) -> None:
    """From 4 m antenna and spokes are thinner than a pixel: four samples are nearer the truth.

    That is the picture with 16 samples. The error of a mean of samples on a grid falls about as
    the number along a side, so half is expected; outlines without steps help the single one, and
    glints of foil and metal are finer than the samples.
    """
    state = RoverPose(scene.pose(0.0, 0.0, 0.15, 40.0), np.full(4, 0.4))
    far = dataclasses.replace(CHASE, distance_m=4.0)
    mount = ChaseMount(far, 50.0, renderer.world)
    mount.follow(state)
    frames = [renderer.add_camera(far, mount, samples=samples).render(
        state, 0, ('radiance', 'label')) for samples in (1, 2, 4)]
    rover = scipy.ndimage.binary_dilation(rover_links(frames[0].label), iterations=2)
    assert rover.sum() > 200
    once, twice = (float(np.sqrt(np.mean((frame.radiance - frames[2].radiance)[rover]**2)))
                   for frame in frames[:2])
    assert twice < 0.9 * once


def test_samples(renderer: Renderer) -> None:
    """They are a least number: a finer renderer keeps its own. What cannot be is refused."""
    assert [DetailConfig(supersampling=3).with_samples(n).supersampling for n in (1, 2, 4)] == [
        3, 3, 4]
    with pytest.raises(ConfigError, match='supersampling: 0 is not valid; valid is 1 to 4'):
        renderer.add_camera(CHASE, ChaseMount(CHASE, 50.0, renderer.world), samples=0)
