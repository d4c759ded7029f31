"""Warnings of nodes, read from logs that grow."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.run.node_processes import NodeLogs


def test_warnings_are_read_once_and_summed_up(tmp_path: Path) -> None:
    """Only WARN and worse; a half-written line waits; other numbers are the same kind."""
    log = tmp_path / 'drive_node.log'
    logs = NodeLogs({'drive_node': log, 'render_node': tmp_path / 'none.log'})
    assert logs.new_warnings() == []
    with log.open('w') as file:
        file.write('[INFO] [1.5] [drive_node]: waiting\n[WARN] [2.5] [drive_node]: cmd_vel: 1.5 '
                   'refused\nTraceback\n[ERROR] [3.5] [drive_node]: stu')
        file.flush()
        first = logs.new_warnings()
        assert [(w.node, w.level, w.text) for w in first] == [
            ('drive_node', 'WARN', 'cmd_vel: 1.5 refused')]
        file.write('ck at (1.0, 2.0)\n[WARN] [4.5] [drive_node]: cmd_vel: -2e9 refused\n')
    assert [w.text for w in logs.new_warnings()] == ['stuck at (1.0, 2.0)',
                                                     'cmd_vel: -2e9 refused']
    assert logs.new_warnings() == []
    assert logs.summary() == [
        'drive_node: WARN: cmd_vel: -2e9 refused (2 times; the last one is shown)',
        'drive_node: ERROR: stuck at (1.0, 2.0)']


def test_a_warning_that_counts_itself_is_not_counted_again(tmp_path: Path) -> None:
    """Its last line has the count of all, which are more than the lines."""
    log = tmp_path / 'a.log'
    log.write_text(''.join(
        f'[WARN] [1.5] [a]: cmd_vel: linear.x = {value} refused ({count} so far); valid is finite'
        '\n' for value, count in (('nan', 1), ('-inf', 37), ('nan', 41))))
    logs = NodeLogs({'a': log})
    assert len(logs.new_warnings()) == 3
    assert logs.summary() == [
        'a: WARN: cmd_vel: linear.x = nan refused (41 so far); valid is finite']


def test_a_flood_without_end_of_line_is_passed(tmp_path: Path) -> None:
    """What follows it is read."""
    log = tmp_path / 'a.log'
    log.write_bytes(b'x' * 100_000 + b'\n[WARN] [1.0] [a]: after the flood\n')
    logs = NodeLogs({'a': log})
    found = [w.text for _ in range(4) for w in logs.new_warnings()]
    assert found == ['after the flood']
