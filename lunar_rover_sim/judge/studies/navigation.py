"""The navigation study: goals on many worlds, by what the rover sees, by the true map, blindly.

A drive to a goal is physics, seen depth, map and navigator in one loop, without ROS. It maps and
drives by the true pose. A command is made from the map that a graph in lockstep has at that time:
maps are `MAP_LAG_S` old.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
import mujoco
import numpy as np

from lunar_rover_sim.autonomy.navigation.command import Failure, Status
from lunar_rover_sim.autonomy.navigation.config import MapConfig, TRUTH
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import (belly_clearance_m, Limits,
                                                                traversability, Traversability)
from lunar_rover_sim.autonomy.path_following.driver import DONE, Driver, STOPPED
from lunar_rover_sim.base.errors import PhysicsError, StudyError
from lunar_rover_sim.base.files.results import csv_table, markdown_table, save_figure
from lunar_rover_sim.base.frames import Array, path_length, tilt_deg
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import OneWindow
from lunar_rover_sim.image.stereo.seen_depth import SeenDepth
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.judge.evaluation.statistics import (adjusted, Comparison, CONFIDENCE,
                                                         either_alone_p, Mean, Share)
from lunar_rover_sim.judge.studies.study_folder import StudyFolder, write_report
from lunar_rover_sim.judge.studies.walking import by_gait, STATE_PERIOD_S, Walker
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState, TipOver
from lunar_rover_sim.run.scenario import Scenario

SEEN, KNOWN, BLIND = 'seen', 'known', 'blind'   # drives by what it sees, by the true map, by none
DRIVERS = (SEEN, KNOWN, BLIND)
ARRIVED = Status.ARRIVED.value
TIME_OVER, TIPPED = 'time over', 'tipped over'

MAP_LAG_S = 0.2
DEPTH_HZ = 3
_COMMAND_PERIODS = 10           # of the controller: 20 Hz
_CLOSE_S = 0.3                  # belly contacts nearer in time than this [s] are one
_KNOWN_MARGIN_M = 6.0           # of the true map around start and goal


@dataclasses.dataclass(frozen=True)
class GoalDrive:
    """One drive to one goal.

    Attributes:
        driver: seen, known or blind.
        outcome: arrived, tipped over, time over, or why it gave up.
        way_m: Driven.
        shortest_m: Of the plan over the true map from the start; NaN where there is none.
        goal_error_m: Distance to the goal at the end.
        belly_contacts: Times that body or mast have met a rock.
        belly_high: Times that they have met one that rises by more than their clearance.
        belly_ground: Times that they have met the ground.
        spoke_contacts: Times that the side of a spoke has met a rock.
        backed_off: Times that it has backed off.
        energy_j: Drawn from the supply.
        tilt_max_deg: Greatest tilt.
        path_m: (n, 2) at 5 Hz, to a millimetre.
    """

    seed: int
    driver: str
    goal_m: tuple[float, float]
    outcome: str
    time_s: float
    way_m: float
    shortest_m: float
    goal_error_m: float
    belly_contacts: int
    belly_high: int
    belly_ground: int
    spoke_contacts: int
    backed_off: int
    energy_j: float
    tilt_max_deg: float
    path_m: Array

    @property
    def arrived(self) -> bool:
        """Whether it is at the goal."""
        return self.outcome == ARRIVED


class Contacts:
    """Counts how often body and spokes meet rocks and ground; tips are not counted: they walk.

    Attributes:
        rocks: Of the body with rocks.
        high: Of the body with rocks that rise over the ground by more than the clearance.
        ground: Of the body with the ground.
        spokes: Of the sides of spokes with rocks.
    """

    def __init__(self, simulation: Simulation, clearance_m: float) -> None:
        self._simulation, self._clearance_m = simulation, clearance_m
        self._find_geoms()
        self._last_s: dict[str, float] = {}
        self.rocks = self.high = self.ground = self.spokes = 0

    def _find_geoms(self) -> None:
        """Find what is body, rock and ground in the model, another one in another window."""
        model = self._model = self._simulation.model
        self._data = self._simulation.data
        base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
        self._is_body = model.geom_bodyid == base
        self._is_rock = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
        self._is_ground = model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD
        self._is_rod = np.array(['_rod_' in model.geom(k).name for k in range(model.ngeom)])

    def add(self, time_s: float) -> None:
        """Look at the present contacts."""
        if self._model is not self._simulation.model:
            self._find_geoms()
        geoms = self._data.contact.geom
        if not len(geoms):
            return
        of_body = geoms[self._is_body[geoms].any(axis=1)]
        rocks = np.unique(of_body[self._is_rock[of_body]])
        met = {'rocks': len(rocks) > 0, 'ground': bool(self._is_ground[of_body].any()),
               'high': any(self.rise_m(int(rock)) > self._clearance_m for rock in rocks),
               'spokes': bool((self._is_rod[geoms].any(axis=1)
                               & self._is_rock[geoms].any(axis=1)).any())}
        for kind in (kind for kind, is_met in met.items() if is_met):
            if time_s - self._last_s.get(kind, -math.inf) > _CLOSE_S:
                setattr(self, kind, getattr(self, kind) + 1)
            self._last_s[kind] = time_s

    def rise_m(self, rock: int) -> float:
        """Return how far the top of a rock, a geom, is above the ground at its middle [m]."""
        mesh = self._model.geom_dataid[rock]
        first = self._model.mesh_vertadr[mesh]
        vertices = self._model.mesh_vert[first:first + self._model.mesh_vertnum[mesh]]
        place = self._data.geom_xpos[rock]
        top = place[2] + float((vertices @ self._data.geom_xmat[rock][6:]).max())
        return top - float(self._simulation.world.ground.height_at(place[None, :2])[0])


def start_of(scenario: Scenario) -> tuple[float, float]:
    """Return where the rover of a scenario starts, x and y [m]."""
    start = scenario.physics_node.start
    return start.x_m, start.y_m


def true_costs(scenario: Scenario, world: World, goal_m: tuple[float, float]) -> Traversability:
    """Return what the rover can cross of the true map around start and goal."""
    start = start_of(scenario)
    size = float(np.abs(np.subtract(goal_m, start)).max()) + 2.0 * _KNOWN_MARGIN_M
    size = min(2.0 * world.ground.half_extent_m, 2.0 * math.ceil(0.5 * size))
    elevation = TrueSurface(world).elevation(0.5 * np.add(start, goal_m), size,
                                             scenario.mapping_node.map.cell_m)
    return traversability(elevation, Limits.of(scenario.rover, scenario.mapping_node.limits))


def drive_to(scenario: Scenario, world: World, goal_m: tuple[float, float], driver: str,
             limit_s: float = 400.0) -> GoalDrive:
    """Drive once, from the start of the scenario to a goal [m].

    Args:
        driver: seen, known or blind: a straight route that avoids nothing.
        limit_s: Simulated time after which the drive ends.
    """
    limits = Limits.of(scenario.rover, scenario.mapping_node.limits)
    nav = dataclasses.replace(scenario.navigator_node, has_goal=True, goal_x_m=goal_m[0],
                              goal_y_m=goal_m[1], waypoints_x_m=(), waypoints_y_m=())
    truth = true_costs(scenario, world, goal_m)
    truth = dataclasses.replace(truth, stamp_ns=round(limit_s * 1e9))   # it never grows old
    shortest = Planner(truth, nav.plan, limits.radius_m, start_of(scenario)).plan(goal_m)
    navigator = Navigator(nav, limits.radius_m, world.ground.half_extent_m)
    straight = Driver(dataclasses.replace(
        scenario.drive_node, mode='waypoints', shape='none', relative=False, laps=1,
        waypoints_x_m=(goal_m[0],), waypoints_y_m=(goal_m[1],),
        goal_tolerance_m=nav.goal_tolerance_m), world.ground.half_extent_m)
    eyes = Eyes(scenario, world) if driver == SEEN else None
    tip, outcome, tilt = TipOver(), TIME_OVER, 0.0
    path: list[Array] = []
    with Simulation(world, scenario.rover, scenario.physics_node, OneWindow(world)) as simulation:
        controller = scenario.gait_controller()
        walker, state = Walker(simulation, by_gait(controller)), simulation.state
        contacts = Contacts(simulation, belly_clearance_m(scenario.rover))
        try:
            for k in range(round(limit_s / STATE_PERIOD_S)):
                if k % _COMMAND_PERIODS == 0:
                    position, quaternion = state.position_m, state.orientation_wxyz
                    if driver == BLIND:
                        told = straight.update(state.stamp_ns, position, quaternion)
                        velocity = told.forward_mps, told.yaw_rate_radps
                        if told.status in (DONE, STOPPED):
                            outcome = ARRIVED if told.cause is None else told.cause.value
                            break
                    else:
                        command = navigator.update(
                            state.stamp_ns, state.stamp_ns, position, quaternion,
                            truth if eyes is None else eyes.grid(state),
                            float(tilt_deg(quaternion)))
                        velocity = command.forward_mps, command.yaw_rate_radps
                        navigator.notes.clear()
                        if command.status.is_end:
                            outcome = (ARRIVED if command.failure is None
                                       else command.failure.value)
                            break
                    if k % 40 == 0:
                        path.append(position[:2])
                controller.set_velocity(*velocity, state.stamp_ns)
                state = walker.step()
                contacts.add(state.stamp_ns * 1e-9)
                if tip.has_begun(state.orientation_wxyz):
                    outcome = TIPPED
                    break
                tilt = max(tilt, tip.tilt_deg)
        except PhysicsError as error:
            outcome = str(error)
    if outcome == Failure.TILT.value and tip.lies:
        outcome = TIPPED
    return GoalDrive(
        scenario.shared.seed, driver, goal_m, outcome, state.stamp_ns * 1e-9,
        path_length(np.array(path)) if len(path) > 1 else 0.0,
        shortest.length_m if shortest is not None and shortest.reaches_goal else math.nan,
        float(np.linalg.norm(state.position_m[:2] - goal_m)), contacts.rocks, contacts.high,
        contacts.ground, contacts.spokes, navigator.backed_off, walker.energy_j, tilt,
        np.array(path).reshape(-1, 2).round(3))


class Eyes:
    """What a rover sees and maps of a world, with the delay that it has in a graph."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        config = scenario.mapping_node
        self._seen = SeenDepth(world, scenario.rover, scenario.render_node.camera,
                               scenario.render_node.sun, scenario.shared.seed)
        self._config: MapConfig = config.map
        # The errors are those of the real images: here a pixel is as many of them.
        self._baseline_m = self._seen.real_baseline_m
        self.map = ElevationMap(config.map.by_pose(TRUTH))
        self._limits = Limits.of(scenario.rover, config.limits)
        self._fill = config.limits.fill_cells
        self._made: deque[tuple[int, Traversability]] = deque()
        self._newest: Traversability | None = None
        self._next_ns = 0

    def grid(self, state: RoverState) -> Traversability | None:
        """Look if it is time to; return the newest map that has arrived."""
        now = state.stamp_ns
        if now >= self._next_ns:
            self._next_ns += round(1e9 / DEPTH_HZ)
            T = state.T_world_base
            depth = self._seen.look(T, self._config.max_range_m)
            self.map.add_depth(now, depth, self._seen.K, self._baseline_m,
                               T @ self._seen.T_base_camera, T[:3, 3])
            if self.map.has_seen:
                made = traversability(self.map.elevation(), self._limits, self._fill, T[:2, 3])
                self._made.append((now, made))
        while self._made and now - self._made[0][0] >= MAP_LAG_S * 1e9:
            self._newest = self._made.popleft()[1]
        return self._newest


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


class DriveStore(StudyFolder[Case, GoalDrive]):
    """The finished drives of a study, by case."""

    settings_file = 'settings.txt'

    def name(self, case: Case) -> str:
        """Return the case in a word."""
        return '_'.join(str(part).replace('=', '') for part in case)

    def drive(self, values: dict[str, Any]) -> GoalDrive:
        """Return the drive of its values."""
        return GoalDrive(**{**values, 'goal_m': tuple(values['goal_m']),
                            'path_m': np.array(values['path_m']).reshape(-1, 2)})


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
    """Compare what each scenario was driven by; p are corrected for the number of all tests."""
    found, p = [], []
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
            alone = [sum(a[s].arrived and not b[s].arrived for s in seeds)
                     for a, b in ((seen, of), (of, seen))]
            found.append((f'- {scenario}, sun {sun:g}°, seen against {name}: {pair.text()}',
                          f'alone arrived {alone[0]} against {alone[1]}'))
            p += [pair.p, either_alone_p(*alone)]
    q = adjusted(p)
    return [f'{way}, q = {of_way:.2g}: a difference is '
            f'{"" if of_way < 1.0 - CONFIDENCE else "not "}shown; {arrived}, '
            f'q = {of_arrival:.2g} of {len(p)} tests.'
            for (way, arrived), of_way, of_arrival in zip(found, q[::2], q[1::2])]


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
    fields = [f.name for f in dataclasses.fields(GoalDrive)
              if f.name not in ('path_m', 'seed', 'driver')]
    rows = ((*case, *(getattr(drive, name) for name in fields)) for case, drive in drives.items())
    text = write_report(folder, 'navigation', report_text(drives, distance_m), csv_table(
        (*Case._fields, *fields), ([f'{v:.4f}' if isinstance(v, float)
                                    else str(v).replace(',', ';') for v in row] for row in rows)))
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
