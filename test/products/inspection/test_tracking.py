"""Whether a frame rate fits its motion, by motions of a known answer; the last lines of a run."""

import copy
import dataclasses

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.products.inspection import tracking
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status
from lunar_rover_sim.products.inspection.summary import summarise
from lunar_rover_sim.products.inspection.tracking import LOST_PX, prediction_miss
from lunar_rover_sim.rover.description import RoverDescription

SCENARIO = 'rover:\n  ros__parameters: {legs: {spoke_length_m: 0.08}}\n'


def drive(monkeypatch, factor, **options):
    """Return a drive whose body pitches `factor` times as much, without its images."""
    gentle = synthetic.pose_at

    def pose_at(t):
        T = gentle(t)
        nod = synthetic.frames.wxyz_from_rpy(0.0, 0.02 * factor * np.sin(20.0 * t), 0.0)
        T[:3, :3] = T[:3, :3] @ synthetic.frames.matrix_from_wxyz(nod)
        return T

    monkeypatch.setattr(synthetic, 'pose_at', pose_at)
    items = [i for i in synthetic.drive(1.0, **options)
             if i.topic in (topics.ODOM.name, topics.LEFT_INFO.name, topics.SCENARIO.name)]
    next(i for i in items if i.topic == topics.SCENARIO.name).message.data = SCENARIO
    return items


def test_a_rate_that_is_too_low_is_a_warning_that_names_one_that_is_not(tmp_path, monkeypatch):
    path = synthetic.write(tmp_path / 'bag', drive(monkeypatch, 5.0))
    found = summarise(path).tracking
    assert [miss.rate_hz for miss in found] == pytest.approx([10.0, 20.0, 40.0])   # of 200 Hz
    assert found[0].median_px > 2.0 * found[1].median_px > 4.0 * found[2].median_px
    assert found[0].lost > tracking.MAX_LOST >= found[1].lost
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.status is Status.WARN
    assert finding.detail == tracking.sentence(found)
    assert 'at 10 Hz' in finding.detail
    assert 'at 20 Hz by' in finding.detail
    assert finding.detail in summarise(path).lines()


def test_a_gentle_drive_passes(tmp_path, monkeypatch):
    path = synthetic.write(tmp_path / 'bag', drive(monkeypatch, 0.0))
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.status is Status.PASS
    assert finding.detail.count('Hz') == 1


def test_the_truth_is_judged_where_it_has_a_topic_of_its_own(tmp_path, monkeypatch):
    """An estimator owns `odom` there; this one stands still."""
    items = drive(monkeypatch, 5.0)
    truth = [copy.deepcopy(item) for item in items if item.topic == topics.ODOM.name]
    for item in truth:
        item.topic = topics.TRUE_ODOM.name
    still = truth[0].message.pose.pose
    for item in items:
        if item.topic == topics.ODOM.name:
            item.message.pose.pose = still
    path = synthetic.write(tmp_path / 'bag', items + truth)
    found = summarise(path).tracking
    assert found[0].lost > tracking.MAX_LOST
    finding = next(f for f in check(path).findings if f.check == 'tracking')
    assert finding.detail == tracking.sentence(found)


def test_a_bag_that_does_not_describe_its_rover_is_not_judged(tmp_path, monkeypatch):
    items = [i for i in drive(monkeypatch, 1.0) if i.topic != topics.SCENARIO.name]
    path = synthetic.write(tmp_path / 'bag', items)
    assert [f.status for f in check(path).findings if f.check == 'tracking'] == [Status.SKIP]
    assert 'tracking' not in summarise(path).lines()


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
    x = np.array([0.0, 0.0, 0.02])
    near, far = (prediction_miss(poses(0.0 * x, x), rig(30.0), h, 10.0) for h in (0.1, 5.0))
    assert near.median_px > 5.0 * far.median_px > 0.0


def test_cameras_that_see_only_sky_still_turn():
    camera = rig(-60.0)
    yaw = np.array([0.0, 0.0, 0.01])
    miss = prediction_miss(poses(0.0 * yaw, 0.0, yaw), camera, HEIGHT_M, 10.0)
    assert miss.median_px > 1.0


@pytest.mark.parametrize('n', [0, 1, 2])
def test_fewer_than_three_frames_say_nothing(n):
    assert prediction_miss(np.tile(np.eye(4), (n, 1, 1)), rig(), HEIGHT_M, 10.0) is None


def states(*told, topic=topics.SLAM_STATUS, reason=''):
    """Return what slam_node publishes of frames 50 ms apart."""
    values = [synthetic.msg('diagnostic_msgs/KeyValue', key='reason', value=reason)]
    return [synthetic.item(topic, synthetic.msg(
        'diagnostic_msgs/DiagnosticArray', header=synthetic.header(50_000_000 * k, ''),
        status=[synthetic.msg('diagnostic_msgs/DiagnosticStatus', level=0, name='',
                              message=state, hardware_id='', values=values)]))
            for k, state in enumerate(told, start=1)]


def test_frames_are_counted_by_what_became_of_them(tmp_path):
    path = synthetic.write(tmp_path / 'bag', states('initialising', 'tracking', 'lost',
                                                    'initialising', 'tracking', 'tracking'))
    summary = summarise(path)
    assert summary.slam == {'initialising': 2, 'tracking': 3, 'lost': 1}
    assert 'slam: 6 frames answered: 2 initialising, 1 lost, 3 tracking' \
        in summary.lines().splitlines()


def test_the_end_of_a_goal_is_told(tmp_path):
    told = states('following', 'arrived', topic=topics.NAVIGATOR_STATUS, reason='at x 1 m')
    lines = summarise(synthetic.write(tmp_path / 'bag', told)).lines().splitlines()
    assert 'goal: arrived at x 1 m after 0.1 s' in lines
