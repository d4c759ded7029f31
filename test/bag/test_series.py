"""Whole topics as arrays, and the distance driven."""

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.bag.reader import open_bag
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


def test_rocking_is_no_distance():
    """At 200 Hz, 5 mm of rocking at 10 Hz would add 1 m/s to 0.1 m/s."""
    k = np.arange(1, 2001)
    places = np.stack([0.1 * k * 0.005, 0.0025 * np.sin(0.1 * np.pi * k), 0.0 * k], axis=1)
    assert driven_distance_m(k * 5_000_000, places) == pytest.approx(0.1 * 9.995, abs=2e-3)


def test_height_is_no_distance():
    assert driven_distance_m(np.array([0, 10**9]),
                             np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 12.0]])) == 5.0


@pytest.mark.parametrize('first_ns', [1_000_000_000, 1_030_000_000, 99_999_999])
def test_of_every_step_the_first_and_the_last_of_all(first_ns):
    """Steps count from the first stamp, wherever that is."""
    stamps_ns = first_ns + 30_000_000 * np.arange(10)
    kept = every_step(stamps_ns)
    assert kept.tolist() == [0, 4, 7, 9]
    assert every_step(stamps_ns[kept]).tolist() == [0, 1, 2, 3] and not len(every_step(kept[:0]))


def test_a_pause_in_the_recording_is_crossed_straight():
    assert driven_distance_m(np.array([0, 60 * 10**9]), np.array([[0.0, 0.0], [0.0, 7.0]])) == 7.0
