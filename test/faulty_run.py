"""A run in the background into which a program injects a fault, and what must come of it."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

from command_line import unfolded
import psutil

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.products.inspection.check import check

# On a machine that has nothing else to do; multiplied by how much slower this one is now.
LIMIT_S = 10.0
START_S = 120.0
END_S = 120.0
_SILENCE_S, _READY_S = 5.0, 60.0
_PROBE_S = 0.2
# A line every 10 s, beside the one of an error.
_PROGRESS = 'building the world: ', 'starting: ', 'simulating: '
SMALL_WORLD = ('world.size_m=12.8', 'world.surroundings.samples=257')
SETTINGS = ('render_node.camera.width=160', 'render_node.camera.height=120',
            'render_node.sgm.num_disparities=32')
BLIND = ('physics_node', 'gait_controller_node', 'drive_node', 'recorder_node')
ALL = (*BLIND, 'render_node')
# What a recording of more than a simulated second holds: all nodes have started.
RECORDING_BYTES = {False: 800_000, True: 3_000_000}


def slowness() -> float:
    """Return how many times longer work takes now than on an idle machine, at least 1.

    Other work takes processor time, so wall time of a loop over its processor time tells. A run
    that is starved of it is not at fault.
    """
    wall_s, busy_s = time.monotonic(), time.process_time()
    while time.process_time() - busy_s < _PROBE_S:
        pass
    return max(1.0, (time.monotonic() - wall_s) / _PROBE_S)


@dataclasses.dataclass
class Fault:
    """One fault and what came of it: `problems` is empty where it was survived."""

    kind: str
    target: str
    delay_s: float
    nodes: tuple[str, ...] = BLIND
    took_s: float = 0.0
    status: int | None = None
    said: str = ''
    messages: int = 0
    load: float = 0.0
    slowness: float = 1.0
    problems: list[str] = dataclasses.field(default_factory=list)


class Run:
    """One run in the background; context manager that leaves nothing behind."""

    def __init__(self, folder: Path, nodes: tuple[str, ...], world: Path, duration_s: float,
                 *arguments: str) -> None:
        self.folder = folder
        self._enough = RECORDING_BYTES['render_node' in nodes]
        self._slowness = slowness()
        settings = [*SMALL_WORLD, *SETTINGS, f'run.nodes=[{",".join(nodes)}]',
                    f'physics_node.wait.silence_s={_SILENCE_S}',     # longer on a busy machine
                    f'physics_node.wait.start_s={_READY_S}']
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.cli.main', 'run', 'baseline', '-o',
             str(folder), '--duration', str(duration_s), '--world', str(world),
             *(word for s in settings for word in ('--set', s)), *arguments],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def wait_for_recording(self) -> str:
        """Return '' when the bag has grown, or what went wrong."""
        deadline = time.monotonic() + START_S * self._slowness
        while time.monotonic() < deadline:
            if self.process.poll() is not None:
                return f'ended before the fault: {self.finish(1.0)[1]}'
            if self.bag_bytes() > self._enough:
                return ''
            time.sleep(0.05)
        return f'recorded nothing within {START_S * self._slowness:.0f} s'

    def bag_bytes(self) -> int:
        """Return the size of the storage file, 0 before there is one."""
        return sum(f.stat().st_size for f in (self.folder / 'bag').glob('*.mcap'))

    def node(self, name: str) -> int:
        """Return the process id of a node, as soon as it is there."""
        deadline = time.monotonic() + START_S * self._slowness
        while name not in self.pids() and time.monotonic() < deadline:
            time.sleep(0.02)
        return self.pids()[name]

    def pids(self) -> dict[str, int]:
        """Return node → process id of those that run."""
        found = {}
        for process in psutil.process_iter(['cmdline']):
            words = process.info['cmdline'] or []
            if any(str(self.folder.resolve()) in word for word in words):
                found.update({name: process.pid for name in ALL if name in words})
        return found

    def judge_time(self, fault: Fault) -> None:
        """Note a problem where an effect took longer than this machine may need now."""
        fault.slowness = max(self._slowness, slowness())
        if fault.took_s > LIMIT_S * fault.slowness:
            fault.problems.append(f'took {fault.took_s:.1f} s')

    def finish(self, limit_s: float) -> tuple[int | None, str]:
        """Return status (None where it did not end in time) and what it said."""
        try:
            _, said = self.process.communicate(timeout=limit_s * self._slowness)
            return self.process.returncode, '\n'.join(
                line for line in unfolded(said).strip().splitlines()
                if not line.startswith(_PROGRESS))
        except subprocess.TimeoutExpired:
            return None, ''

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for pid in self.pids().values():
            for number in (signal.SIGCONT, signal.SIGKILL):
                try:
                    os.kill(pid, number)
                except ProcessLookupError:
                    pass


def must_end(fault: Fault, run: Run, causes: list[str]) -> None:
    """The run ends in time with one line that names the cause; the bag up to there opens."""
    start = time.monotonic()
    fault.status, fault.said = run.finish(END_S)
    fault.took_s = time.monotonic() - start
    run.judge_time(fault)
    if fault.status in (0, None):
        fault.problems.append(f'status {fault.status}')
    if len(fault.said.splitlines()) != 1:
        fault.problems.append(f'{len(fault.said.splitlines())} lines: {fault.said[-300:]}')
    if not any(cause in fault.said for cause in causes):
        fault.problems.append(f'names none of {causes}: {fault.said[-300:]}')
    left = run.pids()
    if left:
        fault.problems.append(f'still running: {left}')
    opens(fault, run)


def opens(fault: Fault, run: Run, complete: bool = False) -> None:
    """The bag holds odometry; where it was cut off, the bag check says so.

    A bag without an end is recovered into another folder, since its disk may be full.
    """
    path = run.folder / 'bag'
    try:
        with tempfile.TemporaryDirectory() as folder:
            if not (path / marker.METADATA_NAME).exists():
                recover(path, Path(folder) / 'bag')
                path = Path(folder) / 'bag'
            with open_bag(path) as bag:
                fault.messages = sum(1 for _ in bag.raw(['/odom']))
                if bag.incomplete and complete:
                    fault.problems.append(f'the bag says: {bag.incomplete}')
            if not complete and not {f.check for f in check(path).failed} & {
                    'complete', 'duration'}:
                fault.problems.append('the bag check does not find that it was cut off')
    except BagError as error:
        fault.problems.append(f'bag: {error}')
    if not fault.messages:
        fault.problems.append('no odometry in the bag')
