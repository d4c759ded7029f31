"""States that nodes report through a pipe, and warnings in their logs."""

import os
from pathlib import Path

import pytest

from lunar_rover_sim.run import node_state
from lunar_rover_sim.run.node_processes import NodeLogs
from lunar_rover_sim.run.node_state import NodeState, StateReader


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> StateReader:
    """Return the supervisor's end; this process is the node."""
    made = StateReader()
    monkeypatch.setenv(node_state.VARIABLE, str(made.writer))
    return made


def test_states_arrive_in_order_and_stay(reader: StateReader) -> None:
    states = [NodeState(node_state.READY, topics=('odom',)),
              NodeState(node_state.WAITING, 'no answer', node_state.ANSWERS, ('a', 'b'), 5)]
    assert reader.read() == []
    node_state.tell(states[0])
    assert reader.read() == states[:1]
    node_state.tell(states[1])
    assert reader.read() == states and reader.read() == states
    reader.started()
    reader.close()


def test_a_failure_is_printed_for_people_and_told(reader: StateReader,
                                                  capfd: pytest.CaptureFixture[str]) -> None:
    node_state.fail('the disk is full')
    assert capfd.readouterr().err == 'FATAL the disk is full\n'
    assert reader.read() == [NodeState(node_state.FATAL, 'the disk is full')]


def test_a_node_of_nobody_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """So does one whose supervisor has gone, or does not read."""
    monkeypatch.delenv(node_state.VARIABLE, raising=False)
    assert not node_state.is_supervised()
    node_state.tell(NodeState(node_state.READY))
    made = StateReader()
    monkeypatch.setenv(node_state.VARIABLE, str(made.writer))
    assert node_state.is_supervised()
    for _ in range(1000):
        node_state.tell(NodeState(node_state.READY, 300 * 'x'))     # more than a pipe holds
    assert len(made.read()) > 10
    made.close()
    node_state.tell(NodeState(node_state.READY))
    made.started()
    node_state.tell(NodeState(node_state.READY))


def test_a_long_text_is_cut_and_programs_of_a_node_do_not_get_the_pipe(
        reader: StateReader) -> None:
    os.set_inheritable(reader.writer, True)
    node_state.tell(NodeState(node_state.FATAL, 10_000 * 'y'))
    assert reader.read() == [NodeState(node_state.FATAL, 300 * 'y')]
    assert not os.get_inheritable(reader.writer)


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
