"""Diagnostics: names, levels and thresholds that users of diagnostic_updater know."""

from __future__ import annotations

from collections.abc import Callable
import math
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402  (needs rclpy)
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402

from lunar_rover_sim.nodes import diagnostics  # noqa: E402
from lunar_rover_sim.nodes.diagnostics import (Diagnostics, Drops, ERROR, OK, Rate,  # noqa: E402
                                               WARN)
from lunar_rover_sim.nodes.node_main import CountedWarnings  # noqa: E402
from lunar_rover_sim.nodes.physics_diagnostics import PhysicsDiagnostics  # noqa: E402
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
