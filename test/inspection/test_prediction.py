"""How far constant velocity mispredicts the image, against motions with a known answer."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.inspection.tracking import LOST_PX, prediction_miss
from lunar_rover_sim.rover.description import RoverDescription

HEIGHT_M = 0.1


def rig(pitch_deg=10.0):
    rover = RoverDescription()
    mount = dataclasses.replace(rover.stereo, pitch_deg=pitch_deg)
    return StereoRig(dataclasses.replace(rover, stereo=mount), CameraConfig())


def poses(pitch_rad, x_m=0.0, yaw_rad=0.0):
    rows = np.broadcast_arrays(pitch_rad, x_m, yaw_rad)
    return np.array([se3(matrix_from_wxyz(wxyz_from_rpy(0.0, p, y)), (x, 0.0, HEIGHT_M))
                     for p, x, y in zip(*rows)])


def test_a_steady_motion_is_predicted():
    k = np.arange(20)
    miss = prediction_miss(poses(0.1 + 0.0 * k, 0.012 * k), rig(), HEIGHT_M, 10.0)
    assert miss.p90_px < 1e-6
    assert miss.lost == 0.0
    assert miss.rate_hz == 10.0


def test_a_pitch_misses_by_focal_length_times_its_second_difference():
    """Small steps: the rows shift by f times the change of the pitch's change, at the centre."""
    camera = rig()
    pitch = 0.01 * np.sin(1.3 * np.arange(200))
    second = np.abs(np.diff(pitch, 2))
    miss = prediction_miss(poses(pitch), camera, HEIGHT_M, 10.0)
    assert miss.median_px == pytest.approx(camera.focal_px * np.median(second), rel=0.15)
    assert miss.p90_px == pytest.approx(camera.focal_px * np.percentile(second, 90), rel=0.15)


def test_a_jump_of_the_camera_loses_the_frame_and_the_next():
    """One jump by 3 px, then one by 30 px: only the second and its echo are lost."""
    camera = rig()
    pitch = np.zeros(22)
    pitch[5:] += 3.0 / camera.focal_px
    pitch[12:] += 30.0 / camera.focal_px
    assert LOST_PX == 14.0
    assert prediction_miss(poses(pitch), camera, HEIGHT_M, 10.0).lost == pytest.approx(2 / 20)


@pytest.mark.parametrize('at', [998, 999, 1000, 1001, 1002, 1003])
def test_a_long_drive_is_judged_frame_by_frame(at):
    """A jump is lost in two frames, wherever it comes."""
    camera, n = rig(), 2004
    pitch = np.zeros(n)
    pitch[at:] += 30.0 / camera.focal_px
    assert prediction_miss(poses(pitch), camera, HEIGHT_M, 10.0).lost == 2 / (n - 2)


def test_near_ground_moves_more_than_far_ground():
    """Forward starts are seen in the image by the height of the camera."""
    x = np.concatenate([np.zeros(10), [0.02], np.full(10, 0.02)])
    near = prediction_miss(poses(0.0 * x, x), rig(30.0), 0.1, 10.0)
    far = prediction_miss(poses(0.0 * x, x), rig(30.0), 5.0, 10.0)
    assert near.p90_px > 0.0 or near.median_px == 0.0
    assert np.isfinite([near.p90_px, far.p90_px]).all()
    start_near, start_far = (prediction_miss(poses(0.0 * x[8:11], x[8:11]), rig(30.0), h, 10.0)
                             for h in (0.1, 5.0))
    assert start_near.median_px > 5.0 * start_far.median_px > 0.0


def test_cameras_that_see_only_sky_still_turn():
    camera = rig(-60.0)
    yaw = np.array([0.0, 0.0, 0.01])
    miss = prediction_miss(poses(0.0 * yaw, 0.0, yaw), camera, HEIGHT_M, 10.0)
    assert miss.median_px > 1.0


@pytest.mark.parametrize('n', [0, 1, 2])
def test_fewer_than_three_frames_say_nothing(n):
    assert prediction_miss(np.tile(np.eye(4), (n, 1, 1)), rig(), HEIGHT_M, 10.0) is None
