"""Whether a ROS domain is free: what the answers of the helper mean. No graph runs."""

from __future__ import annotations

import signal
import subprocess

import pytest

from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.run.clock_reader import check_domain

NOISE = '2026-11-25 [RTPS_TRANSPORT_SHM Error] Failed init_port\n'


def answer(monkeypatch, stdout: str, returncode: int = 0) -> None:
    monkeypatch.setattr(subprocess, 'run', lambda command, **options: subprocess.CompletedProcess(
        command, returncode, stdout, ''))


@pytest.mark.parametrize('returncode', [0, -signal.SIGALRM])
def test_lines_of_the_middleware_are_no_answer(monkeypatch, returncode: int) -> None:
    """A helper that could not leave the graph has answered all the same."""
    answer(monkeypatch, NOISE + 'two words\n', returncode)
    check_domain(7, ['/clock'])
    answer(monkeypatch, NOISE + '/clock physics_node\n/odom other\n', returncode)
    with pytest.raises(GraphError, match='--domain 7: physics_node publishes /clock there'):
        check_domain(7, ['/clock', '/odom'])


def test_a_helper_that_fails_is_an_error(monkeypatch) -> None:
    answer(monkeypatch, '', 1)
    with pytest.raises(subprocess.CalledProcessError):
        check_domain(7, ['/clock'])
