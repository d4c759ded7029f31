"""Whole topics as arrays, and the distance driven."""

import math

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import CameraCalibration, read_imu, read_odometry
from lunar_rover_sim.bag.totals import driven_distance_m, every_step
from lunar_rover_sim.base.errors import BagError


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    return synthetic.drive(0.2, state_hz=50)


@pytest.fixture(scope='module')
def bag(items, tmp_path_factory):
    with open_bag(synthetic.write(tmp_path_factory.mktemp('series') / 'bag', items)) as bag:
        yield bag


def messages(items: list[synthetic.Item], topic: str) -> list:
    return [item.message for item in items if item.topic == topic]


def numbers(parts: list, names: str) -> np.ndarray:
    return np.array([[getattr(part, name) for name in names] for part in parts])


def test_imu(bag, items):
    series, samples = read_imu(bag), messages(items, 'imu/data_raw')
    assert len(series.stamps_ns) == len(samples) == 10
    assert np.all(np.diff(series.stamps_ns) == 20_000_000)
    np.testing.assert_array_equal(series.specific_forces_mps2,
                                  numbers([s.linear_acceleration for s in samples], 'xyz'))
    np.testing.assert_array_equal(series.rates_radps,
                                  numbers([s.angular_velocity for s in samples], 'xyz'))


def test_odometry(bag, items):
    series, poses = read_odometry(bag), messages(items, 'odom')
    np.testing.assert_array_equal(
        series.positions_m, numbers([m.pose.pose.position for m in poses], 'xyz'))
    np.testing.assert_array_equal(
        series.orientations_wxyz, numbers([m.pose.pose.orientation for m in poses], 'wxyz'))
    twists = [m.twist.twist for m in poses]
    np.testing.assert_array_equal(series.twists, np.hstack([
        numbers([t.linear for t in twists], 'xyz'), numbers([t.angular for t in twists], 'xyz')]))


def test_frames_have_what_the_messages_of_their_stamp_have(tmp_path):
    """Images and pose of each stereo stamp, depth of every second one, in order."""
    items = synthetic.drive(0.4, depth_every=2)
    of = {topic: {header_ns(m): m for m in messages(items, topic)} for topic in (
        'stereo/left/image_raw', 'stereo/right/image_raw', 'ground_truth/depth/image', 'odom')}
    with open_bag(synthetic.write(tmp_path / 'bag', items)) as bag:
        frames = list(bag.frames())
    assert [frame.stamp_ns for frame in frames] == [k * 100_000_000 for k in range(1, 5)]
    for frame in frames:
        for pixels, topic in ((frame.left, 'left'), (frame.right, 'right')):
            message = of[f'stereo/{topic}/image_raw'][frame.stamp_ns]
            np.testing.assert_array_equal(pixels.ravel(), message.data)
        np.testing.assert_array_equal(frame.pose, pose_matrix(of['odom'][frame.stamp_ns]))
        depth = of['ground_truth/depth/image'].get(frame.stamp_ns)
        assert (frame.depth_m is None) == (depth is None)
        if depth is not None:
            np.testing.assert_array_equal(frame.depth_m.ravel(), depth.data.view('<f4'))


def test_frames_without_what_a_bag_lacks(tmp_path):
    items = [i for i in synthetic.drive(0.2) if i.topic == 'stereo/left/image_raw']
    with open_bag(synthetic.write(tmp_path / 'left', items)) as bag:
        assert [frame[2:] for frame in bag.frames()] == [(None, None, None)] * 2
    with open_bag(synthetic.write(tmp_path / 'blind', synthetic.latched_items())) as bag:
        with pytest.raises(BagError, match='has no topic stereo/left/image_raw'):
            next(bag.frames())


def test_a_calibration_by_its_numbers():
    """Principal point and focal lengths differ; the right camera lies a baseline away."""
    K = np.array([[410.0, 0.0, 321.5], [0.0, 430.0, 238.25], [0.0, 0.0, 1.0]])
    P = np.hstack([K, [[-410.0 * 0.12], [0.0], [0.0]]])
    found = CameraCalibration(640, 480, K, np.zeros(5), np.eye(3), P, 'plumb_bob', 'right')
    assert found.fx_fy_cx_cy_px == (410.0, 430.0, 321.5, 238.25)
    assert found.baseline_m == pytest.approx(0.12)


def test_rocking_is_no_distance():
    """At 200 Hz, 5 mm of rocking at 10 Hz would add 1 m/s to 0.1 m/s."""
    stamped = [(k * 5_000_000, (0.1 * k * 0.005, 0.0025 * math.sin(0.1 * math.pi * k), 0.0))
               for k in range(1, 2001)]
    assert driven_distance_m(stamped) == pytest.approx(0.1 * 9.995, abs=2e-3)


def test_height_is_no_distance():
    assert driven_distance_m([(0, (0.0, 0.0, 0.0)), (10**9, (3.0, 4.0, 12.0))]) == 5.0


@pytest.mark.parametrize('first_ns', [1_000_000_000, 1_030_000_000, 99_999_999])
def test_of_every_step_the_first_and_the_last_of_all(first_ns):
    """Steps count from the first stamp, wherever that is."""
    stamped = [(first_ns + k * 30_000_000, k) for k in range(10)]
    kept = list(every_step(stamped))
    assert [k for _, k in kept] == [0, 4, 7, 9]
    assert list(every_step(kept)) == kept


@pytest.mark.parametrize('points', [[], [(7, (1.0, 2.0))]])
def test_less_than_two_points_are_no_distance(points):
    assert driven_distance_m(points) == 0.0


def test_a_pause_in_the_recording_is_crossed_straight():
    assert driven_distance_m([(0, (0.0, 0.0)), (60 * 10**9, (0.0, 7.0))]) == 7.0
