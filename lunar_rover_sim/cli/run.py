"""`lunar_rover_sim run`: the whole graph, recorded."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
import signal
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lunar_rover_sim.run.node_processes import Launcher

# Physics names whoever it waits for before the runner names physics.
_SILENCE_MARGIN_S = 1.0


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
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and record; print a summary."""
    from lunar_rover_sim.run.node_processes import Launcher
    from lunar_rover_sim.run.supervisor import require_ros

    require_ros()
    with Launcher(args.output.resolve()) as launcher:
        return _record(args, launcher)


def _record(args: argparse.Namespace, launcher: Launcher) -> int:
    from rich.console import Console

    from lunar_rover_sim.run.domain import OwnDomain
    from lunar_rover_sim.run.node_config import REAL_TIME
    from lunar_rover_sim.run.plan import BAG_FOLDER, prepare, resolve
    from lunar_rover_sim.run.scenario import load_scenario
    from lunar_rover_sim.run.supervisor import Graph
    from lunar_rover_sim.world.cache import cached
    from lunar_rover_sim.world.world_folder import load

    overrides = list(args.overrides)
    if args.duration is not None:
        overrides.append(f'run.duration_s={args.duration}')
    if args.real_time:
        overrides.append(f'time_mode={REAL_TIME}')
    scenario = load_scenario(args.scenario, overrides, args.seed)
    console = Console()
    if args.world is not None:
        world = args.world.resolve()
        # What is recorded is the recipe of the world that is used.
        scenario = dataclasses.replace(scenario, world=load(world).config)
    else:
        with console.status('building the world'):
            world = cached(scenario.world, scenario.shared.seed)
    scenario = resolve(scenario)
    folder = args.output.resolve()
    plans = prepare(scenario, folder, world)
    silence_s = start_s = None
    if scenario.shared.lockstep:
        silence_s = scenario.physics_node.wait.silence_s + _SILENCE_MARGIN_S
        start_s = scenario.physics_node.wait.start_s + _SILENCE_MARGIN_S

    # SIGTERM stops a run as Ctrl-C does: nodes in order, bag finished.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    interrupted = False
    with OwnDomain(args.domain) as domain:
        console.print(f'{scenario.name}, seed {scenario.shared.seed}: '
                      f'{scenario.run.duration_s:g} s, ROS_DOMAIN_ID={domain.id}')
        start = time.monotonic()
        with Graph(launcher, plans, folder, domain.id, silence_s, start_s,
                   round(scenario.run.duration_s * 1e9)) as graph:
            try:
                _watch(graph, scenario, console)
            except KeyboardInterrupt:
                interrupted = True
                console.print('stopping; the bag will end here')
        wall_s = time.monotonic() - start
    console.print(_shares(graph.cpu_s, wall_s), highlight=False, soft_wrap=True)
    bag = folder / BAG_FOLDER
    if 'recorder_node' in scenario.run.nodes:
        from lunar_rover_sim.inspection.summary import summarise

        with console.status('summing up the bag'):
            summary = summarise(bag)
        console.print(summary.lines(wall_s), highlight=False, soft_wrap=True)
        console.print(f'bag: {bag}', soft_wrap=True, highlight=False)
    return 130 if interrupted else 0


def _shares(cpu_s: dict[str, float], wall_s: float) -> str:
    shares = ', '.join(f'{name} {100 * used / wall_s:.0f} %' for name, used in cpu_s.items())
    return f'processor time, start included, of one core: {shares}'


def _watch(graph, scenario, console) -> None:  # type: ignore[no-untyped-def]
    """Show simulated time, real-time factor and frames until physics has finished."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    frame_s = scenario.render_node.frame_period_ns / 1e9
    columns = (TextColumn('{task.description}'), BarColumn(),
               TextColumn('{task.completed:.1f}/{task.total:g} s'), TextColumn('{task.fields[x]}'),
               TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task('starting', total=scenario.run.duration_s, x='')
        first: list[float] = []

        def show(now_ns: int) -> None:
            now_s = now_ns / 1e9
            if now_ns and not first:
                first.extend((time.monotonic(), now_s))
            factor = ''
            if first and time.monotonic() > first[0]:
                rtf = (now_s - first[1]) / (time.monotonic() - first[0])
                factor = f'RTF {rtf:.2f}, {int(now_s / frame_s + 1e-6)} frames'
            progress.update(task, completed=now_s, x=factor,
                            description='simulating' if now_ns else 'starting')

        graph.wait(show)
