"""The chase camera: where it hangs, and how it moves."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount, looking_at
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose


def pose_at(x_m: float, y_m: float, yaw_rad: float = 0.0, z_m: float = 0.1) -> RoverPose:
    """Return a rover that stands somewhere."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return RoverPose(se3(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]),
                         np.array([x_m, y_m, z_m])))


@pytest.mark.parametrize(('reference', 'azimuth_deg'), [('sun', 60.0), ('heading', 90.0),
                                                        ('east', 0.0)])
def test_place(reference: str, azimuth_deg: float) -> None:
    """It is as far, as high and in the direction that it was told, with a level horizon."""
    config = ChaseConfig(distance_m=2.0, azimuth_deg=30.0, elevation_deg=20.0,
                         reference=reference, aim_m=0.0)
    mount = ChaseMount(config, 60.0, scene.plane())
    mount.follow(pose_at(3.0, -1.0, np.radians(90.0)))
    T = mount.T_world_camera
    arm = T[:3, 3] - [3.0, -1.0, 0.1]
    assert np.linalg.norm(arm) == pytest.approx(2.0)
    assert np.degrees(np.arcsin(arm[2] / 2.0)) == pytest.approx(20.0)
    assert np.degrees(np.arctan2(arm[1], arm[0])) == pytest.approx(azimuth_deg + 30.0)
    assert T[:3, 2] == pytest.approx(-arm / 2.0)        # it looks at the rover
    assert T[2, 0] == pytest.approx(0.0) and T[2, 1] < 0.0


def test_walk_does_not_shake_it() -> None:
    """A rover that bobs by 1 cm at 2 Hz moves the camera by a tenth of that; it keeps up."""
    mount = ChaseMount(ChaseConfig(), 60.0, scene.plane())
    heights, lags = [], []
    for k in range(400):
        t = 0.05 * k
        mount.follow(pose_at(0.12 * t, 0.0, z_m=0.1 + 0.01 * np.sin(4.0 * np.pi * t)),
                     round(t * 1e9))
        heights.append(mount.T_world_camera[2, 3])
        lags.append(0.12 * t - mount.T_world_camera[0, 3])
    assert np.ptp(heights[100:]) < 0.1 * 0.02
    # A lag of first order trails by the speed times the time constant.
    assert np.ptp(lags[200:]) < 1e-3
    assert lags[-1] - lags[0] == pytest.approx(0.12 * (0.8 - 0.025), abs=3e-3)


def test_it_swings_the_short_way_round() -> None:
    """A rover turns by large angles, also through west: what is left falls by exp(-t / T)."""
    mount = ChaseMount(ChaseConfig(smoothing_s=0.7, reference='heading', azimuth_deg=30.0,
                                   aim_m=0.0), 60.0, scene.plane())
    mount.follow(pose_at(0.0, 0.0, 0.0))
    shown_deg = 0.0
    for k, yaw_deg in enumerate((120.0, -150.0, 100.0, 170.0, -20.0, 150.0, -160.0), 1):
        mount.follow(pose_at(0.0, 0.0, np.radians(yaw_deg)), k * 500_000_000)
        left_deg = (yaw_deg - shown_deg + 180.0) % 360.0 - 180.0
        shown_deg += left_deg * (1.0 - np.exp(-0.5 / 0.7))
        x, y, _ = mount.T_world_camera[:3, 3]
        assert np.exp(1j * np.arctan2(y, x)) == pytest.approx(
            np.exp(1j * np.radians(shown_deg + 30.0)))


def test_jump_and_repetition() -> None:
    """The same state again does not move it; a rover that is placed anew is there at once."""
    mount = ChaseMount(ChaseConfig(), 60.0, scene.plane())
    mount.follow(pose_at(0.0, 0.0), 10**9)
    mount.follow(pose_at(0.1, 0.0), 2 * 10**9)
    before = mount.T_world_camera.copy()
    mount.follow(pose_at(0.1, 0.0), 2 * 10**9)
    assert np.array_equal(mount.T_world_camera, before)
    mount.follow(pose_at(9.0, 0.0), 2 * 10**9 + 50_000_000)
    fresh = ChaseMount(ChaseConfig(), 60.0, scene.plane())
    fresh.follow(pose_at(9.0, 0.0))
    assert mount.T_world_camera == pytest.approx(fresh.T_world_camera)


def test_above_the_ground() -> None:
    """A camera that would be below the ground is lifted above it, and still looks at the rover."""
    mount = ChaseMount(ChaseConfig(elevation_deg=-30.0), 60.0, scene.plane())
    mount.follow(pose_at(0.0, 0.0))
    T = mount.T_world_camera
    assert T[2, 3] == pytest.approx(0.15)
    ahead = np.array([0.0, 0.0, 0.15]) - T[:3, 3]
    assert T[:3, 2] == pytest.approx(ahead / np.linalg.norm(ahead))


@pytest.mark.parametrize(('offset_m', 'lifted'), [
    ((0.0, 0.0), True), ((0.39, 0.0), True), ((0.41, 0.0), False), ((0.0, -0.39), True),
    ((0.0, -0.41), False)])
def test_beside_and_above_rocks(offset_m: tuple[float, float], lifted: bool) -> None:
    """A camera nearer than 15 cm to the side of a rock is 15 cm or more above its top."""
    rock = (2.0 + offset_m[0], offset_m[1], 0.1)
    world = scene.plane(stones=scene.rocks([rock], 0.5))
    config = ChaseConfig(reference='east', azimuth_deg=0.0, elevation_deg=0.0, distance_m=2.0,
                         aim_m=0.0)
    mount = ChaseMount(config, 0.0, world)
    mount.follow(pose_at(0.0, 0.0, z_m=0.2))
    # Its centre at 0.1 m, its radius 0.25 m.
    assert mount.T_world_camera[2, 3] == pytest.approx(0.5 if lifted else 0.2)


@pytest.mark.parametrize('direction', [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_tripod_stands_on_a_wall_beside_it(direction: tuple[int, int]) -> None:
    """Ground within 0.15 m on any side counts: the camera is above all of it."""
    axis = (np.arange(129) - 64) * 0.05
    beside = axis[None, :] * direction[0] + axis[:, None] * direction[1] > 0.08
    world = scene.plane(n=129, cell_m=0.05, heights=1.0 * beside)
    mount = ChaseMount(ChaseConfig(mode='tripod', position_m=(0.0, 0.0, 0.3)), 0.0, world)
    mount.follow(pose_at(-2.0 * direction[0], -2.0 * direction[1]))
    assert mount.T_world_camera[2, 3] == pytest.approx(1.3)


def test_it_sinks_back_slowly_behind_a_hill() -> None:
    """After a rock it comes down with the time constant of the following."""
    mount = ChaseMount(ChaseConfig(reference='east', azimuth_deg=0.0, elevation_deg=-20.0,
                                   distance_m=1.0, aim_m=0.0, smoothing_s=2.0), 0.0, scene.plane())
    mount.follow(pose_at(0.0, 0.0, z_m=0.1))
    wanted = 0.1 - np.sin(np.radians(20.0))
    assert mount.T_world_camera[2, 3] == pytest.approx(0.15)
    raised = 0.15 - wanted
    # The rover rises by 0.4 m within the way that is followed: less is lacking.
    mount.follow(pose_at(0.0, 0.0, z_m=0.5), 10**9)
    share = 1.0 - np.exp(-0.5)
    followed = wanted + share * 0.4
    lack = max(0.15 - followed, 0.0)
    assert mount.T_world_camera[2, 3] == pytest.approx(followed + raised + share * (lack - raised))


def test_what_is_placed_anew() -> None:
    """Farther than half a metre and 5 m/s, or back in time: there at once; else with the lag."""
    for x_m, stamp_ns, at_once in ((1.45, 1_200_000_000, False), (1.55, 1_200_000_000, True),
                                   (0.1, 900_000_000, True), (0.1, 1_100_000_000, False)):
        mount = ChaseMount(ChaseConfig(), 60.0, scene.plane())
        mount.follow(pose_at(0.0, 0.0), 10**9)
        first = mount.T_world_camera[0, 3]
        mount.follow(pose_at(x_m, 0.0), stamp_ns)
        assert (mount.T_world_camera[0, 3] - first == pytest.approx(x_m)) == at_once


def test_tripod() -> None:
    """It stands where it was put, and turns after the rover."""
    mount = ChaseMount(ChaseConfig(mode='tripod', position_m=(2.0, 1.0, 0.7), smoothing_s=0.0),
                       60.0, scene.plane())
    for k in range(3):
        mount.follow(pose_at(0.1 * k, 0.0), k * 10**8)
        assert mount.T_world_camera[:3, 3] == pytest.approx([2.0, 1.0, 0.7])
        arm = np.array([0.1 * k - 2.0, -1.0, 0.15 - 0.7])
        assert mount.T_world_camera[:3, 2] == pytest.approx(arm / np.linalg.norm(arm))


@pytest.mark.parametrize(('position_m', 'words'), [
    ((1.0, 0.0, -0.5), r'-0\.5 m above the ground is not valid; valid is a height > 0 m'),
    ((1e4, 2.0, 0.5), r'\(10000, 2\) lies outside the world; valid are x and y within')])
def test_tripods_that_cannot_stand(position_m: tuple[float, ...], words: str) -> None:
    """In the ground nothing can be seen; outside the world there is no ground to stand on."""
    with pytest.raises(ConfigError, match=f'chase.position_m: {words}'):
        ChaseMount(ChaseConfig(mode='tripod', position_m=position_m), 60.0, scene.plane())


@pytest.mark.parametrize('config', [
    ChaseConfig(reference='heading', azimuth_deg=150.0, smoothing_s=0.3),
    ChaseConfig(), ChaseConfig(mode='tripod', smoothing_s=0.1)])
def test_twist(config: ChaseConfig) -> None:
    """What it says of its motion is how fixed points and points on the legs move before it."""
    rover, step_s = RoverDescription(), 1e-4
    mount = ChaseMount(config, 60.0, scene.plane())
    speed, yaw_rate, leg_rate = 0.3, 0.4, 2.0

    def state_at(t: float) -> RoverPose:
        heading = yaw_rate * t
        place = speed / yaw_rate * np.array([np.sin(heading), 1.0 - np.cos(heading)])
        T = pose_at(*place, heading).T_world_base
        return RoverPose(T, np.full(4, leg_rate * t), np.array([speed, 0.0, 0.0]),
                         np.array([0.0, 0.0, yaw_rate]), np.full(4, leg_rate))

    for k in range(2):
        mount.follow(state_at(k), k * 10**9)
    # One more, short step: its mean motion is that of its end.
    before = mount.T_world_camera.copy()
    state, after = state_at(1.0), state_at(1.0 + step_s)
    mount.follow(after, 10**9 + round(step_s * 1e9))
    now = mount.T_world_camera
    axle = np.asarray(rover.legs.axle_positions_m()[2], float)

    def on_leg(pose: RoverPose) -> Array:
        a = float(pose.joint_angle_rad[2])
        foot = axle + 0.05 * np.array([np.sin(a), 0.0, np.cos(a)])
        return pose.T_world_base[:3, :3] @ foot + pose.T_world_base[:3, 3]

    twists = [mount.ground_twist(after, 0), *mount.link_twists(after, 0, rover)]
    for twist, first, last in ((twists[0], *[np.array([0.3, 0.2, 0.0])] * 2),
                               (twists[1], *(p.T_world_base[:3, 3] for p in (state, after))),
                               (twists[4], on_leg(state), on_leg(after))):
        seen = [T[:3, :3].T @ (point - T[:3, 3]) for T, point in ((before, first), (now, last))]
        moved = (seen[1] - seen[0]) / step_s
        said = -(twist.linear_velocity_mps + np.cross(twist.angular_velocity_radps, seen[1]))
        assert said == pytest.approx(moved, abs=2e-3)


def test_straight_down_has_a_picture() -> None:
    """From right above, no direction is up in the image; a rotation is returned all the same."""
    T = looking_at(np.array([0.0, 0.0, 5.0]), np.zeros(3))
    assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3))
