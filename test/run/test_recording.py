"""What a recording says of itself; whole ones are in test_run.py."""

import pytest

from lunar_rover_sim.run.recording import missing_frames
from lunar_rover_sim.run.scenario import Scenario

LEFT = '/stereo/left/image_raw'


@pytest.mark.parametrize('count,said', [
    (10, '10 of 40 stereo pairs were drawn and recorded, 5.0 of 20 a second'),
    (38, '38 of 40'), (39, ''), (40, '')])
def test_images_that_are_missing_in_real_time_are_counted(count, said):
    scenario = Scenario.load('flat', ['time_mode=real_time', 'render_node.frame_rate_hz=20'])
    lines = missing_frames(scenario, {LEFT: count}, 2.0)
    assert [said in line for line in lines] == [True] * bool(said)


def test_a_run_in_lockstep_or_without_images_misses_none():
    scenario = Scenario.load('flat', ['time_mode=lockstep'])
    assert missing_frames(scenario, {LEFT: 3}, 2.0) == []
    scenario = Scenario.load('flat', ['time_mode=real_time'])
    assert missing_frames(scenario, {}, 2.0) == []
