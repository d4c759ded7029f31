"""Programs that a run starts, and what nodes report to it."""

import os
from pathlib import Path
import resource
import signal
import subprocess
import sys
import threading

from command_line import unfolded
import psutil
import pytest
from waiting import LIMIT_S, wait_until

from lunar_rover_sim.base.errors import ProcessError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.run import node_state
from lunar_rover_sim.run.child_process import dies_with_parent, executable, run_program
from lunar_rover_sim.run.node_processes import NodeLogs
from lunar_rover_sim.run.node_state import NodeState, StateReader

# The grandchild is in the group of its parent, or in a session of its own.
GRANDCHILD = 'sleep 600 & echo $! > child; wait'
DAEMON = 'trap "" TERM; setsid sleep 600 & echo $! > child; wait'


def shell(script: str, folder: Path, timeout_s: float = 60.0, **options):
    return run_program(['sh', '-c', script], folder / 'log', timeout_s, folder=folder, **options)


def child_of(folder: Path) -> int:
    """Return the process that the script started, once it has written its number."""
    file = folder / 'child'
    wait_until(lambda: file.is_file() and file.read_text().endswith('\n'), 'no child')
    return int(file.read_text().split()[0])


def runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_log_echo_and_tail(tmp_path: Path) -> None:
    lines: list[str] = []
    ended = shell('pwd; for k in 1 2 3 4 5 6; do echo line $k; done >&2', tmp_path,
                  echo=lines.append)
    assert lines == [str(tmp_path), *(f'line {k}' for k in range(1, 7))]
    assert (tmp_path / 'log').read_text().splitlines() == lines
    assert ended.tail == tuple(lines[-5:])
    assert (ended.status, ended.words, ended.error) == (0, '', '')


@pytest.mark.parametrize(('script', 'status', 'words', 'error'), [
    ('echo before; echo lunar_rover_sim: no world >&2; exit 3', 3, 'ended with status 3',
     'no world'),
    ('exit 3', 3, 'ended with status 3', 'ended with status 3'),
    ('echo last; kill -9 $$', -9, 'crashed with SIGKILL', 'crashed with SIGKILL'),
    ('kill -40 $$', -40, 'crashed with signal 40', 'crashed with signal 40')])
def test_how_it_ended(script: str, status: int, words: str, error: str, tmp_path: Path) -> None:
    ended = shell(script, tmp_path)
    assert (ended.status, ended.words, ended.error) == (status, words, error)


def test_a_full_disk_takes_the_log_only(tmp_path: Path) -> None:
    """The program goes on: nobody leaves it with a pipe that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        ended = shell('yes | head -100000; echo last words', tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not ended.error and ended.tail[-1] == 'last words'
    assert (tmp_path / 'log').stat().st_size == 1000


def test_time_is_bounded(tmp_path: Path) -> None:
    """A program that ignores SIGTERM is killed; one that does not has time to finish."""
    ended = shell('trap "" TERM; echo ready; sleep 60', tmp_path, 0.3, grace_s=0.3)
    assert ended.timed_out and ended.status == -signal.SIGKILL
    assert ended.words == ended.error == f'was ended after {ended.wall_s:.0f} s'
    ended = shell('trap "echo finished; exit 0" TERM; sleep 60 & wait', tmp_path, 0.5,
                  grace_s=30.0)
    assert (ended.status, ended.tail, ended.timed_out) == (0, ('finished',), True)


def test_stop(tmp_path: Path) -> None:
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    ended = shell('sleep 600', tmp_path, stop=stop.is_set)
    assert (ended.words, ended.interrupted) == ('was interrupted', True)
    assert ended.wall_s < 60.0


@pytest.mark.parametrize('script', [GRANDCHILD, DAEMON])
def test_descendants_end_with_the_program(script: str, tmp_path: Path) -> None:
    ended = shell(script, tmp_path, 1.0, grace_s=0.2)
    assert ended.timed_out
    wait_until(lambda: not runs(child_of(tmp_path)), 'the grandchild is still running')


def test_sigterm_ends_the_program_first(tmp_path: Path) -> None:
    """SIGTERM, as from a batch system, leaves nothing behind and still ends this process."""
    parent = subprocess.Popen([sys.executable, '-c', parent_code(tmp_path)])
    child = child_of(tmp_path)
    parent.terminate()
    assert parent.wait(LIMIT_S) == -signal.SIGTERM
    wait_until(lambda: not runs(child), 'the grandchild is still running')


def test_program_dies_with_its_killed_parent(tmp_path: Path) -> None:
    """SIGKILL cannot be handled: the kernel tells the program."""
    if len(dies_with_parent(['true'])) == 1:
        pytest.skip('setpriv is missing')
    parent = subprocess.Popen([sys.executable, '-c', parent_code(tmp_path, 'exec sleep 600')])
    wait_until(lambda: bool(psutil.Process(parent.pid).children()), 'no child')
    child = psutil.Process(parent.pid).children()[0].pid
    wait_until(lambda: psutil.Process(child).name() == 'sleep', 'the child has not started')
    parent.kill()
    parent.wait()
    wait_until(lambda: not runs(child), 'the child is still running')


def parent_code(folder: Path, script: str = GRANDCHILD) -> str:
    return ('from pathlib import Path\n'
            'from lunar_rover_sim.run.child_process import run_program\n'
            f'folder = Path({str(folder)!r})\n'
            f'run_program(["sh", "-c", {script!r}], folder / "log", 600.0, folder=folder)\n')


def test_what_cannot_be_started(tmp_path: Path) -> None:
    plain = tmp_path / 'plain.txt'
    plain.write_text('text')
    with pytest.raises(ProcessError, match='/no/such: there is no such program'):
        executable('/no/such')
    with pytest.raises(ProcessError, match='plain.txt: cannot be executed'):
        run_program([plain], tmp_path / 'log', 1.0)
    with pytest.raises(ProcessError, match='there/log: cannot be written: No such file'):
        run_program(['true'], tmp_path / 'there' / 'log', 1.0)


def test_a_program_of_this_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                  capsys: pytest.CaptureFixture[str]) -> None:
    """`--executable ./true` is the file, not what PATH has of its name; a bare word is not."""
    on_path = executable('true')
    monkeypatch.chdir(tmp_path)
    for name in ('true', 'own_estimator'):
        (tmp_path / name).write_text('#!/bin/sh')
        (tmp_path / name).chmod(0o755)
        assert executable(Path(f'./{name}')) == executable(f'./{name}') == tmp_path / name
    assert executable('true') == on_path
    with pytest.raises(ProcessError, match='own_estimator: cannot be executed'):
        executable('own_estimator')
    assert main(['slam', 'run', 'bag', '-o', 'new', '--system', 'orbslam3', '--executable',
                 './own_estimator', '--vocabulary', 'true']) == 1
    assert 'true: is' in unfolded(capsys.readouterr().err)


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> StateReader:
    """Return the supervisor's end; this process is the node."""
    made = StateReader()
    monkeypatch.setenv(node_state.VARIABLE, str(made.writer))
    return made


def test_states_arrive_in_order_and_stay(reader: StateReader) -> None:
    states = [NodeState(node_state.READY),
              NodeState(node_state.WAITING, 'no answer', node_state.ANSWERS, 5)]
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
