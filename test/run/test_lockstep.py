"""The gate that time waits at."""

from __future__ import annotations

from lunar_rover_sim.run.lockstep import StampGate, WrittenStamps

MS = 1_000_000


def test_zero_lag_awaits_every_state() -> None:
    """Time goes on from a state only when it has been answered."""
    gate = StampGate({'joint_commands': 0})
    assert gate.is_open(0)
    assert not gate.is_open(5 * MS)
    gate.answer('joint_commands', 5 * MS)
    assert gate.is_open(5 * MS)
    assert gate.missing(10 * MS) == {'joint_commands': 5 * MS}


def test_period_lag_awaits_the_newest_period() -> None:
    """With a lag of one period a 10 Hz topic is awaited at each of its stamps."""
    gate = StampGate({'camera_info': 100 * MS})
    assert gate.is_open(95 * MS)
    assert not gate.is_open(100 * MS)
    gate.answer('camera_info', 100 * MS)
    assert gate.is_open(195 * MS)
    assert not gate.is_open(200 * MS)


def test_two_periods_let_the_renderer_be_one_frame_behind() -> None:
    """The frame before the present one must be there, the present one need not."""
    gate = StampGate({'camera_info': 200 * MS})
    assert gate.is_open(195 * MS)
    assert not gate.is_open(200 * MS)
    gate.answer('camera_info', 100 * MS)
    assert gate.is_open(200 * MS)
    assert gate.is_open(295 * MS)
    assert not gate.is_open(300 * MS)


def test_older_answers_change_nothing() -> None:
    """A late duplicate does not turn time back."""
    gate = StampGate({'a': 0})
    gate.answer('a', 20)
    gate.answer('a', 10)
    assert gate.is_open(20)
    assert gate.has_answered('a')


def test_behind_is_stricter_than_missing() -> None:
    """At the end everybody must have answered the end itself, whatever lag they had."""
    gate = StampGate({'a': 0, 'b': 100})
    gate.answer('a', 50)
    assert gate.missing(50) == {}
    assert gate.behind(50) == {'b': 0}


def test_a_slow_topic_is_written_until_its_next_message_is_due() -> None:
    """States every 5 ms, depth every 200 ms: what ends at 700 ms is complete with depth of 600."""
    written = WrittenStamps({'odom': 5 * MS, 'depth': 200 * MS})
    for ns in range(5 * MS, 701 * MS, 5 * MS):
        assert written.write('odom', ns)
    assert written.up_to_ns == 195 * MS
    written.write('depth', 400 * MS)
    assert written.up_to_ns == 595 * MS
    written.write('depth', 600 * MS)
    assert written.up_to_ns == 700 * MS
    assert not written.write('scenario', 900 * MS)
    written.restart()
    written.write('odom', 5 * MS)
    assert written.up_to_ns == 5 * MS


def test_a_topic_of_no_known_period_is_written_up_to_its_stamp() -> None:
    """Nobody knows when its next message is due."""
    written = WrittenStamps({'odom': 5 * MS, 'other': 0})
    written.write('odom', 700 * MS)
    assert written.up_to_ns == 0
    written.write('other', 600 * MS)
    assert written.up_to_ns == 600 * MS
