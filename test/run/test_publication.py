"""What a run publishes and records, and what it is to record that nobody publishes."""

from __future__ import annotations

import pytest

from lunar_rover_sim import topics
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.publication import is_recorded, period_ns, silent_topics, unpublished
from lunar_rover_sim.run.scenario import Scenario

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


def test_all_leaves_out_what_is_made_on_request_and_the_recorders_own_progress() -> None:
    """A name that is listed is recorded in any case."""
    for topic in topics.CONTRACT:
        assert is_recorded(topic, ['all']) == (not topic.on_request
                                               and topic is not topics.RECORDED)
        assert is_recorded(topic, [topic.name], [topic.name])
        assert not is_recorded(topic, ['all'], [topic.name])
        assert not is_recorded(topic, [])


@pytest.mark.parametrize('rate, expected', [
    (topics.STATE, 5_000_000), (topics.FRAME, 50_000_000), (topics.DEPTH_FRAME, 150_000_000),
    (topics.SCAN, 100_000_000), (topics.EVENT, 0), (topics.LATCHED, 0)])
def test_periods(rate: str, expected: int) -> None:
    assert period_ns(rate, 200, 20, 3, 10) == expected


def test_periods_of_unknown_rates_are_zero() -> None:
    """Recordings of earlier versions have depth with every frame."""
    assert period_ns(topics.STATE, 0.0, 20.0, 1.0) == 0
    assert period_ns(topics.DEPTH_FRAME, 0.0, 20.0, 0.0) == 50_000_000


def test_what_physics_does_not_publish_by_its_parameters() -> None:
    assert unpublished(False, True, True) == (topics.TRUE_ODOM,)
    assert unpublished(True, False, False) == (topics.ODOM, topics.CLOCK, *topics.OF_SOFT_GROUND)


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
