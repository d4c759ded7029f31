"""Whether a ROS domain is free: what the answers of the helper mean. No graph runs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
from waiting import wait_until

from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.run.ros_domain import check_domain, ClockReader

NOISE = '2026-11-25 [RTPS_TRANSPORT_SHM Error] Failed init_port\n'


def answer(monkeypatch, stdout: str, returncode: int = 0, stderr: str = '') -> None:
    monkeypatch.setattr(subprocess, 'run', lambda command, **options: subprocess.CompletedProcess(
        command, returncode, stdout, stderr))


@pytest.mark.parametrize('returncode', [0, -signal.SIGALRM])
def test_lines_of_the_middleware_are_no_answer(monkeypatch, returncode: int) -> None:
    """A helper that could not leave the graph has answered all the same."""
    answer(monkeypatch, NOISE + 'two words\n', returncode)
    check_domain(7, ['/clock'])
    answer(monkeypatch, NOISE + '/clock physics_node\n/odom other\n', returncode)
    with pytest.raises(GraphError, match='--domain 7: physics_node publishes /clock there'):
        check_domain(7, ['/clock', '/odom'])


def test_a_helper_that_fails_is_an_error(monkeypatch) -> None:
    answer(monkeypatch, '', 1, 'Traceback\nImportError: no rclpy\n')
    with pytest.raises(GraphError, match='--domain 7: .*found out: ImportError: no rclpy'):
        check_domain(7, ['/clock'])

    def never(command, **options):
        raise subprocess.TimeoutExpired(command, 30.0)
    monkeypatch.setattr(subprocess, 'run', never)
    with pytest.raises(GraphError, match='--domain 7: .*found out within 30 s'):
        check_domain(7, ['/clock'])


def reader_of(monkeypatch, program: str) -> ClockReader:
    """Return the reader of a helper that runs a program of our own."""
    start = subprocess.Popen
    monkeypatch.setattr(subprocess, 'Popen', lambda command, **options: start(
        [sys.executable, '-c', program], **options))
    return ClockReader(7)


def test_the_newest_time_counts(monkeypatch) -> None:
    with reader_of(monkeypatch, 'print(5); print("Fast DDS"); print(17, flush=True); '
                                'input()') as clock:
        wait_until(lambda: clock.now_ns() == 17)
        clock.check()


def test_a_dead_helper_is_named_with_its_reason(monkeypatch) -> None:
    """Else the node that is asked for the time would be blamed for its silence."""
    with reader_of(monkeypatch, 'print(5); raise SystemExit("no memory left")') as clock:
        with pytest.raises(GraphError, match='reads the clock ended with status 1: no memory'):
            for _ in range(1000):
                clock.check()
                time.sleep(0.02)
        assert clock.now_ns() == 5
