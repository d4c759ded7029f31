"""`lunar_rover_sim run`: the whole graph, recorded."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
import dataclasses
import signal
import time

from lunar_rover_sim.autonomy.path_following.config import SHAPES
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import config_path
from lunar_rover_sim.base.parameters import replaced
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.products.inspection.summary import summarise
from lunar_rover_sim.run.companion_config import VIEW_PORT
from lunar_rover_sim.run.live_view import ViewProcess
from lunar_rover_sim.run.plan import (navigated_duration_s, with_navigator, with_policy,
                                      with_route, with_slam, without_node)
from lunar_rover_sim.run.recording import record, Recording
from lunar_rover_sim.run.ros_domain import require_ros
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.shared_config import REAL_TIME


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = 'Simulate a scenario with all its nodes and record it to rosbag2.'
    options.add_scenario(parser)
    options.add_new_folder(parser, 'folder for bag, resolved scenario and logs')
    parser.add_argument('--duration', type=float, metavar='S', help='simulated time [s]')
    options.add_seed(parser)
    options.add_fast(parser)
    parser.add_argument('--real-time', action='store_true',
                        help='follow the wall clock instead of waiting for answers')
    options.add_world(parser)
    parser.add_argument('--domain', type=int, metavar='N',
                        help='ROS_DOMAIN_ID to use; by default a free one of this machine')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--goal', type=options.place, metavar='X,Y', help='drive there [m], by '
                       'what the cameras see: mapping_node and navigator_node take the place of '
                       'drive_node; the run ends when the rover has arrived or given up')
    where.add_argument('--route', choices=[shape for shape in SHAPES if shape != 'none'],
                       help='drive a ready-made route of the size drive_node.shape_size_m')
    parser.add_argument('--avoid', action='store_true', help='with --route: around obstacles, by '
                        'what the cameras see, from one waypoint of it to the next')
    parser.add_argument('--slam', metavar='COMMAND', default='',
                        help='SLAM program to feed, with its arguments; it speaks the protocol of '
                             'docs/reference/slam_protocol.md')
    parser.add_argument('--view', type=int, nargs='?', const=VIEW_PORT, metavar='PORT',
                        help='show the run in a browser while it goes on, at this port of this '
                        f'machine (default: {VIEW_PORT}); Foxglove and Lichtblick may connect to '
                        'it too')
    options.add_allowed_origins(parser)
    parser.add_argument('--teleop', action='store_true',
                        help='drive it yourself, in real time: without drive_node, cmd_vel comes '
                        'from the page of --view or from a node of yours')
    parser.add_argument('--policy', metavar='NAME_OR_PATH', default='',
                        help='walk by a packaged policy or a policy file, in the place of the '
                        'gait controller')
    options.add_overrides(parser)


def run(args: argparse.Namespace) -> int:
    """Simulate and record; print a summary."""
    require_ros()
    view = None if args.view is None else ViewProcess(args.view, args.allow_origin)
    overrides = options.with_fast(args)
    if args.real_time or args.teleop:
        overrides.append(f'time_mode={REAL_TIME}')
    scenario = Scenario.load(args.scenario, overrides, seed=args.seed, duration_s=args.duration,
                             world=args.world)
    if args.teleop:
        scenario = without_node(scenario, 'drive_node')
    if args.policy:
        scenario = with_policy(scenario, args.policy)
    if args.avoid and args.route is None:
        raise ConfigError('--avoid: needs --route; a --goal is always driven to around obstacles')
    if args.goal is not None:
        scenario = with_navigator(scenario, [args.goal])
    elif args.route is not None:
        scenario = with_route(scenario, args.route, args.avoid)
    if 'navigator_node' in scenario.run.nodes and args.duration is None \
            and (args.goal is not None or args.avoid):
        scenario = replaced(scenario, {'run.duration_s': navigated_duration_s(scenario)})
    if args.slam:
        scenario = with_slam(scenario, args.slam)
    if args.world is None:
        with Progress('building the world'):
            scenario.world_folder()

    def start(resolved: Scenario, domain: int) -> None:
        if view is not None:
            view.start(domain, (args.world or scenario.world_folder()).resolve())
            say(f'live view: {view.access.url}')
            say(f'in Foxglove or Lichtblick: {view.access.websocket_url}')
            say(f'their layout: {config_path("foxglove/lunar_rover.json")}')
        display.start(resolved, domain)

    def update(now_ns: int) -> None:
        display.update(now_ns)
        if view is not None and (lost := view.early_end()):
            say(lost)

    with _stop_request() as stop_request, Progress('starting') as progress:
        display = _Display(progress)
        try:
            recording = record(scenario, args.output, world=args.world, domain=args.domain,
                               should_stop=stop_request.is_made, on_start=start,
                               on_progress=update, on_warning=say)
        finally:
            if view is not None:
                view.stop()
    if recording.interrupted:
        say('stopped; the bag ends here')
    _print_summary(recording)
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

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._first: tuple[float, float] | None = None     # wall time, simulated time [s]
        self._frame_ns: int | None = None
        self._duration_s = 0.0

    def start(self, scenario: Scenario, domain: int) -> None:
        """Name the run."""
        say(f'{scenario.name}, seed {scenario.shared.seed}: {scenario.run.duration_s:g} s, '
            f'ROS_DOMAIN_ID={domain}')
        self._duration_s = scenario.run.duration_s
        if scenario.render_node.lockstep:   # in real time, frames may be left out
            self._frame_ns = scenario.render_node.frame_period_ns

    def update(self, now_ns: int) -> None:
        """Show the simulated time [ns]."""
        if not now_ns:
            return
        now_s, wall_s, note = now_ns / 1e9, time.monotonic(), ''
        if self._first is None:
            self._first = wall_s, now_s
            self._progress.start('simulating', self._duration_s, 's')
        elif wall_s > self._first[0]:
            note = f'RTF {(now_s - self._first[1]) / (wall_s - self._first[0]):.2f}'
            if self._frame_ns is not None:
                note += f', {now_ns // self._frame_ns} frames'
        self._progress(now_s, note=note)


def _print_summary(recording: Recording) -> None:
    if recording.warnings:
        say('warnings:')
        for text in recording.warnings:
            say(f'  {text}')
    shares = ', '.join(f'{name} {100 * used_s / recording.wall_s:.0f} %'
                       for name, used_s in recording.cpu_s.items())
    say(f'processor time over the whole run, in percent of one core: {shares}')
    if recording.bag is None:
        return
    with Progress('summing up the bag'):
        summary = summarise(recording.bag)
    say(summary.lines(recording.wall_s))
    say(f'bag: {recording.bag}')
