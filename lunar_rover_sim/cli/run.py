"""`lunar_rover_sim run`: the whole graph, recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import dataclasses
from pathlib import Path
import signal
import time

import click

from lunar_rover_sim.autonomy.path_following.config import SHAPES
from lunar_rover_sim.base.compilation import WORDS
from lunar_rover_sim.base.errors import ConfigError, nearest
from lunar_rover_sim.base.files.paths import config_path
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.base.parameters import replaced
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.products.inspection.summary import summarise
from lunar_rover_sim.run.live_view import ViewProcess
from lunar_rover_sim.run.node_config import VIEW_PORT
from lunar_rover_sim.run.recording import record, Recording, unfinished_run
from lunar_rover_sim.run.ros_domain import require_ros
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_checks import check_places, check_scenario
from lunar_rover_sim.run.scenario_options import (navigated_duration_s, with_navigator,
                                                  with_policy, with_route, with_slam, without_node)
from lunar_rover_sim.run.shared_config import REAL_TIME

_SHAPES = tuple(shape for shape in SHAPES if shape != 'none')
_MOST_BYTES = 1 << 20       # of a file with places


def _route(text: str) -> str | list[tuple[float, float]]:
    """Return the shape that a text names, or the places in a file; raise ConfigError otherwise."""
    if text in _SHAPES:
        return text
    path = Path(text)
    if not path.is_file():
        raise ConfigError(f'--route: {text!r} is neither a shape nor a file; '
                          f'{nearest(text, _SHAPES)}')
    places = []
    try:
        text = read_text(path, _MOST_BYTES).removeprefix('\ufeff')    # spreadsheets begin so
    except ConfigError as error:
        raise ConfigError(f'--route: {error}') from None
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.startswith('#'):
            try:
                places.append(options.place(line))
            except ConfigError as error:
                raise ConfigError(f'--route: {path}, line {number}: {error}') from None
    if not places:
        raise ConfigError(f'--route: {path}: holds no place; valid are lines X,Y [m]')
    return places


def _resume(context: click.Context, _param: click.Parameter, folder: Path | None) -> None:
    """Go on with a run, and end the command: nothing else is valid beside it."""
    if folder is None or context.resilient_parsing:
        return
    others = [word for word in context.meta[options.WORDS]
              if word not in ('--resume', str(folder), f'--resume={folder}')]
    if others:
        raise click.UsageError(f'--resume: {" ".join(others)} is not valid beside it; the run '
                               'goes on as it began')
    chosen = unfinished_run(folder)
    context.exit(_recorded(chosen, folder, None, resume=True))


@options.command(scenarios=True)
@click.option('--resume', type=options.PATH, metavar='DIR', is_eager=True, expose_value=False,
              callback=_resume, help='go on with a run that ended early, at its last checkpoint '
              '(physics_node.checkpoint_period_s); without other options')
@options.scenario()
@options.new_folder('folder for bag, resolved scenario and logs')
@click.option('--duration', type=float, metavar='S', help='simulated time [s]')
@options.seed()
@click.option('--real-time', is_flag=True,
              help='follow the wall clock instead of waiting for answers')
@options.world()
@click.option('--domain', type=int, metavar='N',
              help='ROS_DOMAIN_ID to use; by default a free one of this machine')
@click.option('--join', is_flag=True, help='take part in a graph that runs already: its nodes may '
              'publish tf and tf_static')
@click.option('--goal', type=options.place_of('--goal'), metavar='X,Y',
              help='drive there [m], by what the cameras see: mapping_node and navigator_node '
              'take the place of drive_node')
@click.option('--route', type=_route, metavar='SHAPE | FILE', help='drive a route: '
              f'{", ".join(_SHAPES)}, of drive_node.shape_size_m; or through the places of a '
              'file, a line X,Y [m] each, as to a --goal')
@click.option('--avoid', is_flag=True, help='with --route: around obstacles, by what the cameras '
              'see')
@click.option('--slam', metavar='COMMAND', help='SLAM program to feed, with its arguments '
              '(docs/reference/slam_protocol.md), or graph: the odometry with a memory')
@options.on_maps('--slam graph', unless=' (default: the start)')
@click.option('--view', type=int, is_flag=False, flag_value=VIEW_PORT, metavar='[PORT]',
              help='show the run in a browser while it goes on, at this port of this machine '
              f'(default: {VIEW_PORT}); Foxglove and Lichtblick may connect to it too')
@options.allowed_origins
@click.option('--teleop', is_flag=True, help='drive it yourself, in real time, from the page of '
              '--view or a node that publishes cmd_vel')
@click.option('--policy', metavar='NAME_OR_PATH', help='walk by a policy in the place of the gait '
              'controller')
@click.option('--max-bag-size', type=int, metavar='MB', help='begin another file of the bag at '
              'this size')
@options.overrides(fast=True)
def run(scenario: str, output: Path, duration: float | None, seed: int | None, real_time: bool,
        world: Path | None, domain: int | None, join: bool, goal: tuple[float, float] | None,
        route: str | list[tuple[float, float]] | None, avoid: bool, slam: str | None,
        orbital: Path | None, near: tuple[float, float] | None, doubt: float | None,
        view: int | None, allow_origin: Sequence[str], teleop: bool,
        policy: str | None, max_bag_size: int | None, overrides: list[str]) -> int:
    """Simulate a scenario with all its nodes and record it to rosbag2."""
    options.not_both(goal=goal, route=route, teleop=teleop or None)
    require_ros()
    page = None if view is None else ViewProcess(view, allow_origin)
    if real_time or teleop:
        overrides.append(f'time_mode={REAL_TIME}')
    if max_bag_size is not None:
        overrides.append(f'recorder_node.max_bag_size_mb={max_bag_size}')
    chosen = Scenario.load(scenario, overrides, seed=seed, duration_s=duration, world=world)
    if teleop:
        chosen = without_node(chosen, 'drive_node')
    if policy:
        chosen = with_policy(chosen, policy)
    if avoid and not isinstance(route, str):
        raise ConfigError('--avoid: needs a shape of --route; a --goal and the places of a file '
                          'are always driven to around obstacles')
    if goal is not None:
        chosen = with_navigator(chosen, [goal])
    elif isinstance(route, list):
        chosen = with_navigator(chosen, route)
    elif route is not None:
        chosen = with_route(chosen, route, avoid)
    if world is None:   # else the site is that of the folder
        check_places(chosen)
    if 'navigator_node' in chosen.run.nodes and duration is None \
            and (goal is not None or avoid or isinstance(route, list)):
        chosen = replaced(chosen, {'run.duration_s': navigated_duration_s(chosen)})
    if orbital is not None and slam is None:
        raise ConfigError('--orbital: needs --slam graph')
    doubt_m = options.checked_doubt(orbital, near, doubt)
    if slam is not None:
        chosen = with_slam(chosen, slam, orbital, near, doubt_m)
    check_scenario(chosen)      # also before a world is built
    for line in _of_absent_nodes(overrides, chosen.run.nodes, avoid):
        say(line)
    if world is None:
        with Progress('building the world'):
            chosen.world_folder()
    return _recorded(chosen, output, page, world=world, domain=domain, join=join)


def _of_absent_nodes(overrides: Sequence[str], nodes: Sequence[str], avoid: bool) -> list[str]:
    """Return a line for each setting of a node that does not run; avoid: a route is made of it."""
    names = [(word.partition('=')[0], word.partition('.')[0]) for word in overrides]
    return [f'{name}: has no effect, {node} is not among the nodes of this run'
            for name, node in names if node.endswith('_node') and node not in nodes
            and not (avoid and node == 'drive_node')]


def _recorded(chosen: Scenario, output: Path, page: ViewProcess | None, *,
              world: Path | None = None, domain: int | None = None, join: bool = False,
              resume: bool = False) -> int:
    """Record a run and show how it goes on; return the exit status."""
    def start(resolved: Scenario, domain: int) -> None:
        if page is not None:
            page.start(domain, (world or chosen.world_folder()).resolve())
            say(f'live view: {page.access.url}')
            say(f'in Foxglove or Lichtblick: {page.access.websocket_url}')
            say(f'their layout: {config_path("foxglove/lunar_rover.json")}')
        display.start(resolved, domain)

    def update(now_ns: int) -> None:
        display.update(now_ns)
        if page is not None and (lost := page.early_end()):
            say(lost)

    with _stop_request() as stop_request, Progress('starting') as progress:
        display = _Display(progress)
        try:
            recording = record(chosen, output, world=world, domain=domain, join=join,
                               resume=resume, should_stop=stop_request.is_made, on_start=start,
                               on_progress=update, on_warning=say, on_way=display.way,
                               on_wait=display.wait)
        finally:
            if page is not None:
                page.stop()
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
        self._way: tuple[float, float] | None = None
        self._by_way = False
        self._waits, self._has_compiled = '', False

    def start(self, scenario: Scenario, domain: int) -> None:
        """Name the run."""
        say(f'{scenario.name}, seed {scenario.shared.seed}: {scenario.run.duration_s:g} s, '
            f'ROS_DOMAIN_ID={domain}')
        self._duration_s = scenario.run.duration_s
        if scenario.render_node.lockstep:   # in real time, frames may be left out
            self._frame_ns = scenario.render_node.frame_period_ns

    def way(self, driven_m: float, left_m: float) -> None:
        """Show from now on how far the rover has come [m], and how far it is to the goal."""
        self._way = driven_m, left_m

    def wait(self, text: str) -> None:
        """Show what time stands still for; '' for nothing."""
        self._waits = text
        self._progress.named(text)
        if text.startswith(WORDS) and not self._has_compiled:
            self._has_compiled = True
            say(f'{WORDS}: later runs of this version start without it')

    def update(self, now_ns: int) -> None:
        """Show the simulated time [ns], or the way where that is known."""
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
        if self._waits:
            note += f'{", " if note else ""}{self._waits}'
        if self._way is None:
            self._progress(now_s, note=note)
            return
        driven_m, left_m = self._way
        if not self._by_way:
            self._by_way = True
            self._progress.start('driving', round(driven_m + left_m, 1), 'm')
        # Ways around obstacles make the whole longer.
        self._progress(driven_m, round(driven_m + left_m, 1),
                       f'{now_s:.0f} s{", " if note else ""}{note}')


def _print_summary(recording: Recording) -> None:
    if recording.warnings:
        say('warnings:')
        for text in recording.warnings:
            say(f'  {text}')
    loads = sorted(recording.cpu_s.items(), key=lambda item: -item[1])
    say('load of the processor, 100 % is one core: ' + ', '.join(
        f'{name} {100 * used_s / recording.wall_s:.0f} %' for name, used_s in loads))
    if recording.bag is None:
        return
    with Progress('summing up the bag'):
        summary = summarise(recording.bag)
    say(summary.lines(recording.wall_s))
    say(f'bag: {recording.bag}')
