"""Live SLAM: what wrappers are told exists in the graph."""

from __future__ import annotations

import pytest

from lunar_rover_sim import topics
from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.sequences.orbslam3_settings import SENSORS
from lunar_rover_sim.slam import live

KINDS = {topic.name: topic.type for topic in topics.CONTRACT}


@pytest.mark.parametrize('package', live.WRAPPERS)
@pytest.mark.parametrize('sensor', live.SENSORS)
def test_topics_are_those_of_the_graph(package: str, sensor: str) -> None:
    chosen = live.wrapper(package, sensor)
    ours = [ours for _, ours in chosen.remappings]
    ours += [str(value) for name, value in chosen.parameters if name.endswith('_topic_name')]
    kinds = sorted(KINDS[name] for name in ours)
    images = ['sensor_msgs/msg/Image'] * (1 if sensor == 'mono' else 2)
    assert kinds == images + ['sensor_msgs/msg/Imu'] * (sensor == 'stereo-inertial')
    assert len(set(ours)) == len(ours)
    if sensor != 'mono':   # left is left
        pairs = [*chosen.remappings, *chosen.parameters]
        sides = {str(v): str(k) for k, v in pairs if 'stereo/' in str(v)}
        assert 'left' in sides[topics.LEFT_IMAGE.name]
        assert 'right' in sides[topics.RIGHT_IMAGE.name]
    assert sensor in SENSORS


def test_unknown_names() -> None:
    with pytest.raises(SlamError, match="wrapper: 'orbslam' is not valid.*orbslam3"):
        live.wrapper('orbslam', 'stereo')
    with pytest.raises(SlamError, match="sensor: 'rgbd' is not valid"):
        live.wrapper('orbslam3', 'rgbd')
