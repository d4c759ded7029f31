"""`lunar_rover_sim run`: the whole graph, recorded."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import dataclasses
from pathlib import Path
import signal
import time

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from lunar_rover_sim.files.outputs import check_new_folder
from lunar_rover_sim.files.resources import config_path
from lunar_rover_sim.inspection.summary import summarise
from lunar_rover_sim.run.companion_config import VIEW_PORT
from lunar_rover_sim.run.live_view import check_view, ViewProcess
from lunar_rover_sim.run.plan import with_slam
from lunar_rover_sim.run.recording import record, Recording
from lunar_rover_sim.run.ros_installation import require_ros
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.shared_config import REAL_TIME


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = 'Simulate a scenario with all its nodes and record it to rosbag2.'
    parser.add_argument('scenario', help='name of a packaged scenario, or a YAML file')
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for bag, resolved scenario and logs; must not exist')
    parser.add_argument('--duration', type=float, metavar='S', help='simulated time [s]')
    parser.add_argument('--seed', type=int, metavar='N', help='seed of everything random')
    parser.add_argument('--real-time', action='store_true',
                        help='follow the wall clock instead of waiting for answers')
    parser.add_argument('--world', type=Path, metavar='DIR',
                        help="a world made by `world build`, instead of the scenario's own")
    parser.add_argument('--domain', type=int, metavar='N',
                        help='ROS_DOMAIN_ID to use; by default a free one of this machine')
    parser.add_argument('--slam', metavar='COMMAND', default='',
                        help='SLAM program to feed, with its arguments; it speaks the protocol of '
                             'docs/reference/slam_protocol.md')
    parser.add_argument('--view', type=int, nargs='?', const=VIEW_PORT, metavar='PORT',
                        help='serve the topics to Foxglove or Lichtblick in a browser while the '
                        f'run goes on, at this port of this machine (default: {VIEW_PORT})')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.set_defaults(run=run, check_output=check_new_folder)


def run(args: argparse.Namespace) -> int:
    """Simulate and record; print a summary."""
    require_ros()
    if args.view is not None:
        check_view(args.view, '--view')
        layout = config_path('foxglove/lunar_rover.json')
    overrides = [*args.overrides]
    if args.real_time:
        overrides.append(f'time_mode={REAL_TIME}')
    scenario = Scenario.load(args.scenario, overrides, seed=args.seed, duration_s=args.duration,
                             world=args.world)
    if args.slam:
        scenario = with_slam(scenario, args.slam)
    console = Console()
    if args.world is None:
        with console.status('building the world'):
            scenario.world_folder()
    view = ViewProcess()

    def start(resolved: Scenario, domain: int) -> None:
        if args.view is not None:
            view.start(domain, args.view)
            console.print(f'live view: open a connection to ws://localhost:{args.view} in '
                          f'Foxglove or Lichtblick; layout {layout}',
                          highlight=False, soft_wrap=True)
        display.start(resolved, domain)

    def progress(now_ns: int) -> None:
        display.update(now_ns)
        if lost := view.early_end():
            display.warn(lost)

    with _stop_request() as stop_request, _Display(console) as display:
        try:
            recording = record(scenario, args.output, world=args.world, domain=args.domain,
                               should_stop=stop_request.is_made, on_start=start,
                               on_progress=progress, on_warning=display.warn)
        finally:
            view.stop()
    if recording.interrupted:
        console.print('stopped; the bag ends here')
    _print_summary(console, recording)
    return 130 if recording.interrupted else 0


@dataclasses.dataclass
class _StopRequest:
    """Whether SIGINT or SIGTERM has asked for the end of the run."""

    made: bool = False

    def is_made(self) -> bool:
        """Return whether the run is to end."""
        return self.made


@contextmanager
def _stop_request() -> Iterator[_StopRequest]:
    """Let the first SIGINT or SIGTERM stop the nodes in order; the second one kills them."""
    request = _StopRequest()

    def handle(_number: int, _frame: object) -> None:
        if request.made:
            raise KeyboardInterrupt
        request.made = True

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Display:
    """Shows simulated time, real-time factor and frames while a run goes on."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn('{task.description}'), BarColumn(),
            TextColumn('{task.completed:.1f}/{task.total:g} s'), TextColumn('{task.fields[pace]}'),
            TimeRemainingColumn(), console=console)
        self._first: tuple[float, float] | None = None     # wall time, simulated time [s]
        self._frame_ns: int | None = None

    def start(self, scenario: Scenario, domain: int) -> None:
        """Name the run and show its progress from now on."""
        self._console.print(f'{scenario.name}, seed {scenario.shared.seed}: '
                            f'{scenario.run.duration_s:g} s, ROS_DOMAIN_ID={domain}')
        if scenario.render_node.lockstep:   # in real time, frames may be left out
            self._frame_ns = scenario.render_node.frame_period_ns
        self._task = self._progress.add_task('starting', total=scenario.run.duration_s, pace='')
        self._progress.start()

    def update(self, now_ns: int) -> None:
        """Show the simulated time [ns]."""
        now_s, wall_s, pace = now_ns / 1e9, time.monotonic(), ''
        if now_ns and self._first is None:
            self._first = wall_s, now_s
        if self._first is not None and wall_s > self._first[0]:
            factor = (now_s - self._first[1]) / (wall_s - self._first[0])
            pace = f'RTF {factor:.2f}'
            if self._frame_ns is not None:
                pace += f', {now_ns // self._frame_ns} frames'
        self._progress.update(self._task, completed=now_s, pace=pace,
                              description='simulating' if now_ns else 'starting')

    def warn(self, text: str) -> None:
        """Show what a node warns of."""
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)

    def __enter__(self) -> _Display:
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _print_summary(console: Console, recording: Recording) -> None:
    if recording.warnings:
        console.print('warnings:', highlight=False)
        for text in recording.warnings:
            console.print(f'  {text}', highlight=False, soft_wrap=True, markup=False)
    shares = ', '.join(f'{name} {100 * used_s / recording.wall_s:.0f} %'
                       for name, used_s in recording.cpu_s.items())
    console.print(f'processor time, start included, of one core: {shares}', highlight=False,
                  soft_wrap=True)
    if recording.bag is None:
        return
    with console.status('summing up the bag'):
        summary = summarise(recording.bag)
    console.print(summary.lines(recording.wall_s), highlight=False, soft_wrap=True)
    console.print(f'bag: {recording.bag}', soft_wrap=True, highlight=False)
