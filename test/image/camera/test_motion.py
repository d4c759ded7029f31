"""Motions of cameras relative to ground, body and legs, against differences of their poses."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import inverse, se3
from lunar_rover_sim.image.camera.flow import FlowModel, Moved
from lunar_rover_sim.image.camera.hazard import HazardConfig, HazardMount
from lunar_rover_sim.image.camera.motion import CameraTwist, ground_twist, leg_twists
from lunar_rover_sim.image.camera.mount import BodyMount, MovingMount, TurnedMount
from lunar_rover_sim.rover.description import RoverDescription

ROVER = RoverDescription()
STEP_S = 1e-6
BASE = se3(Rotation.from_euler('ZYX', [0.7, -0.2, 0.4]).as_matrix(), [3.0, -2.0, 0.5])
STATE = SimpleNamespace(T_world_base=BASE, linear_velocity_mps=np.array([0.3, -0.1, 0.2]),
                        angular_velocity_radps=np.array([0.5, -0.7, 1.1]),
                        joint_velocity_radps=np.array([2.0, -1.5, 0.7, 3.1]))
ON_BODY = se3(Rotation.from_euler('ZYX', [-1.2, 0.3, -1.9]).as_matrix(), [0.15, 0.08, 0.2])
BESIDE = se3(Rotation.from_euler('ZYX', [2.1, 0.4, -1.3]).as_matrix(), [2.2, -3.1, 0.9])
BESIDE_VELOCITY, BESIDE_RATE = np.array([-0.4, 0.25, 0.1]), np.array([0.2, 0.6, -0.9])


def base_at(time_s):
    """Return the pose of the body a little later, by its motion."""
    turn = Rotation.from_rotvec(STATE.angular_velocity_radps * time_s).as_matrix()
    return BASE @ se3(turn, STATE.linear_velocity_mps * time_s)


def beside_at(time_s):
    turn = Rotation.from_rotvec(BESIDE_RATE * time_s).as_matrix()
    return se3(turn @ BESIDE[:3, :3], BESIDE[:3, 3] + BESIDE_VELOCITY * time_s)


def leg_at(leg, time_s):
    """Return the pose of a leg: it turns about its axle, along y of the body."""
    angle = float(STATE.joint_velocity_radps[leg]) * time_s
    return base_at(time_s) @ se3(Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix(),
                                 np.array(ROVER.legs.axle_positions_m()[leg]))


def assert_is_motion(twist, camera_at, link_at):
    """Compare a twist with the difference of the camera's pose, as the link sees it."""
    before, after = (inverse(link_at(t)) @ camera_at(t) for t in (-STEP_S, STEP_S))
    now = inverse(link_at(0.0)) @ camera_at(0.0)
    velocity = (after[:3, 3] - before[:3, 3]) / (2.0 * STEP_S) @ now[:3, :3]
    turn = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec() / (2.0 * STEP_S)
    np.testing.assert_allclose(twist.linear_velocity_mps, velocity, atol=1e-7)
    np.testing.assert_allclose(twist.angular_velocity_radps, turn, atol=1e-7)


def test_a_camera_on_the_body_moves_over_the_ground():
    assert_is_motion(ground_twist(STATE, ON_BODY), lambda t: base_at(t) @ ON_BODY,
                     lambda t: np.eye(4))


@pytest.mark.parametrize('leg', range(4))
def test_legs_turn_before_a_camera_on_the_body(leg):
    assert_is_motion(leg_twists(STATE, ON_BODY, ROVER)[leg], lambda t: base_at(t) @ ON_BODY,
                     lambda t: leg_at(leg, t))


def test_cameras_on_the_body_by_their_mount():
    """Each side has its own place; the body itself stands still in the image."""
    other = ON_BODY @ se3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    mount = BodyMount(SimpleNamespace(T_base_left=ON_BODY, T_base_right=other))
    assert mount.on_body
    for side, place in enumerate((ON_BODY, other)):
        np.testing.assert_allclose(mount.poses(STATE)[side], BASE @ place)
        assert_is_motion(mount.ground_twist(STATE, side), lambda t: base_at(t) @ place,
                         lambda t: np.eye(4))
        body, *legs = mount.link_twists(STATE, side, ROVER)
        assert not body.linear_velocity_mps.any() and not body.angular_velocity_radps.any()
        for leg, twist in enumerate(legs):
            assert_is_motion(twist, lambda t: base_at(t) @ place, lambda t: leg_at(leg, t))


def test_a_camera_beside_the_rover():
    """It moves over the ground, before the body and before each leg."""
    mount = MovingMount()
    assert not mount.on_body
    for pose in mount.poses(STATE):
        np.testing.assert_array_equal(pose, np.eye(4))
    assert not mount.ground_twist(STATE, 0).linear_velocity_mps.any()
    mount.place(BESIDE, BESIDE_VELOCITY, BESIDE_RATE)
    left, right = mount.poses(STATE)
    np.testing.assert_array_equal(left, BESIDE)
    np.testing.assert_array_equal(right, BESIDE)
    assert_is_motion(mount.ground_twist(STATE, 0), beside_at, lambda t: np.eye(4))
    body, *legs = mount.link_twists(STATE, 1, ROVER)
    assert_is_motion(body, beside_at, base_at)
    assert len(legs) == 4
    for leg, twist in enumerate(legs):
        assert_is_motion(twist, beside_at, lambda t: leg_at(leg, t))
    mount.place(BESIDE)
    still = mount.ground_twist(STATE, 0)
    assert not still.linear_velocity_mps.any() and not still.angular_velocity_radps.any()


def test_speeds_in_the_image_are_those_of_projected_points():
    """Points stand still while the camera moves: x / z and y / z change at that speed."""
    twist = CameraTwist(np.array([0.4, -0.3, 0.9]), np.array([0.2, 1.3, -0.6]))
    rng = np.random.default_rng(2)
    rays = np.concatenate([rng.uniform(-0.7, 0.7, (30, 2)), np.ones((30, 1))], axis=1)
    depth = rng.uniform(0.5, 30.0, 30)

    def seen(time_s):
        turn = Rotation.from_rotvec(twist.angular_velocity_radps * time_s).as_matrix()
        points = (rays * depth[:, None] - twist.linear_velocity_mps * time_s) @ turn
        return points[:, :2] / points[:, 2:]

    expected = np.linalg.norm(seen(STEP_S) - seen(-STEP_S), axis=1) / (2.0 * STEP_S)
    np.testing.assert_allclose(twist.image_speed(rays, 1.0 / depth), expected, rtol=1e-6)


def test_turned_cameras_keep_their_places():
    mount = BodyMount(SimpleNamespace(T_base_left=ON_BODY, T_base_right=np.eye(4)))
    turn = Rotation.from_euler('YX', [0.5, -0.2]).as_matrix()
    for pose, turned in zip(mount.poses(STATE), TurnedMount(mount, turn).poses(STATE)):
        np.testing.assert_allclose(turned[:3, 3], pose[:3, 3])
        np.testing.assert_allclose(turned[:3, :3], pose[:3, :3] @ turn)


@pytest.mark.parametrize('baseline_m', [0.0, 0.12])
def test_hazard_cameras_look_where_they_are_told_to(baseline_m):
    """Yaw 130 deg and pitch 20 deg: to the left and back, down; left and right lie across."""
    config = HazardConfig(position_m=(0.1, -0.2, 0.3), orientation_rpy_deg=(0.0, 20.0, 130.0),
                          stereo_baseline_m=baseline_m)
    left, right = HazardMount(config).poses(SimpleNamespace(T_world_base=np.eye(4)))
    yaw, pitch = np.radians([130.0, 20.0])
    ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), -np.sin(pitch)])
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    for pose, side in ((left, 1.0), (right, -1.0)):
        np.testing.assert_allclose(pose[:3, 2], ahead, atol=1e-12)      # z is the optical axis
        np.testing.assert_allclose(pose[:3, 0], -across, atol=1e-12)    # x to the right
        np.testing.assert_allclose(
            pose[:3, 3], np.array(config.position_m) + 0.5 * side * baseline_m * across)


K = np.array([[50.0, 0.0, 15.5], [0.0, 55.0, 11.5], [0.0, 0.0, 1.0]])
HEIGHT, WIDTH = 24, 32


def pose(angles_deg, position_m):
    result = np.eye(4)
    result[:3, :3] = Rotation.from_euler('ZYX', angles_deg, degrees=True).as_matrix()
    result[:3, 3] = position_m
    return result


CAMERA = pose((70.0, 5.0, -95.0), (3.0, -1.0, 0.4))
OTHER = pose((74.0, 3.0, -93.0), (3.2, -0.7, 0.5))
BODY = pose((10.0, 0.0, 0.0), (2.0, 1.0, 0.0))
BODY_OTHER = pose((25.0, 4.0, 0.0), (2.2, 1.1, 0.1))


@pytest.fixture(scope='module')
def scene():
    """Return depths of 2 m to 5 m, some of them sky, and where the body is seen."""
    rng = np.random.default_rng(4)
    depth = rng.uniform(2.0, 5.0, (HEIGHT, WIDTH)).astype(np.float32)
    depth[:3] = np.inf
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:20, 5:18] = True
    return depth, mask


def followed(depth, v, u, moves):
    """Return where the point of a pixel is in either camera [m]."""
    here = depth * np.linalg.inv(K) @ [u, v, 1.0]
    in_world = CAMERA @ np.append(here, 1.0)
    if moves:
        in_world = BODY_OTHER @ np.linalg.inv(BODY) @ in_world
    return here, (np.linalg.inv(OTHER) @ in_world)[:3]


def test_flow_is_where_each_point_has_gone(scene):
    depth, mask = scene
    model = FlowModel(K, depth, CAMERA, OTHER, [Moved(mask, BODY, BODY_OTHER)])
    optical, moved = model.optical_flow(), model.scene_flow()
    assert optical.shape == (HEIGHT, WIDTH, 2) and moved.shape == (HEIGHT, WIDTH, 3)
    assert optical.dtype == moved.dtype == np.float32
    for v, u in [(5, 0), (5, 31), (23, 0), (10, 5), (15, 9), (19, 17), (20, 17), (9, 5)]:
        here, there = followed(float(depth[v, u]), v, u, mask[v, u])
        pixel = K @ there / there[2]
        assert optical[v, u] == pytest.approx(pixel[:2] - [u, v], abs=1e-3)
        assert moved[v, u] == pytest.approx(there - here, abs=1e-5)


def test_the_sky_turns_with_the_camera_and_has_no_place(scene):
    depth, _ = scene
    model = FlowModel(K, depth, CAMERA, OTHER)
    turn = OTHER[:3, :3].T @ CAMERA[:3, :3]
    for v, u in [(0, 0), (2, 31)]:
        pixel = K @ turn @ np.linalg.inv(K) @ [u, v, 1.0]
        assert model.optical_flow()[v, u] == pytest.approx(pixel[:2] / pixel[2] - [u, v], abs=1e-3)
    assert np.isnan(model.scene_flow()[:3]).all() and np.isfinite(model.scene_flow()[3:]).all()


def test_a_point_behind_the_other_camera_has_no_flow():
    """1 m ahead of the camera, which then stands 2 m farther on; the next point is at 4 m."""
    depth = np.array([[1.0, 4.0]], np.float32)
    ahead = np.eye(4)
    ahead[2, 3] = 2.0
    model = FlowModel(K, depth, np.eye(4), ahead)
    flow = model.optical_flow()
    assert np.isnan(flow[0, 0]).all()
    # Half the depth: twice as far from the principal point.
    assert flow[0, 1] == pytest.approx([1.0 - 15.5, 0.0 - 11.5], abs=1e-4)
    assert model.scene_flow()[0, 0] == pytest.approx([0.0, 0.0, -2.0])
