"""Poses of estimators in the frame of the start."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.poses import AnchoredPoses, LevelledWheels
from lunar_rover_sim.base.frames import (inverse, matrix_from_wxyz, rpy_from_wxyz, se3,
                                         wxyz_from_matrix, wxyz_from_rpy)
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.mounts import optical_poses


def pose(x, y, z, roll=0.0, pitch=0.0, yaw=0.0):
    return se3(matrix_from_wxyz(wxyz_from_rpy(roll, pitch, yaw)), (x, y, z))


def test_poses_of_a_slam_map_are_anchored_at_the_start():
    T_base_camera = optical_poses(load_rover(None))[0]
    start, later = pose(3.0, -2.0, 0.1, 0.02, -0.05, 1.0), pose(4.0, -1.0, 0.2, 0.1, 0.0, 1.4)
    T_map_world = pose(9.0, 8.0, 7.0, 0.3, 0.2, 0.1)
    poses = AnchoredPoses(T_base_camera)
    assert not poses.is_anchored
    for true in (start, later):
        found = poses.base(T_map_world @ true @ T_base_camera, true, start)
        np.testing.assert_allclose(found, true, atol=1e-12)
    poses.restart()
    assert not poses.is_anchored


def test_a_map_that_is_begun_after_a_loss_goes_on_where_the_wheels_say():
    poses = AnchoredPoses(np.eye(4))
    at = [pose(x, 0.1 * x, 0.0, yaw=0.1 * x) for x in (0.0, 1.0, 4.0, 4.2, 5.0)]
    # The wheels have a frame of their own, and have lost 3 % of the way.
    rolled = [pose(7.0, 1.0, 0.0, yaw=0.5) @ pose(0.97 * x, 0.097 * x, 0.0, yaw=0.1 * x)
              for x in (0.0, 1.0, 4.0, 4.2, 5.0)]
    for k in (0, 1, 2):
        np.testing.assert_allclose(poses.base(at[k], rolled[k], at[0]), at[k], atol=1e-12)
    poses.lose()
    second = inverse(at[3])                         # the other map begins there
    found = poses.base(second @ at[3], rolled[3])
    assert np.linalg.norm(found[:3, 3] - at[3][:3, 3]) < 0.03 * 0.2 + 1e-3
    assert poses.maps == 2
    found = poses.base(second @ at[4], rolled[4])
    assert np.linalg.norm(found[:3, 3] - at[4][:3, 3]) < 0.02
    # Its place is recognised: the program goes on in the first map, whose anchor is known.
    np.testing.assert_allclose(poses.base(at[4], rolled[4]), at[4], atol=1e-12)
    assert poses.maps == 2


def test_a_closed_loop_is_followed_and_a_short_loss_begins_no_map():
    poses, start = AnchoredPoses(np.eye(4)), np.eye(4)
    poses.base(start, start, start)
    poses.base(pose(3.0, 0.0, 0.0), pose(3.0, 0.0, 0.0))
    poses.lose()
    assert poses.base(pose(3.2, 0.1, 0.0), pose(3.1, 0.0, 0.0))[1, 3] == 0.1
    assert poses.base(pose(3.2, 1.1, 0.0), pose(3.1, 0.0, 0.0))[1, 3] == 1.1
    assert poses.maps == 1


def test_wheels_with_an_imu_climb_a_slope():
    wheels, pitch, g = LevelledWheels(), np.radians(-8.0), 1.62     # nose up
    force = np.array([-np.sin(pitch), 0.0, np.cos(pitch)]) * g
    start = pose(1.0, 2.0, 0.5, 0.0, pitch, np.pi / 2)
    for k in range(1001):
        wheels.add_imu(k * 5_000_000, (0.0, 0.0, 0.0), force)
        T = wheels.base((0.0005 * k, 0.0, 0.0), start)
    assert T[:3, 3] == pytest.approx((1.0, 2.0 + 0.5 * np.cos(pitch), 0.5 + 0.5 * np.sin(-pitch)),
                                     abs=1e-3)
    assert rpy_from_wxyz(wxyz_from_matrix(T[:3, :3])) == pytest.approx((0.0, pitch, np.pi / 2),
                                                                       abs=1e-6)


def test_the_heading_is_that_of_the_gyroscope_where_legs_slip():
    """A quarter of a circle to the left; legs that slip say that it was half of it."""
    wheels, n, radius = LevelledWheels(), 2000, 1.0
    turn, gravity = 0.5 * np.pi, (0.0, 0.0, 1.62)
    for k in range(n + 1):
        wheels.add_imu(k * 5_000_000, (0.0, 0.0, turn / n / 0.005), gravity)
        said, way = 0.5 * turn * k / n, radius * turn * k / n
        wide = radius * 2.0
        T = wheels.base((wide * np.sin(way / wide), wide * (1.0 - np.cos(way / wide)), said),
                        np.eye(4))
    assert T[:3, 3] == pytest.approx((radius, radius, 0.0), abs=2e-3)
    assert rpy_from_wxyz(wxyz_from_matrix(T[:3, :3]))[2] == pytest.approx(turn, abs=2e-3)


def test_the_gyroscope_carries_a_fast_pitch_which_the_accelerometer_would_miss():
    wheels, g = LevelledWheels(), 1.62
    wheels.base((0.0, 0.0, 0.0), np.eye(4))
    wheels.add_imu(0, (0.0, 0.0, 0.0), (0.0, 0.0, g))
    for k in range(1, 41):      # 0.2 s of 0.5 rad/s, with a push that looks like another slope
        wheels.add_imu(k * 5_000_000, (0.0, 0.5, 0.0), (0.4 * g, 0.0, g))
    T = wheels.base((0.0, 0.0, 0.0))
    assert rpy_from_wxyz(wxyz_from_matrix(T[:3, :3]))[1] == pytest.approx(0.1, abs=0.03)
    wheels.add_imu(41 * 5_000_000, (np.nan, 0.0, 0.0), (0.0, 0.0, g))
    assert np.isfinite(wheels.base((0.0, 0.0, 0.0))).all()
