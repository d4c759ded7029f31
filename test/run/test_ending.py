"""What follows when nodes of a launched run end."""

from __future__ import annotations

from lunar_rover_sim.run.node_processes import Ending, Step

NODES = ('recorder_node', 'drive_node', 'physics_node', 'gait_controller_node', 'render_node',
         'lidar_node')


def ended(ending: Ending, *names: str) -> list[str]:
    """Return which nodes are stopped when some end well, each after the other."""
    return [ending.after(name, 0).stop for name in names]


def test_when_physics_has_finished_the_others_are_stopped_the_recorder_last() -> None:
    """The recorder takes what the others still send."""
    order = ['physics_node', 'drive_node', 'gait_controller_node', 'render_node', 'lidar_node',
             'recorder_node']
    assert ended(Ending(NODES), *order) == [*order[1:], '']


def test_nodes_that_have_ended_are_not_stopped_again() -> None:
    """Signals may have ended several nodes at once."""
    assert ended(Ending(NODES), 'drive_node', 'recorder_node', 'gait_controller_node') == [
        'physics_node', 'physics_node', 'physics_node']


def test_a_node_that_dies_fails_the_run_and_the_bag_is_marked_after_its_recorder() -> None:
    """A mark before would be lost when the recorder finishes its bag."""
    ending = Ending(NODES)
    why = 'render_node has ended with status 3'
    assert ending.after('render_node', 3) == Step(failure=why)
    assert ending.after('drive_node', 0, shutting_down=True) == Step()
    assert ending.after('recorder_node', 0, shutting_down=True) == Step(
        mark=f'the run failed: {why}')
    assert ending.after('physics_node', -9, shutting_down=True) == Step(
        mark=f'the run failed: {why}')


def test_a_recorder_that_dies_leaves_a_marked_bag() -> None:
    """Nobody else could mark it."""
    why = 'recorder_node has ended with status -11'
    assert Ending(NODES).after('recorder_node', -11) == Step(
        failure=why, mark=f'the run failed: {why}')


def test_the_run_goes_on_without_a_node_that_may_fail_however_it_has_ended() -> None:
    """As `lunar_rover_sim run` does: status 0 is that of a node that a signal has ended."""
    for status in (0, 1, -9):
        ending = Ending(NODES, ('lidar_node',))
        assert ending.after('lidar_node', status) == Step(
            lost=f'lidar_node has ended with status {status}; the run goes on')
        assert ended(ending, 'physics_node', 'drive_node', 'gait_controller_node',
                     'render_node') == ['drive_node', 'gait_controller_node', 'render_node',
                                        'recorder_node']


def test_a_node_that_may_fail_and_dies_while_it_is_stopped_does_not_keep_the_recorder() -> None:
    """Otherwise the recorder would never be told to finish its bag."""
    ending = Ending(NODES, ('lidar_node',))
    ended(ending, 'physics_node', 'drive_node', 'gait_controller_node')
    assert ending.after('render_node', 0) == Step(stop='lidar_node')
    assert ending.after('lidar_node', -6) == Step(stop='recorder_node')
    assert ending.after('recorder_node', 0) == Step()


def test_after_ctrl_c_nothing_is_stopped_here_and_nothing_has_failed() -> None:
    """Launch itself stops all nodes, which may end in any order and with any status."""
    ending = Ending(NODES)
    assert {ending.after(name, -2, shutting_down=True) for name in NODES} == {Step()}


def test_a_node_that_dds_keeps_from_leaving_has_done_its_work() -> None:
    """SIGALRM ends it, in a launch as in a run."""
    assert Ending(NODES).after('physics_node', -14) == Step(stop='drive_node')
