"""`bag check` and `bag hash`: a good bag passes; every damage is found and named."""

import copy
import dataclasses
from pathlib import Path

import numpy as np
from products.inspection.damages import DAMAGES, drop, edited, SCENARIO, setter
import pytest
import synthetic_bag as synthetic
from synthetic_bag import Item
from synthetic_ground import ground_items

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status


@pytest.fixture(scope='module')
def good() -> list[Item]:
    items = synthetic.drive(0.6, state_hz=100)
    next(i for i in items if i.topic == 'scenario').message.data = \
        SCENARIO.replace('MODE', 'lockstep')
    return items + ground_items(0.6)


def test_a_good_bag_passes(tmp_path, good):
    report = check(synthetic.write(tmp_path / 'bag', good))
    assert report.ok, report.failed
    assert {f.status for f in report.findings} == {Status.PASS}
    assert len(report.findings) >= 15


@pytest.mark.parametrize('damage', DAMAGES)
def test_damage_is_found_and_named(tmp_path, good, damage):
    make, name, words = DAMAGES[damage]
    report = check(synthetic.write(tmp_path / 'bag', make(good)))
    found = {f.check: f.detail for f in report.failed}
    assert name in found
    assert words in found[name]


def test_snapshots_of_the_ground_come_with_every_reader(tmp_path, good):
    """Three readers, of whom the recorder is the first: three in the bag, and nothing is wrong."""
    change = next(i for i in good if i.topic == 'ground/changes')
    items = copy.deepcopy(good)
    items += [Item('ground/snapshot', 'sensor_msgs/msg/PointCloud2', change.message)] * 3
    failed = check(synthetic.write(tmp_path / 'bag', items)).failed
    assert 'latched' not in {finding.check for finding in failed}


def every_second(items: list[Item], depth_every: int = 2) -> list[Item]:
    """Return the items with a scenario that asks for depth with every n-th frame."""
    items = [i for i in items if i.topic != 'ground/changes']
    text = SCENARIO.replace('MODE', 'lockstep').replace(', ground: {model: regolith}', '').replace(
        'frame_rate_hz: 10', f'frame_rate_hz: 10, depth_every: {depth_every}')
    return edited(items, 'scenario', setter('data', text))


def test_hazard_cameras_are_those_of_the_scenario(tmp_path, good):
    """One that was to be recorded is there at its rate, and is the camera of the scenario."""
    name = 'hazard/front/camera_info'
    fov_deg = 2.0 * np.degrees(np.arctan(0.5 * synthetic.WIDTH / synthetic.FOCAL_PX))
    hazard = (f'hazard: {{front: {{rate_hz: 5, camera: {{model: pinhole, width: {synthetic.WIDTH},'
              f' height: {synthetic.HEIGHT}, horizontal_fov_deg: {fov_deg}}}}}}}')
    items = copy.deepcopy([i for i in good if i.topic == 'scenario'])
    text = items[0].message.data.replace('frame_rate_hz: 10', f'frame_rate_hz: 10, {hazard}')
    items[0].message.data = text.replace('[all]', f'[all, {name}]')
    items += [i for i in good if i.topic != 'scenario']
    taken = [Item(name, 'sensor_msgs/msg/CameraInfo', synthetic.camera_info(
        ns, 'hazard_front_optical_frame', 0.0)) for ns in (200_000_000, 400_000_000, 600_000_000)]

    def failed(case: str, more: list[Item]) -> list[tuple[str, str]]:
        report = check(synthetic.write(tmp_path / case, items + more))
        assert 'hazard cameras' in {f.check for f in report.findings}
        return [(f.check, f.detail) for f in report.failed]

    assert failed('whole', taken) == []
    assert failed('none', []) == [('hazard cameras', f'{name}: missing')]
    assert failed('gap', taken[::2]) == [
        ('hazard cameras', f'{name}: 1 of 3 missing, first at 0.400 s')]
    other = edited(taken, name, setter('distortion_model', 'equidistant'))
    assert failed('other', other) == [
        ('hazard cameras', f'{name}: not the camera of the scenario')]


def test_depth_may_come_with_every_second_frame(tmp_path):
    """It is counted, and it belongs to images; an image belongs to no depth."""
    items = every_second(synthetic.drive(0.6, state_hz=100, depth_every=2))
    report = check(synthetic.write(tmp_path / 'bag', items))
    assert {f.status for f in report.findings} == {Status.PASS}
    found = {f.check: f.detail for f in report.findings}
    assert found['depth frame counts'] == '4 topics x 3 at 5 Hz'
    assert found['stereo sets'] == '6 sets of 4, 3 sets of 3 with one stamp'
    lost = edited(items, 'stereo/depth/image', drop, 0.4)
    failed = check(synthetic.write(tmp_path / 'lost', lost)).failed
    assert {f.check: f.detail for f in failed} == {
        'depth frame counts': '/stereo/depth/image: 1 of 3 missing, first at 0.400 s',
        'stereo sets': 'stereo/depth/image lacks 1 of 3 stamps, first 0.400000 s'}
    fewer = check(synthetic.write(tmp_path / 'fewer', every_second(items, 1))).failed
    assert {f.check for f in fewer} == {'depth frame rate', 'depth frame counts'}
    without = edited(items, 'stereo/right/image_raw', drop, 0.4)
    assert 'stereo/right/image_raw lacks 1 of 6' in {f.check: f.detail for f in check(
        synthetic.write(tmp_path / 'without', without)).failed}['stereo sets']


def test_an_unfinished_bag_is_named(tmp_path, good):
    path = synthetic.write(tmp_path / 'bag', good)
    marker.mark(path, 'No space left on device')
    assert [f.detail for f in check(path).failed] == ['No space left on device']


def test_drops_in_real_time_are_warnings(tmp_path, good):
    items = [dataclasses.replace(i, message=copy.deepcopy(i.message))
             if i.topic == 'scenario' else i for i in good]
    next(i for i in items if i.topic == 'scenario').message.data = \
        SCENARIO.replace('MODE', 'real_time')
    report = check(synthetic.write(tmp_path / 'bag', edited(items, 'odom', drop, 0.41)))
    assert report.ok
    assert [f.check for f in report.findings if f.status is Status.WARN] == ['state counts']
    fewer = edited(edited(items, 'stereo/right/image_raw', drop, 0.4), 'odom', drop, 0.5)
    report = check(synthetic.write(tmp_path / 'fewer', fewer))
    found = {f.check: f for f in report.findings if f.status is Status.WARN}
    assert report.ok
    assert {'frame counts', 'stereo sets', 'pose per image'} <= set(found)
    assert 'lacks 1 of 6' in found['stereo sets'].detail


def test_a_namespace_is_derived(tmp_path, good):
    path = synthetic.write(tmp_path / 'bag', edited(good, 'odom', drop, 0.5),
                           namespace='/rover1')
    assert {f.check for f in check(path).failed} == {'state counts', 'pose per image'}


def test_two_rovers_in_one_bag(tmp_path, good):
    with BagWriter(tmp_path / 'bag') as writer:
        for namespace in ('/a', '/b'):
            for item in good:
                if namespace == '/a' or item.topic != 'world_hash':
                    writer.write(f'{namespace}/{item.topic}', item.msgtype,
                                 synthetic.serialise(item), 0)
    assert {f.check for f in check(tmp_path / 'bag').failed} == {'b topics', 'b world hash'}


def test_the_odometry_of_an_estimator_is_no_second_rover(tmp_path, good):
    with BagWriter(tmp_path / 'bag') as writer:
        for item in good:
            for name in (item.topic, 'vo/odom') if item.topic == 'odom' else (item.topic,):
                writer.write(f'/{name}', item.msgtype, synthetic.serialise(item), 0)
    assert check(tmp_path / 'bag').ok


def commanded(items: list[Item]) -> list[Item]:
    """Return a drive with drive_node in its run, and its commands."""
    text = SCENARIO.replace('MODE', 'lockstep').replace(
        'duration_s: 0.6', 'duration_s: 0.6, nodes: [physics_node, drive_node, render_node, '
        'gait_controller_node, recorder_node]')
    text += 'drive_node:\n  ros__parameters: {mode: spline, rate_hz: 20}\n'
    zero = synthetic.vector((0, 0, 0))
    return edited(items, 'scenario', setter('data', text)) + [
        Item('cmd_vel', 'geometry_msgs/msg/TwistStamped', synthetic.msg(
            'geometry_msgs/TwistStamped', header=synthetic.header(50_000_000 * k, 'base_link'),
            twist=synthetic.msg('geometry_msgs/Twist', linear=zero, angular=zero)))
        for k in range(1, 13)]


def test_commands_and_fixed_frames_that_were_taken_out_are_missed(tmp_path, good):
    """By the plan of the run, and by what the recorder counted, which tools leave as it was."""
    items = commanded(good)
    whole = synthetic.write(tmp_path / 'whole', items)
    assert check(whole).ok
    counted = synthetic.metadata(whole)['custom_data']
    fewer = [i for i in items if not (i.topic == 'cmd_vel' and
                                      i.message.header.stamp.nanosec in (10**8, 350_000_000))]
    for name, taken, by_plan, by_count in (
            ('commands', fewer, ('commands', '/cmd_vel: 2 of 11 missing'),
             ('readable', '/cmd_vel: 10 of 12 recorded messages')),
            ('frames', [i for i in items if i.topic != 'tf_static'],
             ('topics', 'missing: tf_static'),
             ('readable', '/tf_static: 0 of 1 recorded messages'))):
        bag = synthetic.write(tmp_path / name, taken)
        assert [(f.check, f.detail) for f in check(bag).failed] == [by_plan]
        with synthetic.changed_metadata(bag) as told:
            told['custom_data'] = counted
        assert [(f.check, f.detail) for f in check(bag).failed] == [by_plan, by_count]


def test_messages_that_the_reader_does_not_find(good: list[Item], tmp_path: Path) -> None:
    """metadata.yaml counts them, but lacks the QoS by which rosbags finds their topic."""
    bag = synthetic.write(tmp_path / 'bag', good)
    assert check(bag).ok
    with synthetic.changed_metadata(bag) as told:
        for entry in told['topics_with_message_count']:
            if entry['topic_metadata']['name'] == '/tf_static':
                del entry['topic_metadata']['offered_qos_profiles']
    assert [(f.check, f.detail) for f in check(bag).failed] == [
        ('latched', '/tf_static: 0 messages'),
        ('readable', '/tf_static: 0 of 1 messages are found')]


def found(path):
    return next((f.status, f.detail) for f in check(path).findings if f.check == 'windows')


@pytest.fixture(scope='module')
def items():
    return synthetic.drive(0.2, only=(topics.ODOM, topics.CLOCK, topics.SCENARIO,
                                      topics.WORLD_HASH, topics.WORLD_WINDOW))


def test_windows_are_checked(items, tmp_path):
    whole = synthetic.write(tmp_path / 'whole', [*items, synthetic.window(100_000_000,
                                                                          (12.8, 0.0))])
    status, detail = found(whole)
    assert status is Status.PASS and detail.startswith('2;')
    far = synthetic.write(tmp_path / 'far', [*items, synthetic.window(100_000_000, (38.4, 0.0))])
    status, detail = found(far)
    assert status is Status.FAIL and 'outside its window at 0.100 s' in detail
    between = synthetic.write(tmp_path / 'between', [*items, synthetic.window(101_000_000,
                                                                              (12.8, 0.0))])
    status, detail = found(between)
    assert status is Status.FAIL and 'no state at 0.101 s' in detail
    late = synthetic.write(tmp_path / 'late', [
        *(item for item in items if item.topic != 'world/window'),
        synthetic.window(100_000_000, (0.0, 0.0))])
    status, detail = found(late)
    assert status is Status.FAIL and '19 states before' in detail
