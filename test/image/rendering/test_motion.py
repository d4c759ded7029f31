"""Motion during the exposure: lengths of paths, sub-exposures, the stamp, the rolling shutter."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.camera.distortion import distort, undistort
from lunar_rover_sim.image.rendering.labels import rover_links
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.description import RoverDescription, StereoMount
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

EXPOSURE_S = 0.01
SUN = scene.SunConfig(azimuth_deg=180.0, elevation_deg=30.0)
CAMERA = CameraConfig(width=320, height=240)
CLEAR = LensConfig(scatter_share=0.0, veil_share=0.0)
LINEAR = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, exposure_mode='fixed',
                             exposure_s=EXPOSURE_S, full_well_e=1e7)
# Of a walk on `baseline`, as it pitches and rolls.
WALK = {'linear_velocity_mps': np.array([0.13, 0.03, -0.05]),
        'angular_velocity_radps': np.array([0.5, -0.45, 0.1])}


def after(state: RoverPose, time_s: float) -> RoverPose:
    """Return where a rover is that keeps its velocities, from the exponential of its twist."""
    steps = 64
    T, rate = state.T_world_base, state.angular_velocity_radps
    angle = np.linalg.norm(rate) * time_s / steps
    axis = rate / max(np.linalg.norm(rate), 1e-12)
    half = matrix_from_wxyz([np.cos(0.25 * angle), *(np.sin(0.25 * angle) * axis)])
    step = se3(half @ half, half @ state.linear_velocity_mps * time_s / steps)
    for _ in range(steps):
        T = T @ step
    return dataclasses.replace(
        state, T_world_base=T,
        joint_angle_rad=state.joint_angle_rad + time_s * state.joint_velocity_radps)


def light(renderer: Renderer, state: RoverPose, side: str = 'left') -> np.ndarray:
    """Return the (h, w) mean radiance over the exposure, as a linear sensor measures it."""
    frame = renderer.render(state, 0, (side,))
    sensor = renderer.sensor
    electrons = sensor.linear(getattr(frame, side)) * sensor.config.full_well_e
    return electrons / (sensor.electrons_per_radiance_second * frame.exposure_s)


def sub_exposures(renderer: Renderer, state: RoverPose, count: int,
                  time_s: float = EXPOSURE_S) -> np.ndarray:
    times = ((np.arange(count) + 0.5) / count - 0.5) * time_s
    return np.mean([renderer.render(after(state, t), 0, ('radiance',)).radiance
                    for t in times], axis=0)


@pytest.fixture(scope='module')
def pole():
    """A lit pole of 0.6 m width, 3 m ahead, before the sky."""
    return scene.plane(stones=scene.rocks([(3.0, 0.0, 0.0)], 1.0),
                       shape=scene.block('pole', (0.05, 0.3, 3.0)))


def renderer_of(world, rover=scene.ROVER, camera=CAMERA, detail=scene.SMOOTH, sun=SUN,
                **sensor) -> Renderer:
    config = scene.config(sun=sun, camera=camera, detail=detail, lens=CLEAR,
                          sensor=dataclasses.replace(LINEAR, **sensor))
    return Renderer(world, rover, config)


@pytest.fixture(scope='module')
def renderer(pole):
    """Return a renderer of the pole."""
    with renderer_of(pole) as renderer:
        yield renderer


def turning(yaw_rate_radps: float = 0.0, **motion) -> RoverPose:
    """Return a rover that looks at the pole and turns about the middle of its left camera."""
    mount = scene.ROVER.stereo
    centre = np.array(mount.position_m) + [0.0, 0.5 * mount.baseline_m, 0.0]
    rate = np.array([0.0, 0.0, yaw_rate_radps])
    return RoverPose(scene.pose(y=-centre[1]), angular_velocity_radps=rate,
                     linear_velocity_mps=-np.cross(rate, centre), **motion)


def right_edge(image: np.ndarray, rows=slice(8, 40)) -> tuple[np.ndarray, np.ndarray]:
    """Return place and variance of the pole's right edge in every row, above the horizon."""
    half = image[rows, image.shape[1] // 2:]
    slope = -np.diff(half, axis=1)
    u = np.arange(slope.shape[1]) + 0.5 + image.shape[1] // 2
    total = slope.sum(axis=1)
    place = slope @ u / total
    return place, np.sum(slope * (u - place[:, None])**2, axis=1) / total


@pytest.mark.parametrize('rate', [1.0, -1.0, 3.0, 12.0])
def test_a_turn_blurs_an_edge_by_rate_times_exposure(renderer, rate):
    """An edge becomes a ramp of f w T (1 + tan^2), of variance length^2 / 12; it stays in place.

    The camera looks 10 deg down and turns about the vertical, so that the rate along the rows is
    that of the tilted camera. Lengths are 2.5 to 30 px.
    """
    still, moving = light(renderer, turning()), light(renderer, turning(rate))
    K, turn = renderer.rig.K, renderer.rig.T_base_left[2, :3] * rate
    place, variance = right_edge(moving)
    place_still, variance_still = right_edge(still)
    ray = np.stack([(place_still - K[0, 2]) / K[0, 0], (np.arange(8, 40) - K[1, 2]) / K[1, 1],
                    np.ones(32)], axis=-1)
    swing = np.cross(turn, ray)
    length = np.abs(swing[:, 0] - ray[:, 0] * swing[:, 2]) * K[0, 0] * EXPOSURE_S
    measured = np.sqrt(12.0 * np.maximum(variance - variance_still, 0.0))
    assert length.min() > 1.9 * abs(rate)
    # Interpolation adds its own width, which counts in the shortest ones.
    np.testing.assert_allclose(measured.mean(), length.mean(),
                               rtol=0.12 if abs(rate) < 2.0 else 0.05)
    # The curvature of the path moves the mean by about f w^2 T^2 / 24.
    assert abs(np.mean(place - place_still)) < 0.03 + K[0, 0] * (rate * EXPOSURE_S)**2 / 12.0


def test_a_translation_blurs_by_the_inverse_depth(renderer):
    """The pole, nearest side 2.83 m from the camera, moves by f v T / Z across the image."""
    speed = 2.0
    state = dataclasses.replace(turning(), linear_velocity_mps=np.array([0.0, speed, 0.0]))
    still, moving = light(renderer, turning()), light(renderer, state)
    depth = renderer.render(turning(), 0, ('depth',)).depth_m
    focal = renderer.rig.focal_px
    (place, variance), (place_still, variance_still) = right_edge(moving), right_edge(still)
    rows = np.arange(8, 40)
    near = depth[rows, np.floor(place_still).astype(int) - 2]
    length = np.sqrt(12.0 * np.mean(variance - variance_still))
    # Pixels of the sky beside the pole do not see it come; they lie on the outer half of the ramp.
    assert 0.3 < length / np.mean(focal * speed * EXPOSURE_S / near) < 1.1
    assert abs(np.mean(place - place_still)) < 0.6


def test_a_still_camera_costs_and_changes_nothing(pole, renderer):
    """At rest, and with the blur switched off, every bit is that of the scene at the stamp."""
    moving = RoverPose(scene.pose(), **WALK)
    with renderer_of(pole, motion_blur=False) as sharp:
        frozen = sharp.render(moving, 3, ('left', 'right'))
    at_rest = renderer.render(RoverPose(scene.pose()), 3, ('left', 'right', 'radiance'))
    creeping = renderer.render(
        RoverPose(scene.pose(), angular_velocity_radps=np.full(3, 1e-4)), 3, ('left', 'right'))
    blurred = renderer.render(moving, 3, ('left', 'right', 'radiance', 'depth', 'label'))
    truth = renderer.render(RoverPose(scene.pose()), 3, ('radiance', 'depth', 'label'))
    for side in ('left', 'right'):
        np.testing.assert_array_equal(getattr(at_rest, side), getattr(creeping, side))
        np.testing.assert_array_equal(getattr(at_rest, side), getattr(frozen, side))
        assert np.any(getattr(at_rest, side) != getattr(blurred, side))
    for layer in ('radiance', 'depth_m', 'label'):      # those of the stamp
        np.testing.assert_array_equal(getattr(blurred, layer), getattr(truth, layer))


def test_the_picture_is_the_mean_of_sub_exposures():
    """RMS below 1.6 % of the range, and well below that of a sharp picture; both cameras.

    16 pictures are drawn, of 2 x 2 samples a pixel: edges that jump between pixels are no blur.
    """
    exposure_s = 1e-2
    scenario = Scenario.load('baseline', ['world.size_m=12.8', 'world.surroundings.samples=257',
                                          'render_node.camera.width=320',
                                          'render_node.camera.height=240',
                                          'render_node.detail.supersampling=2'])
    world = build_world(scenario.world, 1)
    sensor = dataclasses.replace(LINEAR, exposure_s=exposure_s)
    config = dataclasses.replace(scenario.render_node, lens=CLEAR, sensor=sensor)
    z = float(world.height_at((0.0, 0.0))) + 0.09
    state = RoverPose(scene.pose(z=z, yaw_deg=160.0), **WALK)
    with Renderer(world, scenario.rover, config, 1) as renderer:
        mean = sub_exposures(renderer, state, 16, exposure_s)
        sharp = renderer.render(state, 0, ('radiance',)).radiance
        picture = light(renderer, state)
    span = np.percentile(mean, 99.9)
    error = np.sqrt(np.mean((picture - mean)**2)) / span
    assert error < 0.016
    assert error < 0.6 * np.sqrt(np.mean((sharp - mean)**2)) / span


def test_short_paths_are_as_wide_as_they_are_long(pole):
    """Paths of 0.2 to 0.7 px across an edge: its variance grows by length^2 / 12, not by more."""
    exposure_s = 2e-3
    with renderer_of(pole, exposure_s=exposure_s) as renderer:
        still = light(renderer, turning())
        place_still, variance_still = right_edge(still)
        for rate in (0.5, 1.0, 1.5):
            place, variance = right_edge(light(renderer, turning(rate)))
            length = renderer.rig.focal_px * rate * exposure_s
            grown = np.mean(variance - variance_still)
            assert grown == pytest.approx(length**2 / 12.0, rel=0.25)
            assert abs(np.mean(place - place_still)) < 0.01


@pytest.mark.parametrize('k1', [0.0, -0.2])
def test_rolling_rows_skew_an_edge(pole, k1):
    """Each row of the sensor is exposed a line time after the one above it.

    The middle one is exposed at the stamp. With distortion, rows are those of the picture, not of
    the pinhole image behind it; these would be off by 3 %.
    """
    line_s, rate, rows = 5e-5, 2.0, np.arange(8, 70)
    camera = dataclasses.replace(CAMERA, distortion=(k1, -0.25 * k1, 0.0, 0.0, 0.0))
    with renderer_of(pole, camera=camera, line_time_s=line_s, exposure_s=1e-5,
                     full_well_e=1e4) as renderer:
        moving = right_edge(light(renderer, turning(rate)), rows)[0]
        K, turn = renderer.rig.K, renderer.rig.T_base_left[2, :3] * rate
    with renderer_of(pole, camera=camera) as renderer:
        still = right_edge(light(renderer, turning()), rows)[0]
    with renderer_of(pole, camera=camera, line_time_s=line_s) as renderer:
        blurred = right_edge(light(renderer, turning(rate)), rows)[0]
    seen = np.stack([(still - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1]], axis=-1)
    ray = np.insert(undistort(seen, camera.distortion), 2, 1.0, axis=1)
    time = (rows - 0.5 * (CAMERA.height - 1)) * line_s
    there = ray - np.cross(turn, ray) * time[:, None]
    moved = distort(there[:, :2] / there[:, 2:], camera.distortion) * K[0, 0] + K[0, 2]
    expected = moved[:, 0] - still
    assert abs(expected).max() > 2.0
    ratio = np.sum((moving - still) * expected) / np.sum(expected**2)
    assert ratio == pytest.approx(1.0, abs=0.015)
    # With a long exposure rows are blurred around the same places.
    assert abs(np.mean(blurred - moving)) < 0.05


@pytest.fixture(scope='module')
def looking_down():
    """A rover whose cameras see its own deck and front legs."""
    return RoverDescription(stereo=StereoMount(position_m=(-0.02, 0.0, 0.22), pitch_deg=45.0))


def test_the_body_of_the_rover_does_not_blur(looking_down):
    """It moves with the camera. The ground beside it blurs as without it."""
    world = scene.plane(heights=scene.hills())
    at = scene.pose(z=float(world.height_at((0.0, 0.0))) + 0.1)
    with renderer_of(world, looking_down, detail=scene.DetailConfig(),
                     sun=scene.RELIEF_SUN) as renderer:
        still, moving = RoverPose(at), RoverPose(at, **WALK)
        label = renderer.render(still, 0, ('label',)).label
        sharp, blurred = light(renderer, still), light(renderer, moving)
        mean = sub_exposures(renderer, moving, 16)
    rover = rover_links(label)
    assert 0.03 < rover.mean() < 0.7
    # Glints of the rover are many times as bright as the ground, and turn with it.
    span = np.percentile(mean[~rover], 99.9)
    np.testing.assert_allclose(blurred[rover], sharp[rover], atol=1e-3 * span)
    assert np.abs(blurred - sharp)[~rover].max() > 0.05 * span
    assert np.sqrt(np.mean((blurred - mean)[~rover]**2)) < 0.02 * span


def test_legs_blur_as_they_turn(looking_down):
    """A rover that stands and turns its legs: they blur, and nothing else does."""
    at, legs = scene.pose(z=0.5), np.full(4, np.radians(100.0))
    with renderer_of(scene.plane(), looking_down) as renderer:
        state = RoverPose(at, legs, joint_velocity_radps=np.full(4, 20.0))
        label = renderer.render(state, 0, ('label',)).label
        sharp, blurred = light(renderer, RoverPose(at, legs)), light(renderer, state)
        mean = sub_exposures(renderer, state, 16)
        legs_out = light(renderer, RoverPose(at, legs + np.pi))
    span = np.percentile(mean, 99.9)
    moved = np.abs(blurred - sharp) > 0.02 * span
    assert np.any(moved) and np.any(sharp != legs_out)
    assert np.mean(moved[rover_links(label)]) > 2.0 * np.mean(moved)
    error, without = (np.sqrt(np.mean((image - mean)**2)) for image in (blurred, sharp))
    assert error < 0.85 * without      # the light on a leg changes too


def test_motion_that_is_not_finite_is_refused(renderer):
    for name in ('linear_velocity_mps', 'angular_velocity_radps', 'joint_velocity_radps'):
        state = dataclasses.replace(turning(), **{name: np.full(3, np.nan)})
        with pytest.raises(RenderError, match=name):
            renderer.render(state)
