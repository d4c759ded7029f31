"""How long a recording is in simulated time, and its real-time factor."""

from pathlib import Path

import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag import totals
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.totals import recorded_factor, RecordingPace, simulated_end_ns
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.campaign.statistics import statistics
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status
from lunar_rover_sim.products.inspection.summary import summarise


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
    with synthetic.changed_metadata(bag) as told:
        told['custom_data'] = custom
    assert factor_of(bag) is None
    assert main(['bag', 'info', str(bag)]) == 0
    assert 'real-time' not in capsys.readouterr().out


WALL_NS = 1_795_554_234 * 10**9
STATES = (topics.ODOM, topics.IMU_RAW)
IMAGES = (topics.LEFT_IMAGE, topics.LEFT_INFO)


def diagnostics(ns: int = WALL_NS) -> synthetic.Item:
    """Return a message on /diagnostics."""
    return synthetic.item(topics.DIAGNOSTICS, synthetic.msg(
        'diagnostic_msgs/DiagnosticArray', header=synthetic.header(ns, ''), status=[]))


def at_wall_time(topic: str) -> synthetic.Item:
    """Return a message of a program that does not use simulated time."""
    return synthetic.Item(topic, 'std_msgs/msg/Header', synthetic.header(WALL_NS, ''))


@pytest.mark.parametrize('storage', synthetic.WRITERS)
@pytest.mark.parametrize('namespace', ['', '/rover1'])
@pytest.mark.parametrize(('recorded', 'end_ns'), [
    ((*STATES, *IMAGES), 550_000_000), (STATES, 550_000_000), (IMAGES, 500_000_000)])
def test_the_last_state_or_frame_ends_it(
        recorded: tuple[topics.Topic, ...], end_ns: int, namespace: str, storage: str,
        tmp_path: Path) -> None:
    """Whatever else is in the bag, and in whichever order."""
    items = synthetic.drive(0.55, state_hz=100, only=recorded)
    for name, others in (('alone', []), ('others', [diagnostics(), at_wall_time('my/status')])):
        bag_path = synthetic.WRITERS[storage](tmp_path / name, [*others, *items], namespace)
        with open_bag(bag_path) as bag:
            assert simulated_end_ns(bag) == end_ns


def test_without_states_and_frames(tmp_path: Path) -> None:
    """The last message ends it that may be at simulated time; wall time alone is none."""
    sun = synthetic.Item('wheel/temperature', 'std_msgs/msg/Header', synthetic.header(7, ''))
    for name, items, end_ns in (('both', [sun, diagnostics()], 7), ('wall', [diagnostics()], 0),
                                ('empty', [], 0)):
        with open_bag(synthetic.write(tmp_path / name, items)) as bag:
            assert simulated_end_ns(bag) == end_ns


def test_what_tells_of_the_duration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Summary, statistics, `bag info` and the check of the clock."""
    items = synthetic.drive(0.5, state_hz=100, only=(*STATES, *IMAGES, topics.CLOCK))
    bag = synthetic.write(tmp_path / 'bag', [diagnostics(), *items, diagnostics(WALL_NS + 1)])
    summary = summarise(bag)
    assert summary.duration_s == 0.5
    assert '0.50 s, RTF 0.50 with start and stop' in summary.lines(wall_s=1.0)
    assert statistics(bag)['duration_s'] == 0.5
    assert main(['bag', 'info', str(bag)]) == 0
    told = capsys.readouterr().out
    assert ', 0.010 s to 0.500 s, ' in told
    assert next(line for line in told.splitlines() if line.startswith('/odom ')).endswith(
        '102.0 Hz')     # 50 messages over 49 periods
    assert 'one clock' not in [finding.check for finding in check(bag).failed]


def test_diagnostics_at_the_time_of_their_arrival(tmp_path: Path) -> None:
    """So the recorder writes them; the check has nothing to say of that."""
    items = synthetic.drive(0.5, state_hz=100, only=STATES)
    with BagWriter(tmp_path / 'bag') as writer:
        for item in [*items, diagnostics()]:
            writer.write(f'/{item.topic}', item.msgtype, synthetic.serialise(item), 7, WALL_NS - 1)
    found = {finding.check: finding for finding in check(tmp_path / 'bag').findings}
    assert found['bag time'].status is found['one clock'].status is Status.PASS
