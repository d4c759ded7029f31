"""`lunar_rover_sim validate traverse`: minutes of waypoints over rough worlds."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from pathlib import Path

from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, Progress, say
from lunar_rover_sim.judge.studies import traverse as report
from lunar_rover_sim.judge.studies.terramechanics import Ground
from lunar_rover_sim.judge.studies.traverse import (Case, Traverse, traverse_case,
                                                    TraverseSettings, TraverseStore)
from lunar_rover_sim.run.scenario import Scenario


@options.command(scenarios=True)
@options.scenario('baseline')
@options.overrides()
@options.bounded('--seeds', 1, kind=int, default=20, help='number of worlds')
@options.bounded('--first-seed', 0, kind=int, default=1, help='seed of the first world')
@options.bounded('--duration', 10.0, unit='s', default=600.0, metavar='S',
                 help='simulated time of each drive')
@options.workers('processes that share the drives', None)
@options.several('--grounds', default=(), metavar='NAME...', help='grounds to compare, the first '
                 'one with the others: rigid, or presets (default: that of the scenario)')
@options.folder('folder to write to', 'traverse')
@options.resume('drives')
def traverse(scenario: str, overrides: list[str], seeds: int, first_seed: int, duration: float,
             workers: int, grounds: Sequence[str], output: Path, resume: bool) -> int:
    """Drive random waypoints over many worlds.

    Around the larger rocks. Writes traverse.md, .csv and .png; with --grounds a comparison. Exits
    with 1 if more than one drive in twenty was lost.
    """
    loaded = Scenario.load(scenario, overrides)
    physics = loaded.physics_node
    settings = TraverseSettings(loaded.rover, physics, loaded.gait_controller_node,
                                loaded.drive_node, duration)
    driven = {name: Ground(name).config(physics.ground) for name in grounds} or {
        physics.ground.name: physics.ground}
    store = TraverseStore(output, f'# {duration:g} s\n{loaded.to_yaml()}', resume)

    numbers = range(first_seed, first_seed + seeds)
    cases = [(name, seed) for name in driven for seed in numbers]
    with Progress('driving', len(cases), 'worlds') as progress:

        def show(case: Case, result: Traverse, count: int) -> None:
            progress(count)
            say(f'{case[0]}, seed {result.seed}: {result.outcome}, {result.distance_m:.1f} m, '
                f'{result.stuck} times stuck, tilted up to {result.tilt_max_deg:.0f} deg')

        done = store.study(functools.partial(traverse_case, loaded.world, settings, driven), cases,
                           workers, show)
    results = {name: [done[name, seed] for seed in numbers] for name in driven}
    if grounds:
        text = report.write_grounds(results, loaded.name, output)
    else:
        text = report.write_all(next(iter(results.values())), loaded.name, output)
    print_markdown(text)
    say(f'written: {output}')
    return 0 if all(map(report.acceptable, results.values())) else 1
