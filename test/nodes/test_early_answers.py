"""Answers that come before the first state are judged by it, as later ones are.

The node lives in this process and its callbacks are called in a given order: what is seen does
not depend on when messages arrive.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import time
from typing import Any

import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from builtin_interfaces.msg import Time  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import TwistStamped  # noqa: E402
from peer import LEGS  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim.nodes.gait_controller_node import GaitControllerNode  # noqa: E402

STATE_NS = 50_000_000
WALL_TIME = 1_700_000_000
SILENCE_S = 0.4


class Gait:
    """A gait controller that waits for cmd_vel in lockstep, in simulated time 50 ms."""

    def __init__(self) -> None:
        self.node = GaitControllerNode()
        self._callbacks = {subscription.topic_name: subscription.callback
                           for subscription in self.node.subscriptions}

    def velocity(self, stamp: Time) -> None:
        """Hand the node a velocity, as its executor does."""
        self._callbacks['/cmd_vel'](TwistStamped(header=Header(stamp=stamp)))

    def state(self) -> None:
        """Hand the node the state of 50 ms, as its executor does."""
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp.nanosec = STATE_NS
        self._callbacks['/joint_states'](state)

    def failure(self) -> str:
        """Let the node watch for longer than somebody may be silent; return its error."""
        time.sleep(SILENCE_S + 0.1)
        for timer in self.node.timers:
            timer.callback()
        return str(self.node.failure or '')


@contextmanager
def gait_controller() -> Iterator[Gait]:
    """Give the node in this process."""
    rclpy.init(args=['--ros-args', '-p', 'time_mode:=lockstep', '-p', 'wait.topics:=[cmd_vel]',
                     '-p', 'wait.lags_s:=[0.05]', '-p', f'wait.silence_s:={SILENCE_S}', '-p',
                     f'wait.start_s:={SILENCE_S}'])
    gait = Gait()
    try:
        yield gait
    finally:
        gait.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture()
def gait(domain: int) -> Iterator[Any]:
    """Give a gait controller in a domain of its own."""
    with gait_controller() as controller:
        yield controller


@pytest.mark.parametrize('order', ['before', 'after'])
def test_stamps_of_another_clock_are_no_answer(gait: Gait, order: str) -> None:
    """Wall time in simulated time opens the gate neither before nor after the first state."""
    actions = [lambda: gait.velocity(Time(sec=WALL_TIME)), gait.state]
    for action in actions if order == 'before' else reversed(actions):
        action()
    assert gait.failure() == (
        f'no answer for {SILENCE_S:g} s at 0.050 s of simulated time on cmd_vel '
        '(from nobody: no publisher, last stamp 0.000 s, 1 refused)')


@pytest.mark.parametrize('order', ['before', 'after'])
def test_an_answer_counts_in_either_order(gait: Gait, order: str) -> None:
    """Who is quick and answers 50 ms before this node knows of it has answered."""
    actions = [lambda: gait.velocity(Time(nanosec=STATE_NS)), gait.state]
    for action in actions if order == 'before' else reversed(actions):
        action()
    assert not gait.failure()


def test_of_several_early_answers_each_is_judged(gait: Gait) -> None:
    """One of another clock does not spoil the valid one before it."""
    gait.velocity(Time(nanosec=STATE_NS))
    gait.velocity(Time(sec=WALL_TIME))
    gait.state()
    assert not gait.failure()


def test_a_long_wait_is_told_before_it_is_an_error(
        domain: int, capfd: pytest.CaptureFixture[str]) -> None:
    """Who waits says so: a warning once, later waits in the log."""
    rclpy.init(args=['--ros-args', '-p', 'time_mode:=lockstep', '-p', 'wait.topics:=[cmd_vel]',
                     '-p', 'wait.lags_s:=[0.05]'])
    gait = Gait()
    try:
        gait.velocity(Time(sec=WALL_TIME))
        gait.state()
        for _ in range(2):
            time.sleep(4.1)
            for _ in range(2):
                for timer in gait.node.timers:
                    timer.callback()
            assert gait.node.failure is None
            gait.velocity(Time(nanosec=1))
    finally:
        gait.node.destroy_node()
        rclpy.try_shutdown()
    lines = [line for line in capfd.readouterr().err.splitlines() if 'no answer for 4 s' in line]
    assert [line.split(']')[0] for line in lines] == ['[WARN', '[INFO']
    assert all('on cmd_vel (from' in line and line.endswith('waits for up to 60 s')
               for line in lines)


def test_time_without_a_state_is_no_silence(gait: Gait) -> None:
    """Physics that is started late, or was paused, leaves the others their full time."""
    time.sleep(SILENCE_S + 0.1)
    gait.state()
    for timer in gait.node.timers:
        timer.callback()
    assert gait.node.failure is None
    assert gait.failure().startswith(f'no answer for {SILENCE_S:g} s')
