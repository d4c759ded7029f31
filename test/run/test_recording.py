"""What a recording says of itself; whole ones are in test_recorded_run.py."""

from pathlib import Path

import pytest

from lunar_rover_sim.run.recording import missing_frames, Recording
from lunar_rover_sim.run.scenario import Scenario

LEFT, INFO = '/stereo/left/image_raw', '/stereo/left/camera_info'


@pytest.mark.parametrize('count,said', [
    (10, '10 of 40 stereo pairs were drawn and recorded, 5.0 of 20 a second'),
    (38, '38 of 40'), (39, ''), (40, '')])
def test_images_that_are_missing_in_real_time_are_counted(count, said):
    scenario = Scenario.load('flat', ['time_mode=real_time', 'render_node.frame_rate_hz=20'])
    lines = missing_frames(scenario, {LEFT: count}, 2.0)
    assert [said in line for line in lines] == [True] * bool(said)
    assert missing_frames(scenario, {INFO: count}, 2.0) == lines
    assert missing_frames(scenario, {INFO: 40, LEFT: count}, 2.0) == lines


def test_a_run_in_lockstep_or_without_images_misses_none():
    scenario = Scenario.load('flat', ['time_mode=lockstep'])
    assert missing_frames(scenario, {LEFT: 3}, 2.0) == []
    scenario = Scenario.load('flat', ['time_mode=real_time'])
    assert missing_frames(scenario, {}, 2.0) == []


def test_a_recording_is_shown_in_one_short_line():
    """Its scenario alone has some hundred parameters."""
    recording = Recording(Path('run'), Path('run/bag'), Scenario.load('flat', seed=3), {LEFT: 40},
                          2.0, 4.0, {'physics_node': 1.5}, interrupted=False)
    assert repr(recording).endswith(
        "scenario=Scenario(name='flat', seed=3, duration_s=20), simulated_s=2.0, wall_s=4.0, "
        'interrupted=False, warnings=())')
