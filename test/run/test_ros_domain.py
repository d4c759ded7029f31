"""ROS domains, and the environment that the processes of a graph inherit."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

import pytest
from waiting import LIMIT_S, wait_until

from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.run.node_processes import NodeLogs
from lunar_rover_sim.run.ros_domain import check_domain, ClockReader, OwnDomain, ros_environment

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


@pytest.mark.parametrize(('load', 'limit_s'), [(0.5, 30), (4.0, 120)])
def test_the_search_for_publishers_gets_more_time_on_a_busy_machine(
        monkeypatch: pytest.MonkeyPatch, load: float, limit_s: float) -> None:
    """As much as its load is above its cores."""
    def run(*_: Any, timeout: float, **__: Any) -> None:
        raise subprocess.TimeoutExpired('probe', timeout)

    monkeypatch.setattr(os, 'getloadavg', lambda: (load * (os.cpu_count() or 1), 0.0, 0.0))
    monkeypatch.setattr(subprocess, 'run', run)
    with pytest.raises(GraphError, match=f'--domain 7: .*found out within {limit_s} s'):
        check_domain(7, ['/clock'])


def test_a_helper_that_fails_is_an_error(monkeypatch) -> None:
    answer(monkeypatch, '', 1, 'Traceback\nImportError: no rclpy\n')
    with pytest.raises(GraphError, match='--domain 7: .*found out: ImportError: no rclpy'):
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


@pytest.mark.parametrize('domain', [-1, 233, 10**9, '7', 1.5])
def test_numbers_that_are_no_domain(domain: Any) -> None:
    """Their ports would not exist; rclpy takes a negative one for domain 0 without a word."""
    with pytest.raises(ConfigError, match=f'--domain {domain!r}: is not valid; valid is 0 to 23'):
        OwnDomain(domain)


def test_a_domain_is_given_once() -> None:
    """Named or chosen, and again when it was given back."""
    with OwnDomain() as first, OwnDomain() as second:
        assert first.id != second.id
        with pytest.raises(GraphError, match=f'--domain {first.id}: another run is using it'):
            OwnDomain(first.id)
    with OwnDomain(first.id) as again:
        assert again.id == first.id


PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def test_profiles_of_fast_dds_are_ours_or_those_of_the_user(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """The packaged file has short periods; a file that the user names is used instead."""
    monkeypatch.delenv(PROFILES, raising=False)
    packaged = Path(ros_environment(7)[PROFILES])
    assert all(f'<{period}>' in packaged.read_text()
               for period in ('leaseAnnouncement', 'heartbeatPeriod'))
    monkeypatch.setenv(PROFILES, '/home/somebody/profiles.xml')
    assert ros_environment(7)[PROFILES] == '/home/somebody/profiles.xml'


@pytest.mark.ros
def test_other_machines_find_no_port_of_a_run(domain: int,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    """What others may write to is open on this machine only; no static peer drives the rover."""
    monkeypatch.delenv(PROFILES, raising=False)
    script = ("import psutil, rclpy; rclpy.init(); node = rclpy.create_node('alone'); "
              "print(*(f'{s.laddr.ip}:{s.laddr.port}' for s in "
              "psutil.Process().net_connections('inet')))")
    finished = subprocess.run([sys.executable, '-c', script], env=ros_environment(domain),
                              capture_output=True, text=True, timeout=LIMIT_S, check=True)
    of_domain = range(7400 + 250 * domain, 7650 + 250 * domain)
    places = [place.rpartition(':') for place in finished.stdout.split()]
    addresses = {ip for ip, _, port in places if int(port) in of_domain}
    assert addresses == {'127.0.0.1'}, places


@pytest.mark.ros
def test_what_fast_dds_prints_is_no_time(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of profiles that is not there is told on standard output, among the times."""
    monkeypatch.setenv(PROFILES, '/there/is/none.xml')
    with ClockReader(domain) as clock:
        until = time.monotonic() + 2.5
        while time.monotonic() < until:
            assert clock.now_ns() == 0
            time.sleep(0.1)


@pytest.mark.ros
def test_warnings_are_found_however_the_shell_wants_its_log(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Colours and formats of the user are for the user's own nodes."""
    monkeypatch.setenv('RCUTILS_COLORIZED_OUTPUT', '1')
    monkeypatch.setenv('RCUTILS_CONSOLE_OUTPUT_FORMAT', '{name}: {message}')
    log = tmp_path / 'x.log'
    with log.open('wb') as file:
        subprocess.run([sys.executable, '-c', 'import rclpy.logging; '
                        'rclpy.logging.get_logger("x").warning("stuck")'],
                       env=ros_environment(7), stdout=file, stderr=file, check=True,
                       timeout=LIMIT_S)
    assert [warning.text for warning in NodeLogs({'x': log}).new_warnings()] == ['stuck']
