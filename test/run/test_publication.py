"""What a run publishes and records, and the gate that its time waits at."""

from judge.slam import relief_walk
import pytest

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.run.lockstep import StampGate, WrittenStamps
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.publication import (is_recorded, misspelt_exclusions, period_ns,
                                             silent_topics, unrecorded_cameras)
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_options import with_slam

HAZARD = {'render_node.hazard.front.rate_hz': 5, 'render_node.hazard.rear.stereo_baseline_m': 0.1}


@pytest.mark.parametrize('name, reason', [
    ('chase/image_raw', 'render_node.chase.enabled is false'),
    ('lidar/points', 'run.nodes lacks lidar_node'),
    ('ground_truth/sinkage', 'physics_node.ground.model is rigid'),
    ('hazard/front/image_raw', 'render_node.hazard has no such camera; there is none'),
    ('/ground_truth/hazard/front/labels', 'render_node.hazard has no such camera; there is none'),
    ('ground_truth/lables', 'no topic of this package; did you mean ground_truth/labels?')])
def test_it_says_why(name: str, reason: str) -> None:
    """Before the run, which may take hours, and not after it alone."""
    scenario = Scenario.load('flat', {'recorder_node.topics': ['all', name]})
    assert silent_topics(resolve(scenario)) == [f'{name}: {reason}']


def test_what_is_published_or_unknown_is_not_named() -> None:
    told = ['all', 'ground_truth/labels', 'wheel/odometry', 'chase/pose', 'lidar/scan',
            'hazard/front/image_raw', 'ground_truth/hazard/rear/right/labels', 'my_camera/image']
    scenario = Scenario.load('flat', {
        **HAZARD, 'recorder_node.topics': told, 'render_node.chase.enabled': True,
        'run.nodes': ['physics_node', 'render_node', 'recorder_node', 'lidar_node']})
    assert not silent_topics(resolve(scenario))
    # Of a pair there is a left and a right one.
    scenario = Scenario.load('flat', {**HAZARD, 'recorder_node.topics': ['hazard/rear/image_raw']})
    assert silent_topics(resolve(scenario)) == [
        'hazard/rear/image_raw: render_node.hazard has no such camera; there are front, '
        'rear/left, rear/right']
    # Without render_node neither; its other images may be those of the user's renderer.
    scenario = Scenario.load('flat', {
        **HAZARD, 'recorder_node.topics': ['hazard/front/image_raw', 'stereo/left/image_raw'],
        'run.nodes': ['physics_node', 'recorder_node']})
    assert silent_topics(resolve(scenario)) == [
        'hazard/front/image_raw: run.nodes lacks render_node']


def test_a_hazard_camera_that_is_not_recorded_is_named() -> None:
    """With what to set; unless something of it is recorded, or its user lists every topic."""
    def told(*listed: str) -> list[str]:
        return unrecorded_cameras(resolve(Scenario.load('flat', {
            **HAZARD, 'recorder_node.topics': listed})))
    front = 'ground_truth/hazard/front/labels'
    assert told('all', front) == [
        f'rear: is not recorded; to record it set recorder_node.topics=[all, {front}, '
        'hazard/rear/left/image_raw, hazard/rear/right/image_raw, hazard/rear/left/camera_info, '
        'hazard/rear/right/camera_info]']
    assert [line.partition(':')[0] for line in told('all')] == ['front', 'rear']
    assert not told('odom')
    assert not told('all', front, 'hazard/rear/left/image_raw')


def test_a_misspelt_exclusion_is_named() -> None:
    """It would be recorded after all; names of a user's own topics are no concern."""
    scenario = Scenario.load('flat', {'recorder_node.exclude': [
        'imu/data_row', '/contacts/front_left', 'ground_truth/imu', 'my_camera/image']})
    assert misspelt_exclusions(resolve(scenario)) == [
        'imu/data_row: no topic of this package; did you mean imu/data_raw?']


def test_all_leaves_out_what_is_named_beside_it_and_the_recorders_own_progress() -> None:
    """A name that is listed is recorded in any case."""
    for topic in topics.CONTRACT:
        assert is_recorded(topic, ['all']) == (topic.in_all and topic is not topics.RECORDED)
        assert is_recorded(topic, [topic.name], [topic.name])
        assert not is_recorded(topic, ['all'], [topic.name])
        assert not is_recorded(topic, [])


def test_periods_of_unknown_rates_are_zero() -> None:
    """Recordings of earlier versions have depth with every frame."""
    assert period_ns(topics.STATE, 0.0, 20.0, 1.0) == 0
    assert period_ns(topics.DEPTH_FRAME, 0.0, 20.0, 0.0) == 50_000_000


def test_nodes_of_a_run_take_over_values_of_others() -> None:
    scenario = resolve(Scenario.load('flat', {
        'render_node.frame_rate_hz': 10, 'render_node.camera.width': 320,
        'render_node.sun.elevation_deg': 7.0, 'render_node.reflectance.albedo_scale': 0.9,
        'physics_node.gravity_mps2': 3.7, 'physics_node.imu.preset': 'bmi160'}))
    slam, physics = scenario.slam_node, scenario.physics_node
    assert (slam.camera.width, slam.frame_rate_hz, slam.imu_rate_hz) == (320, 10, 200)
    assert (slam.imu.preset, slam.gravity_mps2) == ('bmi160', 3.7)
    assert (physics.ground_rate_hz, physics.sun.elevation_deg) == (10, 7.0)
    assert scenario.lidar_node.reflectance.albedo_scale == 0.9


def test_the_graph_is_given_a_map_from_orbit(tmp_path) -> None:
    """Near the start of the scenario, unless a place is given; poses are those in the site."""
    relief_walk.orbital(0).save(tmp_path / 'map')
    scenario = Scenario.load('flat', {'physics_node.start.x_m': 3.0})
    slam = with_slam(scenario, 'graph', tmp_path / 'map').slam_node
    assert (slam.near_x_m, slam.near_y_m, slam.doubt_m) == (3.0, 0.0, 50.0)
    assert slam.maps == str(tmp_path / 'map') and slam.frame_id == 'odom'
    slam = with_slam(scenario, 'graph', tmp_path / 'map', (8.0, -2.0), 20.0).slam_node
    assert (slam.near_x_m, slam.near_y_m, slam.doubt_m) == (8.0, -2.0, 20.0)
    with pytest.raises(ConfigError, match='--orbital: is for --slam graph, and the program is ls'):
        with_slam(scenario, 'ls', tmp_path / 'map')
    with pytest.raises(WorldError, match='no such file'):
        with_slam(scenario, 'graph', tmp_path / 'none')
    assert not with_slam(scenario, 'graph').slam_node.maps


MS = 1_000_000


def test_zero_lag_awaits_every_state() -> None:
    """Time goes on from a state only when it has been answered."""
    gate = StampGate({'joint_commands': 0})
    assert gate.is_open(0)
    assert not gate.is_open(5 * MS)
    gate.answer('joint_commands', 5 * MS)
    assert gate.is_open(5 * MS)
    assert gate.missing(10 * MS) == {'joint_commands': 5 * MS}


def test_period_lag_awaits_the_newest_period() -> None:
    """With a lag of one period a 10 Hz topic is awaited at each of its stamps."""
    gate = StampGate({'camera_info': 100 * MS})
    assert gate.is_open(95 * MS)
    assert not gate.is_open(100 * MS)
    gate.answer('camera_info', 100 * MS)
    assert gate.is_open(195 * MS)
    assert not gate.is_open(200 * MS)


def test_two_periods_let_the_renderer_be_one_frame_behind() -> None:
    """The frame before the present one must be there, the present one need not."""
    gate = StampGate({'camera_info': 200 * MS})
    assert gate.is_open(195 * MS)
    assert not gate.is_open(200 * MS)
    gate.answer('camera_info', 100 * MS)
    assert gate.is_open(200 * MS)
    assert gate.is_open(295 * MS)
    assert not gate.is_open(300 * MS)


def test_older_answers_change_nothing() -> None:
    """A late duplicate does not turn time back."""
    gate = StampGate({'a': 0})
    gate.answer('a', 20)
    gate.answer('a', 10)
    assert gate.is_open(20)
    assert gate.has_answered('a')


def test_behind_is_stricter_than_missing() -> None:
    """At the end everybody must have answered the end itself, whatever lag they had."""
    gate = StampGate({'a': 0, 'b': 100})
    gate.answer('a', 50)
    assert gate.missing(50) == {}
    assert gate.behind(50) == {'b': 0}


def test_a_slow_topic_is_written_until_its_next_message_is_due() -> None:
    """States every 5 ms, depth every 200 ms: what ends at 700 ms is complete with depth of 600."""
    written = WrittenStamps({'odom': 5 * MS, 'depth': 200 * MS})
    for ns in range(5 * MS, 701 * MS, 5 * MS):
        assert written.write('odom', ns)
    assert written.up_to_ns == 195 * MS
    written.write('depth', 400 * MS)
    assert written.up_to_ns == 595 * MS
    written.write('depth', 600 * MS)
    assert written.up_to_ns == 700 * MS
    assert not written.write('scenario', 900 * MS)
    written.restart()
    written.write('odom', 5 * MS)
    assert written.up_to_ns == 5 * MS


def test_older_stamps_of_others_do_not_hold_back_time() -> None:
    """A filter that others run publishes tf with stamps of the past, between two of ours."""
    written = WrittenStamps({'odom': 5 * MS, 'tf': 5 * MS})
    for topic, ms in (('tf', 5), ('odom', 5), ('tf', 10), ('tf', 2), ('odom', 10)):
        written.write(topic, ms * MS)
    assert written.up_to_ns == 10 * MS


def test_a_topic_of_no_known_period_is_written_up_to_its_stamp() -> None:
    """Nobody knows when its next message is due."""
    written = WrittenStamps({'odom': 5 * MS, 'other': 0})
    written.write('odom', 700 * MS)
    assert written.up_to_ns == 0
    written.write('other', 600 * MS)
    assert written.up_to_ns == 600 * MS
