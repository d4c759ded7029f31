"""Supersampling: light at several samples a pixel, truth at its centre."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
import dataclasses
import functools
import math

import camera_scene as scene
import numpy as np
import pytest
from resolution import against_finer, finer_camera
import scipy.ndimage
import worlds

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import Array, sun_direction
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.config import CameraConfig, FurtherCameraConfig, LensConfig
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig, HazardConfig, HazardMount
from lunar_rover_sim.image.camera.mount import BodyMount
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.frame import RIGHT_TRUTH, StereoFrame
from lunar_rover_sim.image.rendering.labels import LABEL_GROUND
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

WIDTH, HEIGHT = 160, 120
TRUTH = ('depth', 'normal', 'label', 'crater', 'shadow', *RIGHT_TRUTH)
CLEAR = LensConfig(scatter_share=0.0, veil_share=0.0)
# The second one looks at the shadow of the rover.
STATES = [RoverPose(scene.pose(0.4, -0.3, 0.25, 25.0)),
          RoverPose(scene.pose(-1.0, 0.5, 0.25, 200.0))]


@pytest.fixture(scope='module')
def world() -> World:
    """Hills, craters and rocks."""
    return worlds.small()


def renderer_of(world: World, samples: int, times: int = 1, detail: DetailConfig = DetailConfig(),
                **groups) -> Renderer:
    """Return a renderer; times: that the image is larger, along a side."""
    distortion = groups.pop('distortion', (0.0,) * 5)
    camera = CameraConfig(width=WIDTH * times, height=HEIGHT * times, distortion=distortion)
    return Renderer(world, scene.ROVER, scene.config(
        sun=scene.RELIEF_SUN, camera=camera,
        detail=dataclasses.replace(detail, supersampling=samples), **groups))


def kept(world: World) -> Iterator[Callable[..., Renderer]]:
    """Give a function like `renderer_of` for a world, which keeps its renderers."""
    with ExitStack() as stack:
        yield functools.cache(lambda *arguments: stack.enter_context(
            renderer_of(world, *arguments)))


@pytest.fixture(scope='module')
def renderer(world: World) -> Iterator[Callable[..., Renderer]]:
    yield from kept(world)


@pytest.fixture(scope='module')
def on_bare_hills() -> Iterator[Callable[..., Renderer]]:
    yield from kept(scene.plane(heights=scene.hills()))


def means(fine: Array, times: int) -> Array:
    """Return the means of blocks of so many pixels along a side."""
    h, w = fine.shape
    return fine.astype(float).reshape(h // times, times, w // times, times).mean((1, 3))


@pytest.mark.parametrize('samples', [2, 3])
def test_radiance_is_the_mean_of_a_larger_picture(renderer, samples: int) -> None:
    """That of a camera with as many pixels, with relief, rocks, the rover's shadow and smooth
    outlines; but for rounding where two cells of relief meet.
    """
    drawn = [renderer(samples).render(state, 0, ('radiance', 'right')) for state in STATES]
    larger = [renderer(1, samples).render(state, 0, ('radiance',)) for state in STATES]
    for frame, fine in zip(drawn, larger):
        assert frame.radiance is not None and fine.radiance is not None
        same = np.isclose(frame.radiance, means(fine.radiance, samples), rtol=1e-5, atol=0.0)
        assert same.mean() > 0.9998


def test_the_margin_of_a_distorted_image_is_left_out(world: World, renderer) -> None:
    """Its radiance is that of a rectified image, but for rounding where rays meet edges.

    Pixels a sample away would differ in most places.
    """
    with renderer_of(world, 2, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0)) as distorted:
        one, other = (drawn.render(STATES[0], 0, ('radiance',)).radiance
                      for drawn in (renderer(2), distorted))
    assert one is not None and other is not None
    assert np.mean(np.abs(other - one) > 1e-3 * one) < 0.01


def test_images_are_those_of_the_mean_radiance(world: World, renderer) -> None:
    """A sensor without noise says of both eyes what it says of the averaged larger picture."""
    fixed = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, exposure_mode='fixed',
                                exposure_s=2e-3)
    state = STATES[0]
    with renderer_of(world, 2, lens=CLEAR, sensor=fixed) as drawn:
        frame, sensor = drawn.render(state, 0, ('left', 'right')), drawn.sensor
        right = np.linalg.inv(drawn.rig.T_base_left) @ drawn.rig.T_base_right
        other = dataclasses.replace(state, T_world_base=state.T_world_base
                                    @ drawn.rig.T_base_left @ right
                                    @ np.linalg.inv(drawn.rig.T_base_left))
    for image, place in ((frame.left, state), (frame.right, other)):
        fine = renderer(1, 2).render(place, 0, ('radiance',)).radiance
        assert image is not None and fine is not None
        level = (means(fine, 2) * sensor.electrons_per_radiance_second * frame.exposure_s
                 / sensor.config.full_well_e)
        error = np.abs(sensor.linear(image) - np.minimum(level, 1.0))
        # The body of the rover has moved with the right eye, and so has its shadow.
        assert np.median(error) < 2e-5 and np.mean(error > 1e-4) < 0.04


@pytest.mark.parametrize('samples', [2, 3])
def test_truth_is_that_of_pixel_centres(on_bare_hills, samples: int) -> None:
    """Of ground without rocks each layer is the same, bit by bit, with and without light."""
    for state in STATES:
        before = on_bare_hills(1).render(state, 0, TRUTH)
        for layers in (TRUTH, (*TRUTH, 'left', 'right')):
            frame = on_bare_hills(samples).render(state, 0, layers)
            for name in TRUTH:
                np.testing.assert_array_equal(frame.layer(name), before.layer(name), name)


def test_truth_is_that_of_the_rocks_in_the_picture(renderer) -> None:
    """Rocks have the shapes of the finer pixels: outlines may move by a pixel, all else stays."""
    for state in STATES:
        before, frame = (renderer(samples).render(state, 0, ('label', 'depth'))
                         for samples in (1, 2))
        assert before.label is not None and frame.label is not None
        assert before.depth_m is not None and frame.depth_m is not None
        changed = before.label != frame.label
        assert 0.0 < changed.mean() < 0.01
        ground = (before.label == LABEL_GROUND) & ~changed
        np.testing.assert_array_equal(frame.depth_m[ground], before.depth_m[ground])


def test_flow_follows_the_same_pixels(on_bare_hills) -> None:
    frames = [on_bare_hills(samples).render(STATES[0], 0, ('left', 'optical_flow'), STATES[1])
              for samples in (1, 2)]
    np.testing.assert_array_equal(*(frame.optical_flow for frame in frames))


def test_two_frames_under_way_are_those_one_after_the_other(renderer) -> None:
    layers, drawn = ('left', 'right', 'depth', 'label'), renderer(2)
    alone = [drawn.render(state, k, layers) for k, state in enumerate(STATES)]
    for k, state in enumerate(STATES):
        drawn.begin(state, k, layers)
    for frame in alone:
        beside = drawn.finish()
        for name in layers:
            np.testing.assert_array_equal(beside.layer(name), frame.layer(name), name)


def test_the_sun_has_its_place_and_its_irradiance() -> None:
    """Its disc, a few pixels wide, is cut by the horizon at the same height."""
    bare = scene.plane()
    state = RoverPose(scene.pose(0.0, 0.0, 0.1))
    seen = []
    for samples in (1, 3):
        with renderer_of(bare, samples, detail=scene.SMOOTH) as renderer:
            for elevation in (4.0, 0.05):
                renderer.set_sun(3.0, elevation)
                radiance = renderer.render(state, 0, ('radiance',)).radiance
                assert radiance is not None
                disc = np.where(radiance > 1e4, radiance, 0.0).astype(float)
                rays = renderer.rig.rays()
                direction = sun_direction(3.0, elevation) @ (
                    state.T_world_base @ renderer.rig.T_base_left)[:3, :3]
                solid = (rays**2).sum(-1)**-1.5 / renderer.rig.focal_px**2
                place = np.tensordot(disc, rays / rays[..., 2:], 2) / disc.sum()
                seen.append((np.sum(disc * solid), *(place - direction / direction[2])[:2]))
    for one, three in zip(seen[:2], seen[2:]):
        assert three[0] == pytest.approx(one[0], rel=0.01)
        np.testing.assert_allclose(three[1:], one[1:], atol=0.05 / 114.0)   # of a pixel


def test_motion_is_the_mean_of_sub_exposures(world: World) -> None:
    """RMS below 2 % of the range, as without supersampling."""
    time_s, count = 0.01, 16
    rate = np.array([0.0, 0.45, 0.6])
    linear = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, exposure_mode='fixed',
                                 exposure_s=time_s, full_well_e=1e7)
    with renderer_of(world, 2, lens=CLEAR, sensor=linear) as renderer:
        state = dataclasses.replace(STATES[1], angular_velocity_radps=rate)
        frame = renderer.render(state, 0, ('left',))
        sensor = renderer.sensor
        assert frame.left is not None
        moving = sensor.linear(frame.left) * sensor.config.full_well_e / (
            sensor.electrons_per_radiance_second * time_s)
        parts, still = [], dataclasses.replace(state, angular_velocity_radps=np.zeros(3))
        for t in ((np.arange(count) + 0.5) / count - 0.5) * time_s:
            turn = scene.pose(z=0.0, pitch_deg=math.degrees(t * rate[1]),
                              yaw_deg=math.degrees(t * rate[2]))
            at = dataclasses.replace(still, T_world_base=still.T_world_base @ turn)
            parts.append(renderer.render(at, 0, ('radiance',)).radiance)
    mean = np.mean(parts, axis=0)
    inside = slice(3, -3), slice(3, -3)
    error = (moving - mean)[inside]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.ptp(np.percentile(mean, [1.0, 99.0]))


def test_further_cameras_have_it(renderer) -> None:
    """A camera in the place of the left one sees the same pixels."""
    config = FurtherCameraConfig(camera=CameraConfig(width=WIDTH, height=HEIGHT))
    further = renderer(2).add_camera(config, BodyMount(renderer(2).rig))
    pair, other = (camera.render(STATES[0], 0, ('radiance', 'depth', 'label'))
                   for camera in (renderer(2), further))
    for name in ('radiance', 'depth', 'label'):
        np.testing.assert_array_equal(pair.layer(name), other.layer(name), name)


def fisheye_of(renderer: Renderer, pixels: int) -> StereoFrame:
    """Return what a fisheye on the rover sees, looking away from the sun."""
    config = HazardConfig(
        camera=HazardCameraConfig(width=pixels, height=pixels, horizontal_fov_deg=185.0),
        lens=CLEAR, position_m=(0.0, 0.0, 0.3), orientation_rpy_deg=(0.0, 20.0, 0.0))
    further = renderer.add_camera(config, HazardMount(config))
    return further.render(STATES[1], 0, ('radiance', 'depth', 'label'))


def test_a_fisheye_has_it(renderer) -> None:
    """The error against a fisheye of many times the pixels is about half of that without."""
    one, fine = (fisheye_of(renderer(1), pixels).radiance for pixels in (120, 720))
    two = fisheye_of(renderer(2), 120).radiance
    assert one is not None and two is not None and fine is not None
    inside = np.hypot(*(np.indices((120, 120)) - 59.5)) < 57.0
    error = [np.sqrt(np.mean((image - means(fine, 6))[inside]**2)) for image in (one, two)]
    assert error[1] < 0.6 * error[0]


def test_distances_of_a_fisheye_are_those_of_pixel_centres() -> None:
    """On level ground they stay within a tenth of their change from pixel to pixel."""
    frames = []
    for samples in (1, 2):
        with renderer_of(scene.plane(n=129), samples) as renderer:
            frames.append(fisheye_of(renderer, 120))
    one, two = frames
    assert one.depth_m is not None and two.depth_m is not None and one.label is not None
    before, after = (np.minimum(frame.depth_m, 50.0) for frame in (one, two))
    other = scipy.ndimage.binary_dilation(one.label != LABEL_GROUND, iterations=2)
    ground = ~other & (before < 5.0)
    change = np.hypot(*np.gradient(before))
    assert ground.mean() > 0.2
    assert np.all(np.abs(after - before)[ground] <= 0.1 * change[ground])


def test_a_picture_too_large_for_the_device_is_refused() -> None:
    config = RenderConfig(camera=CameraConfig(width=8192, height=8192),
                          detail=DetailConfig(supersampling=4))
    with pytest.raises(RenderError, match='8192 x 8192 with detail.supersampling 4: .* at most'):
        Renderer(scene.plane(n=33), scene.ROVER, config)


@pytest.fixture(scope='module')
def rough() -> World:
    """Hills of 5 cm RMS, among which a camera 20 cm high sees little of the far ground."""
    return scene.plane(1025, heights=scene.hills(1025, rms_m=0.05))


def on_hills(rough: World, samples: int = 1) -> Renderer:
    """Return a renderer under a low sun."""
    return Renderer(rough, scene.ROVER, scene.config(
        camera=CameraConfig(width=2 * WIDTH, height=2 * HEIGHT), elevation_deg=6.0,
        azimuth_deg=0.0, detail=dataclasses.replace(scene.SMOOTH, supersampling=samples)))


def state_on(rough: World, x: float, y: float, yaw_deg: float = 0.0) -> RoverPose:
    return RoverPose(scene.pose(x, y, float(rough.height_at((x, y))) + 0.1, yaw_deg))


@pytest.mark.parametrize('yaw_deg', [0.0, 90.0, 180.0])
def test_far_ground_is_as_bright_as_in_a_finer_image(rough, yaw_deg: float) -> None:
    """Towards a low sun pixels show the dark sides of hills; what is bright behind is hidden.

    As much is in shadow, within 2 points; with the light of one point a pixel it was 5 points more
    towards the sun and 4 across it.
    """
    x, y = (-8.0 * turned(math.radians(yaw_deg)) for turned in (math.cos, math.sin))
    states = [state_on(rough, x, y + beside, yaw_deg) for beside in (0.0, 2.0)]
    with on_hills(rough) as renderer:
        curve = against_finer(renderer, finer_camera(renderer, 4), states, (1.5, 3.5, 7.0, 12.0))
    np.testing.assert_allclose(curve.ratio, 1.0, atol=0.1)
    np.testing.assert_allclose(curve.shadow_difference, 0.0, atol=0.02)


def test_far_ground_flickers_little(rough) -> None:
    """From step to step of 2 mm it changes by 1.3 times as much as with 4 x 4 samples a pixel.

    With the light of one point a pixel it was 2.1 times.
    """
    changes = []
    for samples in (1, 4):
        with on_hills(rough, samples) as renderer:
            frames = [[renderer.render(state_on(rough, -8.0 + 0.002 * k, y), 0,
                                       ('radiance', 'depth')) for k in range(4)]
                      for y in (-2.0, 0.0, 2.0)]
        depth, light = (np.array([[getattr(frame, name) for frame in walk] for walk in frames],
                                 float) for name in ('depth_m', 'radiance'))
        far = np.all((depth > 3.5) & (depth < 12.0), axis=1)
        changes.append(np.mean(np.diff(light, axis=1)**2, axis=1)[far].mean())
    assert changes[0] < 1.6**2 * changes[1]
