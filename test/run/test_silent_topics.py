"""Topics that a run is to record, and that nobody in it publishes."""

from __future__ import annotations

import pytest

from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.silent_topics import silent_topics

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
