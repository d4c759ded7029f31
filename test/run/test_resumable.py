"""Recordings: made once, kept or completed, and what one says of itself."""

import dataclasses
from pathlib import Path

import pytest
import synthetic_bag

from lunar_rover_sim.base.errors import BagError, GraphError
from lunar_rover_sim.run.recording import missing_frames, Recording
from lunar_rover_sim.run.resumable import record_once, why_incomplete_recording
from lunar_rover_sim.run.scenario import Scenario

SCENARIO = Scenario.load('flat')


class Recorder:
    """Writes an analytic bag in place of a run."""

    def __init__(self) -> None:
        self.calls = 0
        self.interrupted = False
        self.complete = True

    def __call__(self, scenario: Scenario, folder: Path) -> Recording:
        self.calls += 1
        folder.mkdir()
        (folder / 'scenario.yaml').write_text(scenario.to_yaml())
        synthetic_bag.write(folder / 'bag', synthetic_bag.drive(0.2))
        if not self.complete:
            (folder / 'bag' / 'metadata.yaml').unlink()
        return Recording(folder, folder / 'bag', scenario, {}, 0.2, 1.0, {}, self.interrupted)


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_finished_recording_is_kept(tmp_path: Path, recorder: Recorder) -> None:
    folder = tmp_path / 'drives' / 'a'
    for _ in range(2):
        assert record_once(SCENARIO, folder, recorder=recorder) == folder
    assert recorder.calls == 1
    assert why_incomplete_recording(folder) is None
    assert names(tmp_path / 'drives') == ['a']


def test_an_unfinished_recording_is_made_again(tmp_path: Path, recorder: Recorder) -> None:
    record_once(SCENARIO, tmp_path / 'a', recorder=recorder)
    (tmp_path / 'a' / 'bag' / 'metadata.yaml').unlink()
    (tmp_path / '.a.partial').mkdir()
    record_once(SCENARIO, tmp_path / 'a', recorder=recorder)
    assert recorder.calls == 2
    assert why_incomplete_recording(tmp_path / 'a') is None


def test_another_scenario_is_never_replaced(tmp_path: Path, recorder: Recorder) -> None:
    record_once(SCENARIO, tmp_path / 'a', recorder=recorder)
    with pytest.raises(BagError, match='a: was recorded from another scenario'):
        record_once(Scenario.load('flat', seed=7), tmp_path / 'a', recorder=recorder)
    assert recorder.calls == 1 and why_incomplete_recording(tmp_path / 'a') is None


def test_what_is_not_finished_does_not_get_the_name(tmp_path: Path, recorder: Recorder) -> None:
    recorder.interrupted = True
    with pytest.raises(GraphError, match='a: the recording was interrupted'):
        record_once(SCENARIO, tmp_path / 'a', recorder=recorder)
    recorder.interrupted, recorder.complete = False, False
    with pytest.raises(GraphError, match='incomplete: metadata.yaml is missing'):
        record_once(SCENARIO, tmp_path / 'a', recorder=recorder)
    assert not (tmp_path / 'a').exists()

    def fail(folder: Path, recording: Recording) -> None:
        raise BagError('not good enough')

    recorder.complete = True
    with pytest.raises(BagError, match='not good enough'):
        record_once(SCENARIO, tmp_path / 'a', recorder=recorder, finish=fail)
    assert not (tmp_path / 'a').exists()


def test_finish_adds_to_the_recording(tmp_path: Path, recorder: Recorder) -> None:
    def finish(folder: Path, recording: Recording) -> None:
        (folder / 'notes').write_text(f'{recording.simulated_s}')

    record_once(SCENARIO, tmp_path / 'a', partial=tmp_path / 'work' / 'b', recorder=recorder,
                finish=finish)
    assert (tmp_path / 'a' / 'notes').read_text() == '0.2'
    assert names(tmp_path / 'work') == []


def test_the_first_of_two_recorders_wins(tmp_path: Path, recorder: Recorder) -> None:
    def other(folder: Path, recording: Recording) -> None:
        record_once(SCENARIO, tmp_path / 'a', partial=tmp_path / 'other', recorder=recorder,
                    finish=lambda path, _: (path / 'first').touch())

    record_once(SCENARIO, tmp_path / 'a', recorder=recorder, finish=other)
    assert (tmp_path / 'a' / 'first').is_file()
    assert names(tmp_path) == ['a']


def test_a_folder_that_cannot_be_written(tmp_path: Path, recorder: Recorder) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot be written: '):
        record_once(SCENARIO, tmp_path / 'file' / 'a', recorder=recorder)


def test_a_recorded_scenario_that_differs_is_refused(tmp_path: Path) -> None:
    class Other(Recorder):
        def __call__(self, scenario: Scenario, folder: Path) -> Recording:
            return super().__call__(dataclasses.replace(scenario, shared=dataclasses.replace(
                scenario.shared, seed=99)), folder)

    with pytest.raises(BagError, match='another scenario'):
        record_once(SCENARIO, tmp_path / 'a', recorder=Other())
    assert not (tmp_path / 'a').exists()


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
