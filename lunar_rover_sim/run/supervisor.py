"""Starts the nodes of a run as processes, watches them, stops them in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import importlib.util
import os
from pathlib import Path
import signal
import time
from types import TracebackType

from lunar_rover_sim.bag.marker import why_incomplete
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.run.node_processes import Launcher
from lunar_rover_sim.run.plan import BAG_FOLDER, LOG_FOLDER, NodePlan, SCENARIO_FILE, STOP_ORDER

_POLL_S = 0.1
# What a node is given to end: the recorder has a bag to finish, and after a failure there is
# nothing that the others could still add to it.
_STOP_S = 15.0
_STOP_AFTER_FAILURE_S = 2.0
# Longer than any lag that a participant may have: behind it, everybody has started.
_STARTED_NS = 1_000_000_000


def require_ros() -> None:
    """Raise GraphError with the remedy where rclpy is not to be had."""
    if importlib.util.find_spec('rclpy') is None:
        raise GraphError('rclpy is missing: source /opt/ros/jazzy/setup.bash, or '
                         "pip install 'lunar_rover_sim[ros]'")


class Graph:
    """The processes of one run; context manager that leaves none behind.

    silence_s, start_s: wall time without progress of the clock after which physics counts as hung,
        in the run and in its first simulated second, where time stands until the slowest node has
        started; None where time may stand still anyway (paused, real time).
    launcher: starts the processes.
    end_ns: simulated time at which physics finishes; then it is given time to leave; 0 for never.
    cpu_s: node → processor time that it has used so far [s].
    """

    def __init__(self, launcher: Launcher, plans: Sequence[NodePlan], folder: Path, domain: int,
                 silence_s: float | None = None, start_s: float | None = None,
                 end_ns: int = 0) -> None:
        self._folder = folder
        self._silence_s = silence_s
        self._start_s = start_s
        self._end_ns = end_ns
        self.cpu_s: dict[str, float] = {}
        (folder / LOG_FOLDER).mkdir(exist_ok=True)
        for plan in plans:
            self._log(plan.name).write_bytes(b'')
        # The monitor of this process joins the same graph.
        environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
        os.environ.pop('ROS_LOCALHOST_ONLY', None)
        os.environ.update(environment)
        launcher.start([(plan.name, self._log(plan.name),
                         plan.ros_arguments(folder / SCENARIO_FILE)) for plan in plans],
                       environment)
        self._launcher, self._processes = launcher, launcher.nodes

    def wait(self, on_progress: Callable[[int], None]) -> None:
        """Return when physics has finished; raise GraphError when a node dies or time stands.

        on_progress: called about ten times a second with the simulated time [ns].
        """
        from lunar_rover_sim.nodes.clock_monitor import ClockMonitor

        with ClockMonitor() as clock:
            last_ns, last_progress, stopped = 0, time.monotonic(), self._stopped()
            while True:
                ended = self._ended()
                if ended:
                    on_progress(clock.now_ns())
                    return
                now_ns = clock.now_ns()
                now_stopped = self._stopped()
                # Whoever is stopped is given the same time as whoever is silent.
                if now_ns != last_ns or now_stopped != stopped:
                    last_ns, last_progress, stopped = now_ns, time.monotonic(), now_stopped
                limit_s = self._limit_s(last_ns, starting=not stopped)
                if limit_s is not None and time.monotonic() - last_progress > limit_s:
                    raise GraphError(self._silence(limit_s, last_ns))
                self._measure()
                on_progress(now_ns)
                time.sleep(_POLL_S)

    def _limit_s(self, last_ns: int, starting: bool) -> float | None:
        """Return how long time may stand: longer while nodes start, unless one is stopped."""
        limit_s = self._start_s if starting and last_ns <= _STARTED_NS else self._silence_s
        if limit_s is not None and 0 < self._end_ns <= last_ns:
            limit_s += _STOP_S
        return limit_s

    def _silence(self, limit_s: float, last_ns: int) -> str:
        """Return whose fault it is that time stands: who said so, is stopped, or else physics."""
        at = f'at {last_ns / 1e9:.3f} s of simulated time'
        for name in self._processes:
            fatal = self._fatal(name)
            if fatal:
                return f'{name}: {fatal} (log: {self._log(name)})'
        for name in self._stopped():
            return f'{name} is stopped (SIGSTOP) {at} (log: {self._log(name)})'
        return (f'physics_node has been silent for {limit_s:g} s {at} '
                f'(log: {self._log("physics_node")})')

    def _stopped(self) -> list[str]:
        return [name for name, process in self._processes.items() if _state(process.pid) == 'T']

    def stop(self, failed: bool = False) -> None:
        """Stop all nodes in order, the recorder last; raise GraphError if one ends badly.

        failed: the run has failed already; nobody but the recorder is given time.
        """
        failures = []
        hurry_until = time.monotonic() + _STOP_AFTER_FAILURE_S
        if failed:
            # Together: there is nothing left that an order could save.
            for name, running in self._processes.items():
                if name != 'recorder_node' and running.poll() is None:
                    running.send_signal(signal.SIGINT)
        for name in STOP_ORDER:
            process = self._processes.get(name)
            if process is None:
                continue
            if process.poll() is None:
                hurry = failed and name != 'recorder_node'
                limit_s = max(0.0, hurry_until - time.monotonic()) if hurry else _STOP_S
                if not hurry:
                    process.send_signal(signal.SIGINT)
                try:
                    # Who is stopped (SIGSTOP) hears nothing.
                    process.wait(0.0 if _state(process.pid) == 'T' else limit_s)
                except TimeoutError:
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                    failures.append(f'{name} did not stop within {limit_s:g} s and was killed')
                    continue
            if process.returncode != 0:
                failures.append(self._obituary(name))
        if failures:
            raise GraphError('; '.join(failures))

    def __enter__(self) -> Graph:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        try:
            self.stop(failed=error is not None)
        except GraphError:
            # What went wrong first is what counts.
            if error is None:
                raise

    def _measure(self) -> None:
        for name, process in self._processes.items():
            fields = _stat(process.pid)
            if fields:
                # utime and stime, the 14th and 15th field of proc(5), the name being the 2nd.
                self.cpu_s[name] = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')

    def _ended(self) -> bool:
        """Return whether physics has finished; raise GraphError for whoever died."""
        for name, process in self._processes.items():
            status = process.poll()
            if status is None:
                continue
            if self._launcher.killed:
                raise GraphError('the launcher of the nodes was killed, and they with it')
            if name == 'physics_node' and status == 0:
                return True
            raise GraphError(self._obituary(name))
        return False

    def _obituary(self, name: str) -> str:
        status = self._processes[name].returncode or 0
        how = f'status {status}' if status >= 0 else signal.Signals(-status).name
        last = [line.strip() for line in self._said(name) if line.strip()]
        reason = self._fatal(name) or (last[-1] if last else '')
        if not reason and name == 'recorder_node':
            # On a full disk there is no room for its words, but that of the mark was kept free.
            reason = why_incomplete(self._folder / BAG_FOLDER) or ''
        reason = reason or 'it said nothing'
        return f'{name} ended with {how}: {reason} (log: {self._log(name)})'

    def _fatal(self, name: str) -> str:
        """Return what a node gave as the reason of its end; '' where it has not."""
        lines = (line for line in self._said(name) if line.startswith('FATAL '))
        return next(lines, '').removeprefix('FATAL ')

    def _said(self, name: str) -> list[str]:
        return self._log(name).read_text(errors='replace').splitlines()

    def _log(self, name: str) -> Path:
        return self._folder / LOG_FOLDER / f'{name}.log'


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name; none where the process has gone."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    except OSError:
        return []


def _state(pid: int) -> str:
    """Return the letter of a process's state: T for stopped."""
    return (_stat(pid) or [''])[0]
