"""The node processes of one run: started with their logs, observed, stopped in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import dataclasses
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from types import TracebackType

import psutil

from lunar_rover_sim.bag.marker import mark_failed, why_incomplete
from lunar_rover_sim.base.compilation import WORDS
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.run import node_state
from lunar_rover_sim.run.child_process import dies_with_parent, signal_name
from lunar_rover_sim.run.ending import DONE, Ending, RECORDER, Step
from lunar_rover_sim.run.node_config import LEG_CONTROLLERS
from lunar_rover_sim.run.node_state import NodeState, StateReader
from lunar_rover_sim.run.plan import LOG_FOLDER, NodePlan, SCENARIO_FILE
from lunar_rover_sim.run.ros_domain import ros_environment

# The recorder needs this time to finish its bag. After a failure the other nodes have nothing
# left to add to it. A process that still works then, on a busy machine, is given more.
_STOP_S = 15.0
_STOP_AT_WORK_S = 60.0
_POLL_S = 0.05
_STOP_AFTER_FAILURE_S = 2.0


class NodeProcesses:
    """The processes of one run; context manager that leaves none behind.

    Attributes:
        cpu_s: Node → processor time used so far [s].
        lost: Node → how it ended, of nodes without which the run goes on.
    """

    def __init__(self, plans: Sequence[NodePlan], folder: Path, domain: int,
                 may_fail: Sequence[str] = ()) -> None:
        """Start one process per plan, with its log in `folder`/logs.

        Args:
            folder: Of the run.
            domain: ROS_DOMAIN_ID.
            may_fail: Nodes without which the run goes on.
        """
        self._may_fail = set(may_fail)
        self._ending = Ending([plan.name for plan in plans], may_fail, by_physics=True)
        self._noted: set[str] = set()       # nodes whose end the state machine knows
        self.lost: dict[str, str] = {}
        self._folder = folder
        self.cpu_s: dict[str, float] = {}
        self._processes: dict[str, psutil.Popen] = {}
        self._states: dict[str, StateReader] = {}
        (folder / LOG_FOLDER).mkdir(exist_ok=True)
        environment = ros_environment(domain)
        try:
            for plan in plans:
                self._processes[plan.name] = self._start(plan, environment)
        except BaseException:
            self.kill()
            raise

    def _start(self, plan: NodePlan, environment: dict[str, str]) -> psutil.Popen:
        command = [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', plan.name,
                   *plan.ros_arguments(self._folder / SCENARIO_FILE)]
        states = self._states[plan.name] = StateReader()
        environment = {**environment, node_state.VARIABLE: str(states.writer)}
        _keep(self.log(plan.name))
        with self.log(plan.name).open('wb') as log:
            # A session of its own: Ctrl-C reaches the caller only, which stops the nodes in order.
            # Signals wait until the node handles them: Python prints a traceback while it starts.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
            try:
                return psutil.Popen(dies_with_parent(command), env=environment,
                                    stdin=subprocess.DEVNULL, stdout=log,
                                    stderr=subprocess.STDOUT, start_new_session=True,
                                    pass_fds=(states.writer,))
            finally:
                states.started()
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def logs(self) -> dict[str, Path]:
        """Return node → log file."""
        return {name: self.log(name) for name in self._processes}

    def log(self, name: str) -> Path:
        """Return the log file of a node."""
        return self._folder / LOG_FOLDER / f'{name}.log'

    def has_finished(self) -> bool:
        """Return whether physics has finished; raise GraphError if a node has ended otherwise."""
        for name, process in self._processes.items():
            if name not in self._noted and process.poll() is not None:
                step = self._note(name, self._describe_end(name))
                if step.failure:
                    # It waited for a topic whose publisher is still starting.
                    lacks = self._awaited(name) == node_state.PUBLISHERS
                    late = self.unstarted() if lacks else ''
                    raise GraphError(step.failure + (f'; not started yet: {late}' if late else ''))
        return 'physics_node' in self._noted

    def _note(self, name: str, described: str) -> Step:
        """Return what follows from the end of a node; mark the bag if that is due."""
        self._noted.add(name)
        done = self._processes[name].returncode in DONE and not self._fatal_reason(name)
        step = self._ending.after(name, described, done)
        if step.lost:
            self.lost.setdefault(name, step.lost)
        if step.mark:
            mark_failed(self._folder / BAG_FOLDER, step.mark)
        return step

    def suspended(self) -> list[str]:
        """Return the nodes that are suspended (SIGSTOP)."""
        return [name for name, process in self._processes.items() if _is_suspended(process)]

    def at_work(self) -> bool:
        """Return whether any of them works at this moment, or would if it had a core."""
        return any(is_at_work(process.pid) for process in self._processes.values())

    def unstarted(self) -> str:
        """Return which nodes that the run needs have not said that they are ready; '' if none."""
        return ', '.join(f'{name} (log: {self.log(name)})' for name in self._loading())

    def loading_cpu_s(self) -> float:
        """Return the processor time of those nodes, as last measured [s]."""
        return sum(self.cpu_s.get(name, 0.0) for name in self._loading())

    def _loading(self) -> list[str]:
        return [name for name in self._processes if name not in self._may_fail
                and not any(s.state == node_state.READY for s in self._told(name))]

    def waits_for(self, now_ns: int) -> str:
        """Return what time stands still for at a simulated time [ns], for people; '': nothing."""
        loading = self._loading()
        if compiling := self.compiling():
            return f'{WORDS}: {brief_list(compiling)}'
        if loading and not now_ns:
            return f'loading {brief_list(loading)}'
        return self.silent_participant(now_ns).partition(';')[0]    # then follows who waits

    def compiling(self) -> list[str]:
        """Return which nodes compile at this moment."""
        return [name for name in self._states if self._compiles(name)]

    def silent_participant(self, now_ns: int) -> str:
        """Return what a node says that waits for others at a simulated time; '' if none does.

        The gait controller comes first: physics misses its answer in consequence.
        """
        for name in (*LEG_CONTROLLERS, 'physics_node'):
            for state in self._told(name):
                if state.awaits and state.at_ns == now_ns:
                    return state.text
        return ''

    def way_m(self) -> tuple[float, float] | None:
        """Return how far the navigator has driven and how far it is to its goal; None: unknown."""
        states = self._states.get('navigator_node')
        if states is None:
            return None
        states.read()
        return None if states.way is None else (states.way.driven_m, states.way.left_m)

    def measure(self) -> None:
        """Update `cpu_s`."""
        for name, process in self._processes.items():
            with suppress(psutil.Error):    # it has ended; the last value stands
                times = process.cpu_times()
                self.cpu_s[name] = times.user + times.system

    def fatal_error(self) -> str | None:
        """Return why the first node that has failed ends, with its log; None if none has."""
        for name in self._processes:
            reason = self._fatal_reason(name)
            if reason:
                return f'{name}: {reason} (log: {self.log(name)})'
        return None

    def stop(self, failed: bool = False, why: str = '') -> None:
        """Stop all nodes, in the order of `Ending`.

        Args:
            failed: The run is given up; only the recorder is given time to finish.
            why: The failure that the bag is marked with; '' if nothing is wrong with the run.

        Raises:
            GraphError: If a node does not stop in time or ends with an error, unless the run goes
                on without it.
        """
        deadline = time.monotonic() + _STOP_AFTER_FAILURE_S
        problems: list[str] = []
        waiting: list[str] = []
        step = self._ending.begin(why, at_once=failed)
        while waiting or step.stop:
            for name in step.stop:
                if self._processes[name].poll() is None:
                    self._processes[name].send_signal(signal.SIGINT)
                    # A suspended process receives it once it goes on, and finishes what it has.
                    self._processes[name].send_signal(signal.SIGCONT)
            waiting += step.stop
            name = waiting.pop(0)
            hurried = failed and name != RECORDER
            step = self._end(name, max(0.0, deadline - time.monotonic()) if hurried else _STOP_S)
            problems += [step.failure] if step.failure else []
        if problems:
            raise GraphError('; '.join(problems))

    def _end(self, name: str, limit_s: float) -> Step:
        """Wait for the end of a node that was told to stop, or kill it; return what follows."""
        process, start_s = self._processes[name], time.monotonic()
        if _has_ended(process, limit_s, lambda: self._compiles(name)):
            return self._note(name, self._describe_end(name))
        process.kill()
        process.wait()
        return self._note(name, f'{name} did not stop within {time.monotonic() - start_s:.0f} s '
                          'and was killed')

    def _compiles(self, name: str) -> bool:
        self._told(name)
        return name in self._states and self._states[name].compiles

    def kill(self) -> None:
        """Kill what is left."""
        for process in self._processes.values():
            if process.poll() is None:
                process.kill()
        for process in self._processes.values():
            process.wait()
        for states in self._states.values():
            states.close()
        self._states.clear()

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        try:
            self.stop(error is not None, str(error) if isinstance(error, GraphError) else '')
        except GraphError:
            # The first error is the cause of the others.
            if error is None:
                raise
        finally:
            self.kill()

    def _describe_end(self, name: str) -> str:
        """Return how a node ended, with the reason that it gave, and its log."""
        status = self._processes[name].returncode
        how = f'status {status}' if status >= 0 else signal_name(-status)
        # A process that crashes has said nothing: its last words, but for what it logged of its
        # work.
        lines = [line.strip() for line in self.log(name).read_text(errors='replace').splitlines()
                 if line.strip() and not line.startswith('[INFO]')]
        reason = self._fatal_reason(name) or (lines[-1] if lines else '')
        if not reason and name == RECORDER:
            # A full disk has no room for its log, but the mark of the bag has reserved some.
            reason = why_incomplete(self._folder / BAG_FOLDER) or ''
        if self._awaited(name):
            return f'{reason} (log: {self.log(name)})'      # the fault is not its own
        return f'{name} ended with {how}: {reason or "it gave no reason"} (log: {self.log(name)})'

    def _awaited(self, name: str) -> str:
        """Return what a node has waited for in vain, and so ends; '' if it ends otherwise."""
        reason = self._fatal_reason(name)
        return next((s.awaits for s in self._told(name)
                     if s.awaits and reason.startswith(s.text)), '')

    def _fatal_reason(self, name: str) -> str:
        """Return the reason that a node gave for its end; '' if it gave none."""
        return next((s.text for s in self._told(name) if s.state == node_state.FATAL), '')

    def _told(self, name: str) -> list[NodeState]:
        """Return what a node has told of its state; nothing of one that is not in the run."""
        return self._states[name].read() if name in self._states else []


def brief_list(names: Sequence[str]) -> str:
    """Return names for one line: the first three, and how many more there are."""
    more = len(names) - 3
    return ', '.join(names[:3]) + (f' and {more} more' if more > 0 else '')


def _has_ended(process: psutil.Popen, limit_s: float, compiles: Callable[[], bool]) -> bool:
    """Wait until a process has ended; return False if it does not in time.

    Args:
        limit_s: Its time [s]; if that is _STOP_S or more, a process at work has _STOP_AT_WORK_S,
            and one that compiles has all of it anew when it has compiled.
    """
    start_s, looks = time.monotonic(), Looks()
    while process.poll() is None:
        looks.add(is_at_work(process.pid))
        if limit_s >= _STOP_S and compiles():
            start_s = time.monotonic()
        waited_s = time.monotonic() - start_s
        patient = limit_s >= _STOP_S and not looks.idle
        if waited_s >= (_STOP_AT_WORK_S if patient else limit_s):
            return False
        time.sleep(_POLL_S)
    return True


def _keep(log: Path) -> None:
    """Let a log of an earlier process, before a run went on, be NODE.1.log, NODE.2.log ...."""
    if log.exists():
        number = len(list(log.parent.glob(f'{log.stem}.*.log'))) + 1
        log.rename(log.with_name(f'{log.stem}.{number}.log'))


def _is_suspended(process: psutil.Popen) -> bool:
    try:
        return bool(process.status() == psutil.STATUS_STOPPED)
    except psutil.Error:
        return False


_WORKING = frozenset('RD')      # R: runs or waits for a core; D: waits for a disk


class Looks:
    """Share of samples in which a process was active. Idle processes wake up briefly, too."""

    def __init__(self) -> None:
        self._count = self._working = 0

    def add(self, working: bool) -> None:
        """Note one look."""
        self._count += 1
        self._working += working

    @property
    def idle(self) -> bool:
        """Whether less than half of the looks saw work."""
        return 2 * self._working < self._count


def is_at_work(pid: int) -> bool:
    """Return whether any thread of a process runs, would if it had a core, or waits for a disk.

    A process that does not exist any more is not at work. The load of the machine changes how
    much time a process gets, but not the answer.
    """
    try:
        return any(_state(task / 'stat') in _WORKING
                   for task in Path(f'/proc/{pid}/task').iterdir())
    except OSError:
        return False


def _state(file: Path) -> str:
    """Return the state letter: it follows the last parenthesis, as the name may hold others."""
    try:
        return file.read_text(encoding='utf-8', errors='replace').rpartition(') ')[2][:1]
    except OSError:     # the thread has ended
        return ''


_LINE = re.compile(rb'\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]*)\]: (.*)')
_NUMBER = re.compile(r'-?(\d[\d.e+-]*|\b(nan|inf)\b)')
_COUNTED = re.compile(r'\(\d+ so far\)')
# A node that floods its log does not hold up the run.
_MOST_BYTES = 1 << 16


@dataclasses.dataclass(frozen=True)
class NodeWarning:
    """One line of level WARN or worse in the log of a node."""

    node: str
    level: str
    text: str

    def __str__(self) -> str:
        return f'{self.node}: {self.level}: {self.text}'


class NodeLogs:
    """Reads the logs of nodes as they grow.

    Args:
        path_by_node: Node → its log, which need not exist yet.
    """

    def __init__(self, path_by_node: Mapping[str, Path]) -> None:
        self._paths = dict(path_by_node)
        self._offsets = dict.fromkeys(self._paths, 0)
        self._warnings: list[NodeWarning] = []

    def new_warnings(self) -> list[NodeWarning]:
        """Return the warnings and errors that were written since the last call."""
        new = [warning for node in self._paths for warning in self._read(node)]
        self._warnings += new
        return new

    def summary(self) -> list[str]:
        """Return one line per kind of warning so far; texts may differ in numbers.

        Of a warning that counts itself, `(N so far)`, the last line tells all.
        """
        kinds: dict[tuple[str, str], list[NodeWarning]] = {}
        for warning in self._warnings:
            key = warning.node, _NUMBER.sub('#', warning.text)
            kinds.setdefault(key, []).append(warning)
        return [f'{same[-1]}' + (f' ({len(same)} times; the last one is shown)'
                                 if len(same) > 1 and not _COUNTED.search(same[-1].text) else '')
                for same in kinds.values()]

    def _read(self, node: str) -> list[NodeWarning]:
        path, offset = self._paths[node], self._offsets[node]
        if not path.exists() or path.stat().st_size <= offset:
            return []
        with path.open('rb') as file:
            file.seek(offset)
            chunk = file.read(_MOST_BYTES)
        # The rest of a line that is being written is read by the next call.
        whole = chunk[:chunk.rfind(b'\n') + 1]
        self._offsets[node] += len(whole) if whole or len(chunk) < _MOST_BYTES else len(chunk)
        return [NodeWarning(node, match[1].decode(), match[3].decode(errors='replace'))
                for match in map(_LINE.match, whole.splitlines()) if match]
