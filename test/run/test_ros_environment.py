"""What the processes of a graph inherit."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys
import time

import pytest
from waiting import LIMIT_S

from lunar_rover_sim.run.node_processes import NodeLogs
from lunar_rover_sim.run.ros_domain import ClockReader, ros_environment

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
