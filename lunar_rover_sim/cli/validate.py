"""`lunar_rover_sim validate`: parts of the simulator against their theory or the truth.

Policies, which need other extras, are in `validate_learning` and `validate_policy`.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import click
import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_file, make_new_folder
from lunar_rover_sim.base.files.yaml_text import parse_yaml
from lunar_rover_sim.base.gravity import EARTH_MPS2, MOON_MPS2
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_markdown, print_table, Progress, say
from lunar_rover_sim.judge.studies import imu as allan
from lunar_rover_sim.judge.studies import locomotion as pitch
from lunar_rover_sim.judge.studies import navigation as driving
from lunar_rover_sim.judge.studies import odometry as rolling
from lunar_rover_sim.judge.studies import stereo as matching
from lunar_rover_sim.judge.studies import terramechanics as walks
from lunar_rover_sim.judge.studies.gait_measurement import (COMMANDS, CommandTracking,
                                                            measure_commands)
from lunar_rover_sim.judge.studies.study_folder import map_in_processes
from lunar_rover_sim.judge.studies.walking import on_ground
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.sensors.imu import ImuConfig


@options.command()
@click.option('--preset', default='adis16448', metavar='NAME',
              help='part to simulate (adis16448, bmi160)')
@options.overrides('NAME=VALUE', help='parameter of the IMU, as physics_node has it under imu')
@options.bounded('--hours', 0.05, 24.0, unit='h', default=1.0, help='length of the record')
@options.bounded('--rate', 1.0, 2000.0, unit='Hz', default=200.0, metavar='HZ',
                 help='sampling rate')
@options.seed(1, 'seed of the noise')
@options.output(check_file, 'FILE', 'plot to write', 'imu_allan.png')
def imu(preset: str, overrides: list[str], hours: float, rate: float, seed: int,
        output: Path) -> int:
    """Compare the Allan deviation of an IMU at rest with its configured noise.

    Reads white noise and bias random walk back. Exits with 1 if a density is out of tolerance.
    """
    values: dict[str, Any] = {'preset': preset}
    for item in overrides:
        name, equals, value = item.partition('=')
        if not equals:
            raise ConfigError(f'--set: {item!r} is not valid; valid is NAME=VALUE')
        values[name] = parse_yaml(value, f'--set {name}')
    config = ImuConfig.from_mapping(values, 'imu')
    allan.plot_format(output)   # an error is reported now, not after the study
    sensors = allan.study(config, hours * 3600.0, rate, seed)
    comparisons = allan.compare(sensors)
    print_table(('sensor', 'noise', 'configured', 'read back', 'error', 'bound', ''), 7, (
        (c.sensor, c.noise, f'{c.configured:.4g}', f'{c.measured:.4g}', f'{100 * c.error:+.1f} %',
         f'{100 * c.bound:.0f} %', 'ok' if c.passed else 'OUT') for c in comparisons),
        title=f'{hours:g} h at {rate:g} Hz, preset {config.preset}')
    allan.plot(sensors, output)
    say('white noise in m/s²/√Hz and rad/s/√Hz, bias random walk in m/s³/√Hz and rad/s²/√Hz')
    say(f'plot: {output}')
    return 0 if all(c.passed for c in comparisons) else 1


@options.command(scenarios=True)
@options.scenario(many=True)
@click.option('-n', '--frames', type=options.number('--frames', 1, kind=int), default=12,
              metavar='N', help='pairs per scenario')
@options.new_folder('folder for table and figures')
@options.seed()
@options.overrides()
def stereo(scenarios: Sequence[str], frames: int, output: Path, seed: int | None,
           overrides: list[str]) -> int:
    """Compare semi-global matching with true depth.

    Along a loop through each scenario: a table of density and errors, and figures.
    """
    loaded = [Scenario.load(name, overrides, seed=seed) for name in scenarios]
    make_new_folder(output)
    results: dict[str, dict[str, float]] = {}
    for scenario in loaded:
        with Progress(scenario.name) as progress:
            errors = matching.study(scenario, frames, output, progress)
        results[scenario.name] = errors.summary()
    print_table(('', *results), 1, (
        (row, *(_formatted(row, of[row]) for of in results.values()))
        for row in next(iter(results.values()))), title='SGM against true depth')
    atomic_write(output / 'stereo.json', json.dumps(results, indent=1) + '\n', ConfigError)
    say(f'written to {output}')
    return 0


def _formatted(row: str, value: float) -> str:
    """Return a figure as the table shows it: shares in per cent, errors in px, some signed."""
    if not row.endswith('[px]'):
        return f'{100 * value:.1f} %'
    return f'{value:+.3f}' if 'signed' in row else f'{value:.3f}'


def _load(name: str, overrides: list[str], grounds: Sequence[str]) -> Scenario:
    """Return a scenario; raise ConfigError where its gait or a ground is not valid."""
    loaded = Scenario.load(name, overrides)
    loaded.gait_controller_node.for_rover(loaded.rover)
    for ground in grounds:
        on_ground(loaded, ground)
    return loaded


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.new_folder('folder to write to', 'locomotion')
@options.several('--speeds', type=options.number('--speeds', 0.0, above=True),
                 default=(0.06, 0.12, 0.2), metavar='V...', help='forward speeds [m/s]')
@options.several('--gravities', type=options.number('--gravities', 0.0, above=True),
                 default=(MOON_MPS2, EARTH_MPS2), metavar='G...', help='gravities [m/s²]')
@options.bounded('--duration', pitch.STEADY_FROM_S + 2.0, unit='s', above=True, default=30.0,
                 metavar='S', help='length of each walk')
@click.option('--no-commands', is_flag=True, help='leave out the grid of velocity commands')
@options.several('--grounds', default=('rigid', 'highland', 'highland_loose'), none=True,
                 metavar='NAME...', help='grounds to compare with the first one, by straight '
                 'walks over the relief of regolith: rigid, or presets; none to leave them out')
@options.bounded('--seeds', 1, kind=int, default=8, help='number of such worlds')
@options.workers('processes that share the grid of commands', None)
def locomotion(scenario: str, overrides: list[str], output: Path, speeds: Sequence[float],
               gravities: Sequence[float], duration: float, no_commands: bool,
               grounds: Sequence[str], seeds: int, workers: int) -> int:
    """Measure the pitch of the walk, and how well commands are followed.

    Against a velocity interface, and on several grounds. Writes reports, CSV and figures. Exits
    with 1 if a command was not followed.
    """
    loaded, speeds = _load(scenario, overrides, grounds), sorted(set(speeds))
    loaded.gait_controller()    # raises ConfigError for a calibration that cannot be read
    make_new_folder(output)
    tracking: list[CommandTracking] = []
    compared: walks.Walks = {}
    with Progress('walking') as progress:
        cases = pitch.study(loaded, speeds, sorted(set(gravities)), duration, progress)
        if not no_commands:
            progress.start('following commands')
            tracking = measure_commands(loaded, COMMANDS, workers=workers, progress=progress)
        if grounds:
            progress.start('walking on soft ground')
            compared = walks.walk_study(loaded, grounds, speeds, range(1, seeds + 1),
                                        workers=workers, progress=progress)
    text = pitch.write_all(cases, tracking, output)
    if compared:
        text += '\n' + walks.write_walks(compared, output)
    print_markdown(text)
    say(f'written: {output}')
    return 0 if all(each.followed for each in tracking) else 1


@options.command(scenarios=True)
@options.scenario('flat')
@options.overrides()
@options.several('--grounds', default=walks.GROUNDS, metavar='NAME...',
                 help='grounds to walk on: rigid, or presets of soil')
@options.bounded('--speed', 0.0, unit='m/s', above=True, default=walks.SPEED_MPS, metavar='V',
                 help='commanded speed')
@options.bounded('--duration', walks.SKIP_S, unit='s', above=True, default=walks.DURATION_S,
                 metavar='S', help='length of each walk')
@options.workers('processes that share the walks', None)
@options.new_folder('folder to write to', 'terramechanics')
def terramechanics(scenario: str, overrides: list[str], grounds: Sequence[str], speed: float,
                   duration: float, workers: int, output: Path) -> int:
    """Walk on several grounds.

    On the level, up slopes of 0 to 30 degrees, and against a pull. Writes terramechanics.md,
    terramechanics.csv and terramechanics.png.
    """
    loaded = _load(scenario, overrides, grounds)
    make_new_folder(output)
    with Progress('walking') as progress:
        walked = map_in_processes(
            functools.partial(walks.measure, loaded, speed_mps=speed, duration_s=duration),
            walks.cases(grounds), workers, progress)
    print_markdown(walks.write_all(walked, output))
    say(f'written: {output}')
    return 0


_AXES = ('along the first heading [m]', 'across it [m]', 'yaw [rad]')


@options.command(scenarios=True)
@options.scenario('baseline')
@click.option('-n', '--drives', default=24, metavar='N',
              type=options.number('--drives', rolling.LEAST_DRIVES, kind=int),
              help='drives, one per seed')
@options.bounded('--duration', rolling.COMMAND_S, 600.0, unit='s', default=20.0, metavar='S',
                 help='length of each')
@options.seed(1, 'first seed')
@options.overrides()
@options.workers('processes that share the drives')
def odometry(scenario: str, drives: int, duration: float, seed: int, overrides: list[str],
             workers: int) -> int:
    """Compare the wheel odometry with the truth.

    Prints errors, consistency and the parameters that fit, over random drives. Exits with 1 if the
    covariance is not that stated.
    """
    loaded = Scenario.load(scenario, overrides, seed=seed)
    seeds = range(seed, seed + drives)
    with Progress('driving') as progress:
        result = rolling.study(loaded, seeds, duration, workers, progress)
    print_table(('error at the end of a drive', 'mean', 'root mean square'), 3, (
        (name, f'{errors.mean():+.3f}', f'{np.sqrt(np.mean(errors**2)):.3f}')
        for name, errors in zip(_AXES, result.errors.T)),
        title=f'{result.drives} drives of {duration:g} s on {loaded.name}, '
        f'legs rolled {result.rolled_m:.1f} m')
    if result.tipped_over:
        say('left out, since the rover tipped over: seed '
            f'{", ".join(str(seed) for seed in result.tipped_over)}')
    low, high = result.interval
    say(f'squared error over stated covariance: {result.consistency:.2f}; '
        f'{low:.2f} to {high:.2f} if it is right')
    say('what fits these drives:')
    for name, value in dataclasses.asdict(result.measured).items():
        say(f'  physics_node.wheel_odometry.{name}={value:.3f}')
    return 0 if result.consistent else 1


@options.command()
@options.scenario('baseline', many=True)
@options.overrides()
@options.bounded('--seeds', 1, kind=int, default=30, help='number of worlds')
@options.bounded('--first-seed', 0, kind=int, default=1, help='seed of the first world')
@options.bounded('--distance', 1.0, unit='m', default=10.0, metavar='M',
                 help='distance of the goal')
@options.bounded('--limit', 10.0, unit='s', default=400.0, metavar='S',
                 help='simulated time after which a drive ends')
@options.several('--sun', type=options.number('--sun', 0.1, 90.0, 'deg'), default=(6.0,),
                 metavar='ELEVATION...', help='elevations of the sun [deg]')
@options.several('--drivers', type=options.Choice(driving.DRIVERS), default=driving.DRIVERS,
                 metavar='DRIVER...', help=f'who drives: {", ".join(driving.DRIVERS)}')
@options.workers('processes that share the drives', None)
@options.folder('folder to write to', 'navigation')
@options.resume('drives')
def navigation(scenarios: Sequence[str], overrides: list[str], seeds: int, first_seed: int,
               distance: float, limit: float, sun: Sequence[float], drivers: Sequence[str],
               workers: int, output: Path, resume: bool) -> int:
    """Drive to a goal on the world of each seed.

    By what the rover sees, by the true map, and blindly, without ROS. Writes navigation.md,
    navigation.csv and figures.
    """
    scenarios = scenarios or ('baseline',)
    for name in scenarios:      # before the folder is made: what is wrong leaves none
        Scenario.load(name, overrides)
    settings = (f'{distance:g} m, {limit:g} s\n' + '\n'.join(overrides) + '\n')
    store = driving.DriveStore(output, settings, resume)
    todo = driving.cases(scenarios, sun, drivers, range(first_seed, first_seed + seeds))
    with Progress('driving', len(todo)) as progress:
        drives = store.study(
            functools.partial(driving.run_case, distance, limit, tuple(overrides)), todo, workers,
            lambda case, drive, done: progress(
                done, note=f'{case.scenario} {case.seed} {case.driver}: {drive.outcome}'))
    print_markdown(driving.write_all(drives, distance, output))
    say(output)
    return 0
