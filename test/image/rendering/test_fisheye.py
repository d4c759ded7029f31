"""Fisheyes in the world of the stereo pair: geometry, light, motion."""

from collections.abc import Iterator
import math

import camera_scene as scene
import numpy as np
import pytest
import scipy.ndimage

from lunar_rover_sim.base.frames import (inverse, matrix_from_wxyz, se3, sun_direction,
                                         wxyz_from_rpy)
from lunar_rover_sim.image.camera.config import CameraConfig, FurtherCameraConfig, LensConfig
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.hazard import (HazardCameraConfig, HazardConfig, HazardMount,
                                                 HazardRig)
from lunar_rover_sim.image.camera.mount import BodyMount, MovingMount
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.labels import LABEL_GROUND, rover_links
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

SMALL = CameraConfig(width=64, height=48)
CLEAR = LensConfig(scatter_share=0.0, veil_share=0.0)
WHOLE = HazardCameraConfig(width=240, height=240, horizontal_fov_deg=185.0)
REAL = (-0.02, 0.004, -0.003, 0.0006)


def hazard(camera: HazardCameraConfig = WHOLE, sensor=scene.IDEAL, **values) -> HazardConfig:
    """Return a camera 0.3 m above base_link, that looks ahead."""
    values = dict(position_m=(0.0, 0.0, 0.3), orientation_rpy_deg=(0.0, 0.0, 0.0)) | values
    return HazardConfig(camera=camera, lens=CLEAR, sensor=sensor, **values)


def away_from(pixels: np.ndarray, distance_px: int) -> np.ndarray:
    """Return which pixels are not near some."""
    near: np.ndarray = scipy.ndimage.binary_dilation(pixels, iterations=distance_px)
    return ~near


@pytest.fixture(scope='module')
def on_plane() -> Iterator[Renderer]:
    """Return a renderer of level ground."""
    with Renderer(scene.plane(n=129), scene.ROVER, scene.config(camera=SMALL)) as drawn:
        yield drawn


@pytest.fixture(scope='module')
def on_hills() -> Iterator[Renderer]:
    """Return a renderer of hills."""
    with Renderer(scene.plane(n=257, heights=scene.hills(n=257)), scene.ROVER, scene.config(
            camera=SMALL, azimuth_deg=100.0, elevation_deg=12.0)) as drawn:
        yield drawn


@pytest.fixture(scope='module')
def wide_on_hills(on_hills) -> tuple[HazardConfig, FisheyeCamera, RoverPose, StereoFrame]:
    """Return a fisheye on the hills, where the rover stands, and what it sees."""
    config = hazard(HazardCameraConfig(width=400, height=400, horizontal_fov_deg=185.0))
    state = RoverPose(scene.pose(0.0, 0.0, 0.4))
    wide = on_hills.add_camera(config, HazardMount(config))
    return config, wide.camera, state, wide.render(state, 0, ('radiance', 'label'))


@pytest.mark.parametrize('k', [(0.0,) * 4, REAL])
def test_the_ground_lies_where_the_model_has_it(on_plane, k) -> None:
    """Distances of level ground differ by less than a tenth of their change from pixel to pixel.

    The field holds all faces, their seams and what lies behind the plane of the lens.
    """
    camera = HazardCameraConfig(width=240, height=240, horizontal_fov_deg=185.0,
                                fisheye_distortion=k)
    config = hazard(camera, orientation_rpy_deg=(0.0, 50.0, 0.0))
    state = RoverPose(scene.pose(0.0, 0.0, 0.2, 33.0))
    further = on_plane.add_camera(config, HazardMount(config))
    frame = further.render(state, 0, ('depth', 'label'))
    directions = further.camera.directions(further.camera.pixels())
    assert frame.depth_m is not None and frame.label is not None
    R_world = (state.T_world_base @ HazardRig(config).T_base_left)[:3, :3]
    fall = -(directions @ R_world.T)[..., 2]
    expected = 0.5 / np.where(fall > 0.06, fall, np.nan)
    change = np.hypot(*np.gradient(expected))
    ground = away_from(rover_links(frame.label), 2) & np.isfinite(change)
    error_px = np.abs(frame.depth_m - expected)[ground] / np.maximum(change[ground], 1e-4)
    assert ground.mean() > 0.35
    assert np.max(error_px) < 0.1
    sky = fall < -0.02
    assert np.all(np.isinf(frame.depth_m[sky & ~rover_links(frame.label)]))


def test_the_sun_stands_where_the_model_has_it(on_plane) -> None:
    """The centroid of its disc in the radiance is within 0.1 px, over the field and on seams."""
    config = hazard(HazardCameraConfig(width=480, height=480, horizontal_fov_deg=185.0))
    further = on_plane.add_camera(config, HazardMount(config))
    state = RoverPose(scene.pose(0.0, 0.0, 0.2))
    T_camera_world = inverse(state.T_world_base @ HazardRig(config).T_base_left)
    errors = []
    for azimuth, elevation in ((20.0, 30.0), (45.0, 5.0), (-91.5, 4.0), (5.0, 80.0), (0.0, 45.0)):
        on_plane.set_sun(azimuth, elevation)
        radiance = further.render(state, 0, ('radiance',)).radiance
        assert radiance is not None
        place = further.camera.project(T_camera_world[:3, :3] @ sun_direction(azimuth, elevation))
        disc = np.where(radiance > 0.01 * radiance.max(), radiance, 0.0)
        centroid = [(disc * index).sum() / disc.sum() for index in np.indices(disc.shape)[::-1]]
        errors.append(np.linalg.norm(centroid - place))
    assert max(errors) < 0.1


@pytest.mark.parametrize('yaw_deg, pitch_deg', [(45.0, 20.0), (-80.0, 10.0), (0.0, 45.0)])
def test_it_is_as_bright_as_a_pinhole(on_hills, wide_on_hills, yaw_deg: float,
                                      pitch_deg: float) -> None:
    """In each direction radiance is that of a pinhole camera that looks there.

    Two of them look at seams of the faces, where nothing else may be seen than anywhere.
    """
    config, camera, state, seen = wide_on_hills
    pinhole = MovingMount()
    rig = HazardRig(config)
    T_world_camera = state.T_world_base @ rig.T_base_left
    turn = matrix_from_wxyz(wxyz_from_rpy(0.0, math.radians(pitch_deg), math.radians(yaw_deg)))
    T = state.T_world_base @ se3(turn @ rig.T_base_left[:3, :3], rig.T_base_left[:3, 3])
    pinhole.place(T)
    # About as many pixels per radian as the fisheye.
    narrow = CameraConfig(width=96, height=96, horizontal_fov_deg=42.0)
    other = on_hills.add_camera(FurtherCameraConfig(camera=narrow), pinhole)
    expected = other.render(state, 0, ('radiance', 'label'))
    places = camera.project(other.camera.rays() @ T[:3, :3].T @ T_world_camera[:3, :3])
    assert seen.radiance is not None and expected.radiance is not None
    assert seen.label is not None and expected.label is not None
    at = np.nan_to_num(places, nan=-9.0)[..., ::-1].transpose(2, 0, 1)
    ground = away_from(expected.label != LABEL_GROUND, 4) & np.isfinite(places[..., 0])
    ground &= scipy.ndimage.map_coordinates(
        away_from(seen.label != LABEL_GROUND, 4).astype(float), at, order=0) > 0.5
    assert ground.mean() > 0.25
    one = scipy.ndimage.map_coordinates(seen.radiance, at, order=1)[ground]
    two = expected.radiance[ground]
    assert np.mean(one) == pytest.approx(np.mean(two), rel=2e-3)
    assert np.percentile(np.abs(one - two), 90) < 0.03 * np.mean(two)


def test_nothing_outside_the_image_circle(on_plane) -> None:
    """Beyond the cone of the lens it is dark, and the rover itself is in view."""
    config = hazard(HazardCameraConfig(width=200, height=200, image_circle_deg=140.0),
                    orientation_rpy_deg=(0.0, 90.0, 0.0))
    further = on_plane.add_camera(config, HazardMount(config))
    frame = further.render(RoverPose(scene.pose(0.0, 0.0, 0.2)), 0,
                           ('left', 'radiance', 'label', 'normal', 'shadow'))
    outside = np.isnan(further.camera.directions(further.camera.pixels())[..., 0])
    assert 0.4 < outside.mean() < 0.6
    for layer in (frame.radiance, frame.label, frame.normal, frame.shadow, frame.left):
        assert layer is not None and np.all(layer[outside] == 0)
    # It looks down on all four legs and the body.
    assert len(np.unique(frame.label[rover_links(frame.label)])) == 5


def test_motion_is_the_mean_over_the_exposure(on_hills) -> None:
    """A blurred image is the mean of sharp ones of the moments of the exposure.

    The camera rolls and drives, so that paths are curved and of all lengths up to 7 px.
    """
    sensor = scene.SensorConfig(exposure_mode='fixed', exposure_s=0.02, f_number=16.0,
                                shot_noise=False,
                                read_noise=False, fixed_pattern=False, companding='linear',
                                psf_sigma_px=0.0, encoding='mono16', bits=16)
    config = hazard(HazardCameraConfig(width=160, height=160, horizontal_fov_deg=185.0), sensor,
                    orientation_rpy_deg=(0.0, 40.0, 0.0))
    twist = dict(linear_velocity_mps=np.array([0.8, 0.3, 0.0]),
                 angular_velocity_radps=np.array([2.0, 1.0, 4.0]))
    T = scene.pose(0.0, 0.0, 0.3)
    further = on_hills.add_camera(config, HazardMount(config))

    def image(state: RoverPose) -> np.ndarray:
        frame = further.render(state, 0, ('left', 'label'))
        assert frame.left is not None and frame.label is not None
        return np.where(away_from(frame.label != LABEL_GROUND, 4), frame.left, np.nan)

    blurred, sharp = image(RoverPose(T, **twist)), image(RoverPose(T))
    moments = []
    for t in (np.arange(16) + 0.5) / 16 * 0.02 - 0.01:
        rate = twist['angular_velocity_radps'] * t
        angle = float(np.linalg.norm(rate))
        turn = matrix_from_wxyz([math.cos(angle / 2),
                                 *(math.sin(angle / 2) / angle * rate)])
        moments.append(image(RoverPose(T @ se3(turn, twist['linear_velocity_mps'] * t))))
    expected = np.mean(moments, axis=0)
    inside = np.isfinite(expected + blurred + sharp)
    assert inside.mean() > 0.3
    # The rover's shadow does not move with the ground.
    error, change = (np.percentile(np.abs(one - expected)[inside], 90)
                     for one in (blurred, sharp))
    assert error < 0.3 * change


def test_a_pair_and_the_stereo_pair_beside_it(on_hills) -> None:
    """The right image is that of a camera a baseline beside; the stereo pair stays as it is."""
    state = RoverPose(scene.pose(0.1, 0.0, 0.2))
    pair = hazard(stereo_baseline_m=0.08)
    beside = hazard()
    T = HazardRig(pair).T_base_right

    class Beside:
        T_base_left = T_base_right = T

    alone = on_hills.render(state)
    left = on_hills.add_camera(pair, HazardMount(pair))
    one = on_hills.add_camera(beside, BodyMount(Beside()))
    both = left.render(state, 0, ('left', 'right'))
    expected = one.render(state, 0, ('left',)).left
    after = on_hills.render(state)
    assert both.left is not None and both.right is not None and expected is not None
    assert np.mean(np.abs(both.right.astype(int) - expected)) < 1.0
    assert np.mean(np.abs(both.left.astype(int) - expected)) > 2.0
    assert np.array_equal(alone.left, after.left) and np.array_equal(alone.depth_m, after.depth_m)
