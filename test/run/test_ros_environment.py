"""What the processes of a graph inherit."""

from __future__ import annotations

from pathlib import Path
import time

import pytest

from lunar_rover_sim.run.clock_reader import ClockReader
from lunar_rover_sim.run.node_processes import ros_environment

PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def test_profiles_of_fast_dds_are_ours_or_those_of_the_user(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """The packaged file announces nodes often; a file that the user names is used instead."""
    monkeypatch.delenv(PROFILES, raising=False)
    packaged = Path(ros_environment(7)[PROFILES])
    assert '<leaseAnnouncement>' in packaged.read_text()
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
