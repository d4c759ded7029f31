"""When a run counts as hung: time stands still, and none of its nodes works."""

import contextlib
import os
from pathlib import Path
import subprocess
import sys
import time

import pytest

from lunar_rover_sim.bag.marker import mark, why_incomplete
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.run import node_processes
from lunar_rover_sim.run.ending import DONE, Ending, Step
from lunar_rover_sim.run.node_processes import is_at_work, NodeProcesses
from lunar_rover_sim.run.plan import NodePlan, resolve
from lunar_rover_sim.run.recording import Limits, supervise
from lunar_rover_sim.run.scenario import Scenario

NOW_NS = 3_000_000_000
SILENT = 'nothing on stereo/left/camera_info since 2.9 s; physics_node waits for it'


class Clock:
    """Time that stands still at 3 s."""

    def now_ns(self) -> int:
        return NOW_NS

    def check(self) -> None:
        """It lives."""


class Nodes:
    """Nodes that work until some wall time after the first look, and finish at another one."""

    def __init__(self, work_s: float, finish_s: float = 1e9, compile_s: float = 0.0,
                 loading: float = 0.0) -> None:
        """Begin; `loading`: processor time of those that load, for each second."""
        self._start_s = time.monotonic()
        self._work_s, self._finish_s, self._compile_s = work_s, finish_s, compile_s
        self._loading = loading

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._start_s

    def has_finished(self) -> bool:
        return self._elapsed_s() > self._finish_s

    def at_work(self) -> bool:
        return self._elapsed_s() < self._work_s

    def suspended(self) -> list[str]:
        return []

    def compiling(self) -> list[str]:
        return ['render_node'] if self._elapsed_s() < self._compile_s else []

    def loading_cpu_s(self) -> float:
        return self._loading * self._elapsed_s()

    def fatal_error(self) -> None:
        return None

    def unstarted(self) -> str:
        return ''

    def silent_participant(self, now_ns: int) -> str:
        return SILENT

    def measure(self) -> None:
        pass


def watch(nodes: Nodes, limits: Limits) -> bool:
    return supervise(nodes, Clock(), limits, lambda _: None, lambda: False)  # type: ignore


def test_who_works_for_long_is_not_silent() -> None:
    """A frame may take three times as long as idle nodes may wait."""
    limits = Limits(silence_s=5.0, start_s=5.0, end_ns=0, idle_s=0.4)
    assert watch(Nodes(work_s=1e9, finish_s=1.2), limits)


def test_who_compiles_is_not_silent() -> None:
    """However long it takes; what it misses afterwards counts from then on."""
    limits = Limits(silence_s=0.5, start_s=0.5, end_ns=0, idle_s=0.5)
    assert watch(Nodes(work_s=0.0, finish_s=1.5, compile_s=1.3), limits)
    with pytest.raises(GraphError):
        watch(Nodes(work_s=0.0, finish_s=3.0, compile_s=1.3), limits)


@pytest.mark.parametrize(('loading', 'starts'), [(4.0, True), (0.02, False), (0.0, False)])
def test_who_loads_is_given_up_where_it_hangs_alone(monkeypatch: pytest.MonkeyPatch,
                                                    loading: float, starts: bool) -> None:
    """However long it takes on a machine that others use; one that hangs wakes up at times."""
    monkeypatch.setattr(Clock, 'now_ns', lambda _: 0)
    limits = Limits(silence_s=1.0, start_s=1.0, end_ns=0, idle_s=1.0)
    nodes = Nodes(work_s=0.0, finish_s=4.0, loading=loading)
    with contextlib.nullcontext() if starts else pytest.raises(GraphError):
        assert watch(nodes, limits)


def test_nodes_that_all_wait_end_the_run_soon() -> None:
    """With the answer that physics misses, long before the limit of one that works."""
    start = time.monotonic()
    with pytest.raises(GraphError, match='nothing on .*camera_info since'):
        watch(Nodes(work_s=0.0), Limits(silence_s=20.0, start_s=20.0, end_ns=0, idle_s=0.4))
    assert time.monotonic() - start < 15.0


def test_work_that_never_ends_is_limited_too() -> None:
    with pytest.raises(GraphError):
        watch(Nodes(work_s=1e9), Limits(silence_s=0.6, start_s=20.0, end_ns=0, idle_s=0.3))


def test_who_has_stopped_to_work_is_noticed() -> None:
    """A node that has worked for a while and then hangs ends the run all the same."""
    with pytest.raises(GraphError):
        watch(Nodes(work_s=0.5), Limits(silence_s=20.0, start_s=20.0, end_ns=0, idle_s=0.4))


def test_programs_that_the_run_has_not_started_are_given_their_time() -> None:
    """Their work cannot be seen: a scenario says how long they may take."""
    limits = Limits(silence_s=5.0, start_s=5.0, end_ns=0, idle_s=0.3, others=True)
    assert watch(Nodes(work_s=0.0, finish_s=1.0), limits)
    assert not Limits.of(resolve(Scenario.load('flat'))).others
    own = ['physics_node.wait.topics=[my/pose]', 'physics_node.wait.lags_s=[0.1]']
    assert Limits.of(resolve(Scenario.load('flat', own))).others
    steered = ['run.nodes=[physics_node, gait_controller_node]',
               'gait_controller_node.wait.topics=[cmd_vel]',
               'gait_controller_node.wait.lags_s=[0.05]']
    assert Limits.of(resolve(Scenario.load('flat', steered))).others


@pytest.mark.parametrize('now_ns', [0, 2_200_000_000])
@pytest.mark.parametrize(('load', 'work_s', 'starts'), [(1.0, 1e9, False), (8.0, 1e9, True),
                                                        (8.0, 0.0, False)])
def test_a_busy_machine_gets_more_time(monkeypatch: pytest.MonkeyPatch, load: float,
                                       work_s: float, starts: bool, now_ns: int) -> None:
    """As much as its load is above its cores, also for a first image; not where no node works."""
    monkeypatch.setattr(os, 'getloadavg', lambda: (load * (os.cpu_count() or 1), 0.0, 0.0))
    monkeypatch.setattr(Clock, 'now_ns', lambda _: now_ns)
    limits, nodes = Limits(silence_s=0.5, start_s=0.5, end_ns=0, idle_s=0.5), Nodes(
        work_s, finish_s=1.5)
    with contextlib.nullcontext() if starts else pytest.raises(GraphError):
        assert watch(nodes, limits)


def test_a_limit_below_that_of_idle_nodes_holds_for_them_too() -> None:
    limits = Limits.of(resolve(Scenario.load('flat', ['physics_node.wait.silence_s=3.0'])))
    assert limits.silence_s is not None and limits.idle_s <= limits.silence_s <= 4.0


def start_all(folder: Path, monkeypatch: pytest.MonkeyPatch, scripts: dict[str, str],
              may_fail: tuple[str, ...] = ()) -> NodeProcesses:
    """Start a process for each node; scripts: what each does."""
    monkeypatch.setattr(node_processes, 'dies_with_parent', lambda command: [
        sys.executable, '-c', next(scripts[word] for word in command if word in scripts)])
    return NodeProcesses([NodePlan(name, {}) for name in scripts], folder, 77, may_fail)


@pytest.mark.parametrize('physics', [
    'time.sleep(60.0)',
    'tell(NodeState(WAITING, "nothing on lidar/scanned", PUBLISHERS))\n'
    'fail("nothing on lidar/scanned")\nexit(1)'])
def test_who_has_not_started_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                      physics: str) -> None:
    """Not physics, which waits for it, whether or not physics has given up."""
    ready = ('import time\nfrom lunar_rover_sim.run.node_state import *\n'
             'tell(NodeState(READY))\nprint("ready", flush=True)\n')
    nodes = start_all(tmp_path, monkeypatch, {'physics_node': ready + physics,
                                              'lidar_node': 'import time\ntime.sleep(60.0)'})
    while 'ready' not in nodes.log('physics_node').read_text():
        time.sleep(0.02)
    limits = Limits(silence_s=5.0, start_s=1.5, end_ns=0, idle_s=1.5)
    try:
        with pytest.raises(GraphError, match='not started (within 1.5 s|yet): lidar_node .log'):
            supervise(nodes, Clock(), limits, lambda _: None, lambda: False)    # type: ignore
        assert 'physics_node' not in nodes.unstarted()
    finally:
        nodes.kill()


# Typing a call of `slow` takes two seconds, as that of large loops does.
COMPILES = """
import time
from numba.extending import overload
from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.nodes.node_main import run

def slow(x):
    return x

@overload(slow)
def slow_of(x):
    time.sleep(2.0)
    return lambda x: x

@compiled
def loop(x):
    return slow(x)

def node():
    time.sleep(1.0)
    loop(1.0)
    time.sleep(1.0)
    raise ConfigError('done')

exit(run(node, ['drive_node']))
"""


@pytest.mark.ros
def test_what_a_run_waits_for_at_its_start(tmp_path: Path,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes that load, then that they compile, then that they load again."""
    nodes, seen = start_all(tmp_path, monkeypatch, {'drive_node': COMPILES}), ['']
    try:
        while 'done' not in str(nodes.fatal_error()):
            words = nodes.waits_for(0)
            seen += [words] if words != seen[-1] else []
            time.sleep(0.02)
    finally:
        nodes.kill()
    assert seen[1:] == ['loading drive_node', 'compiling, once: drive_node', 'loading drive_node']


def finish(nodes: NodeProcesses) -> None:
    """Return when physics has finished; raise where a node has failed."""
    while not nodes.has_finished():
        time.sleep(0.02)


def test_when_physics_has_finished_the_recorder_finishes_its_work(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every other node is told to stop, the recorder after all of them."""
    stop = ('import pathlib, signal, sys, time\n'
            'def stop(*_):\n time.sleep({pause})\n pathlib.Path({file!r}).touch()\n'
            ' sys.exit(0)\nsignal.signal(signal.SIGINT, stop)\n'
            'signal.pthread_sigmask(signal.SIG_SETMASK, ())\nwhile True: time.sleep(0.1)\n')
    drawn, written = tmp_path / 'drawn', tmp_path / 'written'
    nodes = start_all(tmp_path, monkeypatch, {
        'physics_node': 'pass', 'render_node': stop.format(pause=0.5, file=str(drawn)),
        'recorder_node': stop.format(pause=0.0, file=str(written))})
    with nodes:
        finish(nodes)
    assert drawn.stat().st_mtime_ns < written.stat().st_mtime_ns


def test_who_may_fail_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = start_all(tmp_path, monkeypatch, {'lidar_node': 'import time\ntime.sleep(60.0)'},
                      ('lidar_node',))
    try:
        assert not nodes.unstarted()
    finally:
        nodes.kill()


@pytest.mark.parametrize('name', ['lidar_node', 'recorder_node'])
def test_who_does_not_stop_is_killed_and_named(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """The run goes on without one that may fail; the bag of a recorder is marked."""
    (tmp_path / 'bag').mkdir()
    mark(tmp_path / 'bag')
    monkeypatch.setattr(node_processes, '_STOP_S', 1.0)
    # SIGINT is blocked from the start and stays so.
    nodes = start_all(tmp_path, monkeypatch, {name: 'import time\ntime.sleep(60.0)'},
                      ('lidar_node',))
    ended = f'{name} did not stop within 1 s and was killed'
    if name == 'recorder_node':
        with pytest.raises(GraphError, match=ended):
            nodes.stop()
        assert ended in (why_incomplete(tmp_path / 'bag') or '')
    else:
        nodes.stop()
        assert nodes.lost[name] == f'{ended}; the run goes on'
    nodes.kill()


def test_what_a_killed_node_logged_of_its_work_is_no_reason(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = start_all(tmp_path, monkeypatch, {
        'lidar_node': 'print("[INFO] [1.5] [lidar_node]: ready: seed 1", flush=True)\n'
                      'import os\nos.kill(os.getpid(), 9)'})
    with pytest.raises(GraphError, match='^lidar_node ended with SIGKILL: it gave no reason .log'):
        finish(nodes)
    nodes.kill()


@pytest.mark.parametrize('words,done', [('print("[INFO] all written")', True),
                                        ('fail("the disk is full")', False)])
def test_who_cannot_leave_the_graph_has_done_its_work(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, done: bool) -> None:
    """SIGALRM ends such a node; an error that it had before stays one."""
    nodes = start_all(tmp_path, monkeypatch, {
        'physics_node': f'from lunar_rover_sim.run.node_state import fail\n{words}\n'
                        'import os\nos.kill(os.getpid(), 14)'})
    try:
        if done:
            finish(nodes)
            nodes.stop()
        else:
            with pytest.raises(GraphError, match='physics_node ended with SIGALRM: the disk is'):
                finish(nodes)
    finally:
        nodes.kill()


@pytest.mark.parametrize('code,killed', [
    # Checksums of a large bag, for twice as long as an idle node is given.
    ('end = time.monotonic() + 2.0\nwhile time.monotonic() < end: pass', False),
    # A first run whose renderer still compiles when it ends, for longer than one at work is given.
    ('tell(NodeState(COMPILING))\nend = time.monotonic() + 4.0\n'
     'while time.monotonic() < end: pass\ntell(NodeState(COMPILED))', False),
    ('time.sleep(60.0)', True)])
def test_who_works_while_it_is_stopped_is_given_time(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, killed: bool) -> None:
    """A recorder that finishes a large bag is not killed; one that hangs is."""
    script = tmp_path / 'node.py'
    script.write_text('import signal, sys, time\n'
                      'from lunar_rover_sim.run.node_state import *\n'
                      f'def stop(*_):\n {code.replace(chr(10), chr(10) + " ")}\n sys.exit(0)\n'
                      'signal.signal(signal.SIGINT, stop)\n'
                      'signal.pthread_sigmask(signal.SIG_SETMASK, ())\n'
                      'print("ready", flush=True)\nwhile True: time.sleep(0.1)\n')
    monkeypatch.setattr(node_processes, '_STOP_S', 1.0)
    monkeypatch.setattr(node_processes, '_STOP_AT_WORK_S', 3.0)
    monkeypatch.setattr(node_processes, 'dies_with_parent', lambda _: [sys.executable, script])
    nodes = NodeProcesses([NodePlan('render_node', {})], tmp_path, 77)
    while 'ready' not in nodes.log('render_node').read_text():
        time.sleep(0.02)
    if killed:
        with pytest.raises(GraphError, match='render_node did not stop within 1 s and was killed'):
            nodes.stop()
    else:
        nodes.stop()
    nodes.kill()


@pytest.mark.parametrize('code,works', [
    ('while True: pass', True), ('import time; time.sleep(60)', False),
    # Its main thread waits, as that of a renderer does while llvmpipe draws.
    ('import threading\ndef f():\n while True: pass\nthreading.Thread(target=f).start()', True)])
def test_work_of_a_process(tmp_path: Path, code: str, works: bool) -> None:
    """By the states of its threads, whatever its name is."""
    interpreter = tmp_path / ') R 1 ('
    interpreter.symlink_to(sys.executable)
    with subprocess.Popen([interpreter, '-S', '-c', f'print(flush=True)\n{code}'],
                          stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.2)
        looks = []
        for _ in range(20):
            looks.append(is_at_work(process.pid))
            time.sleep(0.02)
        process.kill()
    assert (sum(looks) > 10) == works
    assert not is_at_work(process.pid)


def test_a_node_that_is_stopped_is_named_with_the_time_that_it_has(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The warning's number is the time after which the run ends."""
    nodes = start_all(tmp_path, monkeypatch, {
        'render_node': 'import os, signal\nos.kill(os.getpid(), signal.SIGSTOP)'})
    warnings: list[str] = []
    limits = Limits(silence_s=20.0, start_s=20.0, end_ns=0, idle_s=1.0)
    start = time.monotonic()
    try:
        with pytest.raises(GraphError, match='^render_node is stopped .SIGSTOP. at 3.000 s'):
            supervise(nodes, Clock(), limits, lambda _: None, lambda: False,  # type: ignore
                      warnings.append)
    finally:
        nodes.kill()
    assert warnings == ['render_node is stopped (SIGSTOP): the run ends in 1 s unless it goes on']
    assert 1.0 <= time.monotonic() - start < 5.0


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
