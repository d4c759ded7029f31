"""What nodes tell their supervisor, through a pipe."""

from __future__ import annotations

import os

import pytest

from lunar_rover_sim.run import node_state
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
