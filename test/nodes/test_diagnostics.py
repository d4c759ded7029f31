"""Diagnostics as users of diagnostic_updater know them, and the pace of the wall clock."""

from collections.abc import Callable
import math
import re
from types import SimpleNamespace
from typing import Any

import pytest

from lunar_rover_sim.nodes.pacing import WallPace

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402  (needs rclpy)
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402

from lunar_rover_sim.nodes import diagnostics  # noqa: E402
from lunar_rover_sim.nodes.diagnostics import (Diagnostics, Drops, ERROR, OK, Rate,  # noqa: E402
                                               WARN)
from lunar_rover_sim.nodes.diagnostics import PhysicsDiagnostics  # noqa: E402
from lunar_rover_sim.nodes.node_main import CountedWarnings  # noqa: E402
from lunar_rover_sim.run.lockstep import StampGate  # noqa: E402
from lunar_rover_sim.run.node_config import PhysicsNodeConfig  # noqa: E402
from lunar_rover_sim.run.shared_config import WaitConfig  # noqa: E402


class FakeNode:
    """A node without ROS: its timer is called by `tick`."""

    def __init__(self, name: str = '/physics_node') -> None:
        self.name, self.readers = name, 1
        self.sent: list[DiagnosticArray] = []
        self.topic = ''
        self.tick: Callable[[], None]
        self.warned: list[str] = []
        self.warnings = CountedWarnings(SimpleNamespace(warning=self.warned.append))

    def get_fully_qualified_name(self) -> str:
        return self.name

    def get_namespace(self) -> str:
        return self.name.rpartition('/')[0] or '/'

    def create_publisher(self, kind: Any, topic: str, profile: Any) -> Any:
        self.topic = topic
        return SimpleNamespace(publish=self.sent.append,
                               get_subscription_count=lambda: self.readers)

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        assert period_s == 1.0
        self.tick = callback

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: Time(sec=7)))


@pytest.fixture()
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Give a wall clock that stands at its only element."""
    now = [100.0]
    monkeypatch.setattr(diagnostics.time, 'monotonic', lambda: now[0])
    return now


def physics(node: FakeNode, gate: StampGate, now: list[int], **given: Any) -> PhysicsDiagnostics:
    """Return the diagnostics of physics at 200 Hz; its gate awaits one topic."""
    config = PhysicsNodeConfig(
        wait=WaitConfig(topics=('joint_commands',), lags_s=(0.0,)), **given)
    return PhysicsDiagnostics(node, config, gate, Drops(),  # type: ignore[arg-type]
                              lambda: now[0], lambda: False)


def status(node: FakeNode, subject: str) -> Any:
    """Return the newest status of a subject, its values as a mapping."""
    node.tick()
    found = next(s for s in node.sent[-1].status if s.name.endswith(': ' + subject))
    return SimpleNamespace(name=found.name, level=found.level, message=found.message,
                           hardware=found.hardware_id,
                           values={value.key: value.value for value in found.values})


def test_names_and_silence(clock: list[float]) -> None:
    """Names are NODE: SUBJECT on the absolute topic; nothing is sent where nobody reads."""
    node = FakeNode('/rover1/render_node')
    node.readers = 0
    Diagnostics(node, {'Drops': Drops().status})  # type: ignore[arg-type]
    node.tick()
    assert node.topic == '/diagnostics' and not node.sent
    node.readers = 1
    told = status(node, 'Drops')
    assert (told.name, told.hardware) == ('rover1/render_node: Drops', 'rover1')
    assert node.sent[-1].header.stamp.sec == 7


def test_rate(clock: list[float]) -> None:
    """A tenth below its target is a warning, silence for five seconds an error."""
    rate = Rate(10.0)

    def second(events: int) -> Any:
        clock[0] += 1.0
        for _ in range(events):
            rate.tick()
        return rate.status()

    steady = [second(10) for _ in range(6)][-1]
    assert steady.level == OK and steady.message == 'Desired frequency met'
    assert steady.values['Actual frequency (Hz)'] == '10.000'
    assert steady.values['Minimum acceptable frequency (Hz)'] == '9'
    slow = [second(8) for _ in range(6)][-1]
    assert slow.level == WARN and slow.message == 'Frequency too low.'
    silent = [second(0) for _ in range(6)][-1]
    assert silent.level == ERROR and silent.message == 'No events recorded.'
    assert rate.status('Paused').level == OK


def test_drops() -> None:
    """A loss is told once; the sums stay."""
    drops = Drops()
    assert drops.status().level == OK
    drops.add('Frames', 3)
    told = drops.status()
    assert told.level == WARN and told.values == {'Lost since startup': '3', 'Frames': '3'}
    assert drops.status().level == OK


def test_the_real_time_factor(clock: list[float]) -> None:
    """Below nine tenths of what was asked for is a warning, below half an error."""
    node, now = FakeNode(), [0]
    physics(node, StampGate({}), now, real_time_factor=2.0)
    for advanced_ns, level in ((2_000_000_000, OK), (1_700_000_000, WARN), (900_000_000, ERROR)):
        clock[0] += 1.0
        now[0] += advanced_ns
        told = status(node, 'Real-time factor')
        assert told.level == level
        assert told.values['Actual real-time factor'] == f'{advanced_ns / 1e9:.3f}'
    node = FakeNode()
    physics(node, StampGate({}), now, time_mode='lockstep')
    clock[0] += 1.0
    assert status(node, 'Real-time factor').level == OK


def test_the_lag_of_participants(clock: list[float]) -> None:
    """More than 0.1 s is late, more than 1 s an error; the values are seconds."""
    node, now, gate = FakeNode(), [0], StampGate({'joint_commands': 0})
    physics(node, gate, now)
    assert status(node, 'Participants').level == OK
    for lag_ns, level, message in ((50_000_000, OK, 'All are in time'),
                                   (500_000_000, WARN, 'Late: joint_commands'),
                                   (1_100_000_000, ERROR, 'Late: joint_commands')):
        now[0] += 2_000_000_000
        gate.answer('joint_commands', now[0] - lag_ns)
        told = status(node, 'Participants')
        assert (told.level, told.message) == (level, message)
        assert told.values['Lag of joint_commands (s)'] == f'{lag_ns / 1e9:.3f}'


def test_a_tip_over_is_told_once(clock: list[float]) -> None:
    """With place and time, and as an error as long as the rover lies."""
    node, now = FakeNode(), [0]
    told = physics(node, StampGate({}), now)
    for stamp_ns, x in ((1_000_000_000, 0.1), (2_000_000_000, 0.8), (3_000_000_000, 0.8)):
        now[0] = stamp_ns
        told.tick(SimpleNamespace(   # type: ignore[arg-type]
            position_m=(1.5, -2.0, 0.1), orientation_wxyz=(math.sqrt(1.0 - x * x), x, 0.0, 0.0)))
        assert status(node, 'Attitude').level == (ERROR if x > 0.5 else OK)
    assert node.warned == ['tipped over at 2.00 s, x 1.50 m, y -2.00 m (1 so far)']


class Wall:
    """A wall clock that the test sets, and a log."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.lines: list[str] = []

    def monotonic(self) -> float:
        """Return the time [s]."""
        return self.now_s

    def warning(self, text: str) -> None:
        """Keep a line."""
        self.lines.append(text)


@pytest.fixture()
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    """Give a wall clock that stands still."""
    wall = Wall()
    monkeypatch.setattr('lunar_rover_sim.nodes.pacing.time', wall)
    return wall


def pace(wall: Any, factor: float = 1.0) -> WallPace:
    """Return a pace with periods of 5 ms, of which 20 may be made up for."""
    return WallPace(factor, 5_000_000, 20, wall)


def test_what_is_due_follows_factor_and_wall_clock(wall: Wall) -> None:
    """Half the speed: half the states."""
    slow = pace(wall, 0.5)
    wall.now_s += 0.1
    assert slow.due_periods(0) == 10
    assert slow.due_periods(50_000_000) == 0
    assert not wall.lines


def test_a_slow_machine_is_reported_once_a_minute_with_the_mean(wall: Wall) -> None:
    """Half of the wall time passes as simulated time, for three minutes."""
    real = pace(wall)
    now_ns = 0
    for _ in range(900):
        wall.now_s += 0.2
        real.due_periods(now_ns)
        now_ns += 100_000_000
    assert len(wall.lines) == 3     # after 5, 65 and 125 s
    reached = [re.search(r'([0-9.]+) in the mean of', line) for line in wall.lines]
    assert all(match and 0.47 < float(match[1]) < 0.51 for match in reached)
