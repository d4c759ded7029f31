"""The end of a run: the order in which nodes stop, failures, and the mark on the bag."""

from lunar_rover_sim.run.ending import DONE, Ending, Step

NODES = ('recorder_node', 'drive_node', 'physics_node', 'gait_controller_node', 'render_node',
         'lidar_node')
OTHERS = ('drive_node', 'gait_controller_node', 'render_node', 'lidar_node')


def after(ending: Ending, name: str, status: int, shutting_down: bool = False) -> Step:
    return ending.after(name, f'{name} has ended with status {status}', status in DONE,
                        shutting_down)


def stopped(ending: Ending, *names: str) -> list[tuple[str, ...]]:
    """Return which nodes are stopped when some end well, each after the other."""
    return [after(ending, name, 0).stop for name in names]


def test_when_physics_has_finished_the_others_are_stopped_the_recorder_last() -> None:
    """The recorder takes what the others still send. SIGALRM is that of one that DDS holds."""
    for status in DONE:
        ending = Ending(NODES)
        assert after(ending, 'physics_node', status) == ending.begin() == Step(OTHERS)
        assert stopped(ending, *OTHERS[::-1]) == [(), (), (), ('recorder_node',)]
        assert after(ending, 'recorder_node', 0) == Step()


def test_while_time_goes_on_nodes_are_stopped_one_after_the_other() -> None:
    ending = Ending(NODES)
    assert ending.begin() == Step(('drive_node',))
    assert stopped(ending, 'drive_node', 'physics_node') == [
        ('physics_node',), ('gait_controller_node', 'render_node', 'lidar_node')]
    # Unless the run is given up, or a signal has ended several nodes already.
    assert Ending(NODES).begin(at_once=True) == Ending(NODES).begin('why') == Step(
        ('drive_node', 'physics_node', 'gait_controller_node', 'render_node', 'lidar_node'))
    ending = Ending(NODES)
    assert stopped(ending, 'drive_node', 'recorder_node', 'gait_controller_node') == [
        ('physics_node',), (), ()]


def test_a_node_that_dies_fails_the_run_and_the_bag_is_marked_after_its_recorder() -> None:
    """A mark before would be lost when the recorder finishes its bag."""
    why = 'render_node has ended with status 3'
    mark = f'the run failed: {why}'
    ending = Ending(NODES)
    assert after(ending, 'render_node', 3) == Step(failure=why)
    assert after(ending, 'drive_node', 0, shutting_down=True) == Step()
    assert after(ending, 'recorder_node', 0, shutting_down=True) == Step(mark=mark)
    assert after(ending, 'physics_node', -9, shutting_down=True) == Step(mark=mark)
    ending = Ending(NODES)
    ending.begin('no answer for 5 s')
    stopped(ending, 'physics_node', *OTHERS)
    assert after(ending, 'recorder_node', 0) == Step(mark='the run failed: no answer for 5 s')


def test_a_recorder_that_dies_leaves_a_marked_bag() -> None:
    """Nobody else could mark it."""
    why = 'recorder_node has ended with status -11'
    for ending in (Ending(NODES), Ending(['recorder_node'])):
        step = after(ending, 'recorder_node', -11)
        assert step == Step(failure=why, mark=f'the run failed: {why}')


def test_the_run_goes_on_without_a_node_that_may_fail_however_it_has_ended() -> None:
    """Status 0 is that of a node that a signal has ended."""
    for status in (0, 1, -9):
        ending = Ending(NODES, ('lidar_node',))
        assert after(ending, 'lidar_node', status) == Step(
            lost=f'lidar_node has ended with status {status}; the run goes on')
        assert after(ending, 'physics_node', 0) == Step(OTHERS[:-1])
        assert stopped(ending, *OTHERS[:-1])[-1] == ('recorder_node',)


def test_a_node_that_may_fail_and_dies_while_it_is_stopped_does_not_keep_the_recorder() -> None:
    """Otherwise the recorder would never be told to finish its bag."""
    ending = Ending(NODES, ('lidar_node',))
    stopped(ending, 'physics_node', *OTHERS[:-1])
    assert after(ending, 'lidar_node', -6) == Step(
        ('recorder_node',), lost='lidar_node has ended with status -6; the run goes on')
    ending = Ending(NODES, ('lidar_node',))
    stopped(ending, 'physics_node', *OTHERS[:-1])
    assert after(ending, 'lidar_node', 0) == Step(('recorder_node',))


def test_after_ctrl_c_nothing_is_stopped_here_and_nothing_has_failed() -> None:
    """Launch itself stops all nodes, which may end in any order and with any status."""
    ending = Ending(NODES)
    assert {after(ending, name, -2, shutting_down=True) for name in NODES} == {Step()}


def test_where_nobody_signals_nodes_only_physics_ends_the_run_well() -> None:
    ending = Ending(NODES, by_physics=True)
    assert after(ending, 'drive_node', 0) == Step(failure='drive_node has ended with status 0')
    assert after(Ending(NODES, by_physics=True), 'physics_node', 0) == Step(OTHERS)
