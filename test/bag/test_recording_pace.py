"""The real-time factor of a recording: measured, written, read, told."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim import topics
from lunar_rover_sim.bag import marker, totals
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.totals import recorded_factor, RecordingPace
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.inspection.film import pace_caption


class Wall:
    """A clock that is set by hand."""

    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    clock = Wall()
    monkeypatch.setattr(totals, 'time', clock)
    return clock


def note(pace: RecordingPace, wall: Wall, *moments: tuple[float, int]) -> None:
    for wall_s, time_ms in moments:
        wall.now_s = wall_s
        pace.note(time_ms * 10**6)


def test_start_and_standstill_are_told_apart(wall: Wall) -> None:
    """What comes before the first step is not counted, a halt in between is."""
    pace = RecordingPace()
    note(pace, wall, (100.0, 0), (160.0, 0))
    assert pace.real_time_factor is None
    note(pace, wall, (161.0, 5))
    assert pace.real_time_factor is None
    note(pace, wall, (163.0, 505), (164.0, 505), (165.0, 1005))
    assert pace.real_time_factor == pytest.approx(0.25)
    wall.now_s = 200.0      # what nodes do after the last message is not counted
    assert pace.real_time_factor == pytest.approx(0.25)


def test_a_graph_that_runs_already(wall: Wall) -> None:
    pace = RecordingPace()
    note(pace, wall, (100.0, 0), (101.0, 70_000), (103.0, 71_000))
    assert pace.real_time_factor == pytest.approx(0.5)


def test_time_that_starts_anew(wall: Wall) -> None:
    pace = RecordingPace()
    note(pace, wall, (100.0, 5), (101.0, 2005), (102.0, 0), (103.0, 1000))
    assert pace.real_time_factor == pytest.approx(1.0)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    item = synthetic.drive(0.1, only=(topics.ODOM,))[0]
    writer = BagWriter(tmp_path / 'bag')
    writer.write('/odom', item.msgtype, synthetic.serialise(item), 0)
    writer.close(real_time_factor=0.37149)
    return tmp_path / 'bag'


def factor_of(path: Path) -> float | None:
    with open_bag(path) as opened:
        return recorded_factor(opened)


def test_metadata(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert factor_of(bag) == 0.371
    assert main(['bag', 'info', str(bag)]) == 0
    assert 'mcap, real-time factor 0.371' in capsys.readouterr().out


@pytest.mark.parametrize('custom', [
    None, {}, [], 'text', {'real_time_factor': 'fast'}, {'real_time_factor': None},
    {'real_time_factor': '-1'}, {'real_time_factor': 'nan'}])
def test_metadata_of_others(bag: Path, custom: object,
                            capsys: pytest.CaptureFixture[str]) -> None:
    file = bag / marker.METADATA_NAME
    metadata = yaml.safe_load(file.read_text())
    metadata['rosbag2_bagfile_information']['custom_data'] = custom
    file.write_text(yaml.safe_dump(metadata))
    assert factor_of(bag) is None
    assert main(['bag', 'info', str(bag)]) == 0
    assert 'real-time' not in capsys.readouterr().out


def test_caption() -> None:
    assert pace_caption(2.0, 0.371) == 'real-time factor 0.37, film speed × 2'
    assert pace_caption(1.0, None) == 'film speed × 1'
