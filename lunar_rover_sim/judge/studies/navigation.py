"""The navigation study: goals on many worlds, by what the rover sees, by the true map, blindly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import Limits, traversability
from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import markdown_table, save_figure
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.judge.evaluation.statistics import Comparison, either_alone_p, Mean, Share
from lunar_rover_sim.judge.studies.navigation_drives import (BLIND, drive_to, GoalDrive, KNOWN,
                                                             SEEN, start_of, TIPPED)
from lunar_rover_sim.judge.studies.study_folder import map_in_processes, StudyFolder
from lunar_rover_sim.run.scenario import Scenario

_TRIALS = 200           # of a goal, before a world counts as too rough
_MARGIN_M = 3.0
_TILTED_DEG = 45.0
_CONTACTS: dict[str, Callable[[GoalDrive], int]] = {
    'body on rock': lambda d: d.belly_contacts, 'body on ground': lambda d: d.belly_ground,
    'spoke on rock': lambda d: d.spoke_contacts}


class Case(NamedTuple):
    """One drive: scenario, elevation of the sun [deg], who drives, seed."""

    scenario: str
    sun_deg: float
    driver: str
    seed: int

    @property
    def group(self) -> tuple[str, float, str]:
        """All but the seed."""
        return self[:3]


def cases(scenarios: Sequence[str], suns_deg: Sequence[float], drivers: Sequence[str],
          seeds: Sequence[int]) -> list[Case]:
    """Return all drives, seed by seed, so that an interrupted study has whole pairs.

    Several elevations of the sun are for those who see.
    """
    return [Case(scenario, sun, driver, seed) for seed, scenario, sun, driver
            in itertools.product(seeds, scenarios, suns_deg, drivers)
            if driver == SEEN or sun == suns_deg[0]]


def goal_of(scenario: Scenario, world: World, distance_m: float) -> tuple[float, float]:
    """Return the goal on the world of a scenario.

    It is the scenario's own, or in a random direction from the start, where a plan leads.

    Raises:
        StudyError: If the world is too small, or none is found.
    """
    node, (x, y) = scenario.navigator_node, start_of(scenario)
    if node.has_goal:
        return node.goal_x_m, node.goal_y_m
    if distance_m > world.ground.half_extent_m - _MARGIN_M:
        raise StudyError(f'--distance: {distance_m:g} is not valid; valid is <= '
                         f'{world.ground.half_extent_m - _MARGIN_M:g} m on this world')
    limits = Limits.of(scenario.rover, scenario.mapping_node.limits)
    elevation = TrueSurface(world).elevation(
        (x, y), 2.0 * math.ceil(distance_m + _MARGIN_M - 1.0),
        scenario.mapping_node.map.cell_m, samples=1)
    planner = Planner(traversability(elevation, limits), node.plan, limits.radius_m, (x, y))
    rng = np.random.default_rng([scenario.shared.seed, 48])
    for _ in range(_TRIALS):
        angle = rng.uniform(-math.pi, math.pi)
        goal = (round(x + distance_m * math.cos(angle), 2),
                round(y + distance_m * math.sin(angle), 2))
        plan = planner.plan(goal)
        if plan is not None and plan.reaches_goal:
            return goal
    raise StudyError(f'{scenario.name}, seed {scenario.shared.seed}: no goal at {distance_m:g} m '
                     'can be reached')


def run_case(distance_m: float, limit_s: float, overrides: Sequence[str],
             case: Case) -> GoalDrive:
    """Drive one case."""
    scenario = Scenario.load(case.scenario, [
        f'render_node.sun.elevation_deg={case.sun_deg}', *overrides], seed=case.seed)
    world, goal = _world_and_goal(case.scenario, case.seed, distance_m, tuple(overrides))
    return drive_to(scenario, world, goal, case.driver, limit_s)


@functools.lru_cache(maxsize=2)
def _world_and_goal(name: str, seed: int, distance_m: float, overrides: tuple[str, ...]
                    ) -> tuple[World, tuple[float, float]]:
    """Return what the drives of a seed share: drives come seed by seed."""
    scenario = Scenario.load(name, overrides, seed=seed)
    world = scenario.load_world()
    return world, goal_of(scenario, world, distance_m)


class DriveStore(StudyFolder):
    """The finished drives of a study, by case."""

    settings_file = 'settings.txt'

    def load(self, case: Case) -> GoalDrive | None:
        """Return a finished drive, or None; StudyError if its file cannot be read."""
        return self.read(_file_name(case), lambda values: GoalDrive(
            **{**values, 'goal_m': tuple(values['goal_m']),
               'path_m': np.array(values['path_m']).reshape(-1, 2)}))

    def save(self, case: Case, drive: GoalDrive) -> None:
        """Keep a finished drive."""
        self.write(_file_name(case),
                   {**dataclasses.asdict(drive), 'path_m': drive.path_m.round(3).tolist()})


def _file_name(case: Case) -> str:
    return '_'.join(str(part).replace('=', '') for part in case)


def study(todo: Sequence[Case], store: DriveStore, distance_m: float, limit_s: float,
          overrides: Sequence[str], workers: int,
          progress: Callable[[Case, GoalDrive, int], object]) -> dict[Case, GoalDrive]:
    """Drive what is not in the store yet; return all drives."""
    drives = {case: found for case in todo if (found := store.load(case)) is not None}
    left = [case for case in todo if case not in drives]

    def done(drive: GoalDrive, count: int, _total: int) -> None:
        case = left[count - 1]
        store.save(case, drive)
        drives[case] = drive
        progress(case, drive, len(drives))

    map_in_processes(functools.partial(run_case, distance_m, limit_s, tuple(overrides)), left,
                     workers, done)
    return drives


def report_text(drives: dict[Case, GoalDrive], distance_m: float) -> str:
    """Return tables and comparisons as Markdown."""
    groups: dict[tuple[str, float, str], dict[int, GoalDrive]] = {}
    for case, drive in drives.items():
        groups.setdefault(case.group, {})[case.seed] = drive
    rows = []
    for (scenario, sun, driver), by_seed in sorted(groups.items()):
        each = list(by_seed.values())
        arrived = [d for d in each if d.arrived]
        share = Share.of(len(arrived), len(each))
        ends = sorted({d.outcome for d in each if not d.arrived})
        rows.append((
            scenario, '–' if driver != SEEN else f'{sun:g}', driver, str(len(each)),
            f'{100 * share.value:.0f} [{100 * share.low:.0f}, {100 * share.high:.0f}]',
            _mean([d.way_m / d.shortest_m for d in arrived], 2),
            *(_mean([float(count(d)) for d in each], 1) for count in _CONTACTS.values()),
            str(sum(d.belly_high > 0 for d in each)),
            str(sum(d.tilt_max_deg > _TILTED_DEG for d in each)),
            str(sum(d.outcome == TIPPED for d in each)),
            _mean([float(d.backed_off) for d in each], 1),
            _mean([d.time_s for d in arrived], 0),
            _mean([d.energy_j / max(d.way_m, 0.1) for d in each], 1),
            _mean([d.goal_error_m for d in each], 2),
            ', '.join(f'{sum(d.outcome == end for d in each)} {end}' for end in ends) or '–'))
    lines = [f'# Navigation: goals at {distance_m:g} m', '',
             'Arrived: within the tolerance of the goal. Way: over that of the plan on the '
             'true map, of those that arrived. Contacts a drive: of the body with rocks and with '
             'the ground, of the sides of spokes with rocks; high: drives in which the body met a '
             f'rock that rises by more than its clearance; tilted: drives above {_TILTED_DEG:g}°. '
             'Intervals: 95 %.', '',
             *markdown_table(('scenario', 'sun [°]', 'driver', 'n', 'arrived [%]', 'way',
                              *_CONTACTS, 'high', 'tilted', 'tipped', 'backed off', 'time [s]',
                              'energy [J/m]', 'from the goal [m]', 'others'),
                             rows), '']
    comparisons = _comparisons(groups)
    if comparisons:
        lines += ['## Pairs', '', 'Way over the shortest, a drive that does not arrive counting '
                  'as longer than any; signed ranks.', '', *comparisons, '']
    return '\n'.join(lines)


def _comparisons(groups: dict[tuple[str, float, str], dict[int, GoalDrive]]) -> list[str]:
    lines = []
    for group, seen in sorted(groups.items()):
        scenario, sun, driver = group
        if driver != SEEN:
            continue
        others = [(name, of) for (s, _, name), of in sorted(groups.items())
                  if s == scenario and name != SEEN]
        for name, of in others:
            seeds = sorted(set(seen) & set(of))
            if len(seeds) < 3:
                continue
            pair = Comparison.of([_badness(seen[s]) for s in seeds],
                                 [_badness(of[s]) for s in seeds])
            word = 'shown' if pair.sign else 'not shown'
            alone = [sum(a[s].arrived and not b[s].arrived for s in seeds)
                     for a, b in ((seen, of), (of, seen))]
            lines.append(f'- {scenario}, sun {sun:g}°, seen against {name}: '
                         f'{pair.text()}: a difference is {word}; alone arrived {alone[0]} '
                         f'against {alone[1]}, p = {either_alone_p(*alone):.2g}.')
    return lines


def _badness(drive: GoalDrive) -> float:
    """Return the way over the shortest, inf for a drive that has not arrived."""
    return drive.way_m / drive.shortest_m if drive.arrived else math.inf


def _mean(values: Sequence[float], digits: int) -> str:
    known = np.array([v for v in values if math.isfinite(v)])
    if not len(known):
        return '–'
    return Mean.of(known).text(digits) if len(known) > 2 else f'{known.mean():.{digits}f}'


def write_all(drives: dict[Case, GoalDrive], distance_m: float, folder: Path) -> str:
    """Write navigation.md, navigation.csv and navigation.png; return the text of the first."""
    text = report_text(drives, distance_m)
    atomic_write(folder / 'navigation.md', text, StudyError)
    fields = [f.name for f in dataclasses.fields(GoalDrive)
              if f.name not in ('path_m', 'seed', 'driver')]
    table = [','.join((*Case._fields, *fields))]
    for case, drive in drives.items():
        values = [getattr(drive, name) for name in fields]
        table.append(','.join(str(v).replace(',', ';') if not isinstance(v, float)
                              else f'{v:.4f}' for v in (*case, *values)))
    atomic_write(folder / 'navigation.csv', '\n'.join(table) + '\n', StudyError)
    plot_ways(drives, folder / 'navigation.png')
    return text


def plot_ways(drives: dict[Case, GoalDrive], path: Path) -> None:
    """Draw the ways driven."""
    figure = Figure(figsize=(6.0, 5.0), layout='constrained')
    axes = figure.subplots()
    for driver, colour in ((KNOWN, 'tab:green'), (SEEN, 'tab:blue'), (BLIND, 'tab:red')):
        for k, drive in enumerate(d for c, d in drives.items() if c.driver == driver):
            axes.plot(*drive.path_m.T, color=colour, lw=0.8, alpha=0.7,
                      label=driver if k == 0 else None)
            if not drive.arrived and len(drive.path_m):
                axes.plot(*drive.path_m[-1], 'x', color=colour)
    axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', title='x: did not arrive')
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=8)
    save_figure(figure, path, StudyError)
