"""What the processes of a graph inherit."""

from __future__ import annotations

from pathlib import Path

import pytest

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
