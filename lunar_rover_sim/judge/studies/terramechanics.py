"""The terramechanics study: walks on rigid and soft ground, up slopes, and against a pull.

Each walk follows a velocity command straight on, with the packaged gait, on a plane. What is
measured begins after the first seconds, when the start is over.

Grounds are compared on the same worlds, by means, intervals and paired tests: straight walks over
the relief of regolith, of each seed one world, of the recipe of `baseline` without craters and
rocks, on every ground at every speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import functools
import itertools
import math
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.base.errors import ConfigError, PhysicsError, StudyError
from lunar_rover_sim.base.files.results import csv_table, markdown_table, save_figure
from lunar_rover_sim.base.frames import Array, rpy_from_wxyz
from lunar_rover_sim.ground.regolith.config import RIGID
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.evaluation.statistics import (adjusted, CONFIDENCE, either_alone_p,
                                                         Estimate, Mean, Share, signed_rank_p)
from lunar_rover_sim.judge.studies.study_folder import (map_in_processes, Progress, silent,
                                                        write_report)
from lunar_rover_sim.judge.studies.walking import (by_gait, DUG_IN, on_ground, sloping_world,
                                                   WALKED, Walker, with_physics)
from lunar_rover_sim.rover.physics.config import StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

GROUNDS = (RIGID, 'highland_dense', 'highland', 'highland_loose')
SLOPES_DEG = tuple(2.5 * k for k in range(13))
PULLS = tuple(round(0.05 * k, 2) for k in range(19))   # over the weight
SPEED_MPS, DURATION_S, SKIP_S = 0.12, 13.0, 3.0
HALF_EXTENT_M = 30.0   # of the plane, so that a rover that is pulled back stays on it


@dataclasses.dataclass(frozen=True)
class Ground:
    """A walk to be made: ground (`rigid` or a preset), slope [deg], pull backward [weights]."""

    name: str
    slope_deg: float = 0.0
    pull: float = 0.0


def cases(grounds: Sequence[str]) -> list[Ground]:
    """Return walks up slopes, then against pulls on the level."""
    return [*(Ground(name, slope) for name in grounds for slope in SLOPES_DEG),
            *(Ground(name, 0.0, pull) for name in grounds for pull in PULLS[1:])]


@dataclasses.dataclass(frozen=True)
class GroundWalk:
    """One walk.

    Attributes:
        outcome: 'walked', or why not.
        speed_mps: Along the slope, upward.
        lateral_mps: Across it.
        slip: Of all feet, as `SlipMeter.total`.
        transport: Electric energy / (weight × distance), infinite where it does not get on.
        power_w: Mean electric power.
        pitch_rms_deg: RMS of the pitch about its mean.
        sinkage_m: Mean of the deepest foot.
        sinkage_max_m: The greatest.
    """

    ground: Ground
    outcome: str
    speed_mps: float = math.nan
    lateral_mps: float = math.nan
    slip: float = math.nan
    transport: float = math.nan
    power_w: float = math.nan
    pitch_rms_deg: float = math.nan
    sinkage_m: float = math.nan
    sinkage_max_m: float = math.nan


def measure(scenario: Scenario, ground: Ground, speed_mps: float = SPEED_MPS,
            duration_s: float = DURATION_S, world: World | None = None) -> GroundWalk:
    """Walk straight on, and return what was measured.

    A rover that cannot stand there is a result, too.

    Args:
        speed_mps: Commanded.
        duration_s: Of the walk, above `SKIP_S`.
        world: To walk on, by default a plane of the ground's slope.
    """
    scenario = on_ground(with_physics(scenario, start=StartPose()), ground.name)
    try:
        with scenario.simulation(
                world or sloping_world(ground.slope_deg, HALF_EXTENT_M)) as simulation:
            return _walk(scenario, simulation, ground, speed_mps, duration_s)
    except (ConfigError, PhysicsError) as error:
        return GroundWalk(ground, str(error))


def holding(walks: Sequence[GroundWalk]) -> list[GroundWalk]:
    """Return the walks against a growing pull up to the first that is drawn back."""
    grown = sorted(walks, key=lambda walk: walk.ground.pull)
    return list(itertools.takewhile(lambda walk: walk.speed_mps > 0.0, grown))


def _walk(scenario: Scenario, simulation: Simulation, ground: Ground, speed_mps: float,
          duration_s: float) -> GroundWalk:
    controller = scenario.gait_controller()
    weight = scenario.rover.total_mass_kg * scenario.physics_node.gravity_mps2
    slope = math.radians(ground.slope_deg)
    uphill = np.array([math.cos(slope), 0.0, math.sin(slope)])
    simulation.apply_force(-ground.pull * weight * uphill)
    walker, state = Walker(simulation, by_gait(controller), slip_every=1), simulation.state
    begin, pitch, sinkage = state.position_m, [], [0.0]
    for _ in range(round(duration_s / walker.period_s)):
        controller.set_velocity(speed_mps, 0.0, state.stamp_ns)
        state = walker.step()
        if state.stamp_ns * 1e-9 <= SKIP_S:
            begin = state.position_m
            walker.begin()
        else:
            pitch.append(math.degrees(rpy_from_wxyz(state.orientation_wxyz)[1]))
            contact = simulation.ground_contact
            if contact is not None:
                sinkage.append(float(contact.sinkage_m.max()))
    way = state.position_m - begin
    distance, time_s = float(way @ uphill), walker.periods * walker.period_s
    transport = walker.energy_j / (weight * distance) if distance > 0.01 else math.inf
    return GroundWalk(
        ground, DUG_IN if walker.has_dug_in() else WALKED, distance / time_s,
        float(way[1]) / time_s, walker.feet.total, transport, walker.energy_j / time_s,
        float(np.std(pitch)), float(np.mean(sinkage)), max(sinkage))


_FIELDS = tuple(field.name for field in dataclasses.fields(GroundWalk)[2:])


def write_all(walks: Sequence[GroundWalk], folder: Path) -> str:
    """Write terramechanics.md, .csv and .png into a folder; return the text."""
    text = write_report(folder, 'terramechanics', report_text(walks), csv_table(
        ('ground', 'slope_deg', 'pull', 'outcome', *_FIELDS),
        ((*dataclasses.astuple(walk.ground), walk.outcome,
          *(getattr(walk, name) for name in _FIELDS)) for walk in walks)))
    plot(walks, folder / 'terramechanics.png')
    return text


def report_text(walks: Sequence[GroundWalk]) -> str:
    """Return the report as Markdown."""
    return '\n'.join([
        '# Terramechanics', '',
        'Slip: 1 - way / way that the loaded feet sweep, along the heading. Transport:'
        ' electric energy / (weight × distance). Pull: backward, over the weight.', '',
        *markdown_table(('ground', 'slope [°]', 'pull', 'outcome', 'speed [m/s]', 'slip [%]',
                         'transport', 'power [W]', 'pitch RMS [°]', 'sinkage [mm]', 'max'),
                        map(_walk_row, walks)), ''])


def _walk_row(w: GroundWalk) -> list[str]:
    transport = '–' if math.isinf(w.transport) else f'{w.transport:.2f}'
    return [w.ground.name, f'{w.ground.slope_deg:g}', f'{w.ground.pull:g}', w.outcome,
            f'{w.speed_mps:.3f}', f'{1e2 * w.slip:.1f}', transport, f'{w.power_w:.2f}',
            f'{w.pitch_rms_deg:.2f}', f'{1e3 * w.sinkage_m:.1f}', f'{1e3 * w.sinkage_max_m:.1f}']


def plot(walks: Sequence[GroundWalk], path: Path) -> None:
    """Write a figure: slip and power against slope, pull against slip, sinkage."""
    figure = Figure(figsize=(11.0, 7.5), layout='constrained')
    (slip, power), (pull, sinkage) = figure.subplots(2, 2)
    for name in dict.fromkeys(walk.ground.name for walk in walks):
        sloping = [w for w in walks if w.ground.name == name and w.ground.pull == 0.0]
        pulled = [w for w in walks if w.ground.name == name and w.ground.slope_deg == 0.0]
        degrees = [w.ground.slope_deg for w in sloping]
        slip.plot(degrees, [1e2 * w.slip for w in sloping], 'o-', ms=3, label=name)
        power.plot(degrees, [w.power_w for w in sloping], 'o-', ms=3)
        held = holding(pulled)
        line, = pull.plot([1e2 * w.slip for w in held], [w.ground.pull for w in held], 'o-', ms=3)
        # Beyond that pull, it depends on the start whether a walk is drawn back.
        later = [w for w in pulled if w.speed_mps > 0.0 and w not in held]
        pull.plot([1e2 * w.slip for w in later], [w.ground.pull for w in later], 'x',
                  color=line.get_color())
        sinkage.plot(degrees, [1e3 * w.sinkage_m for w in sloping], 'o-', ms=3)
    slip.set(xlabel='slope [°]', ylabel='slip [%]', ylim=(-2.0, 100.0))
    power.set(xlabel='slope [°]', ylabel='electric power [W]')
    pull.set(xlabel='slip [%]', ylabel='pull over weight', xlim=(-2.0, 100.0))
    sinkage.set(xlabel='slope [°]', ylabel='mean sinkage of the deepest foot [mm]')
    for axes in (slip, power, pull, sinkage):
        axes.grid(alpha=0.3)
    slip.legend()
    save_figure(figure, path, StudyError)


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What is compared: its name with unit, and its value in a result; NaN where it has none.

    A share is 1 or 0 in each result.
    """

    name: str
    of: Callable[[Any], float]
    digits: int = 2
    share: bool = False

    def estimate(self, values: Array) -> Estimate:
        """Return the mean of (n,) values, or their share, with its interval."""
        if self.share:
            return Share.of(int(np.nansum(values)), int(np.sum(~np.isnan(values))))
        return Mean.of(values)


@dataclasses.dataclass(frozen=True)
class Compared:
    """One quantity on one ground, and what it is more there than on the first ground.

    Attributes:
        difference, p: Of the worlds that have the value on both grounds, pairwise; p of Wilcoxon's
            signed-rank test, of a share McNemar's, two-sided; NaN on the first ground.
    """

    quantity: Quantity
    ground: str
    estimate: Estimate
    difference: Mean | None = None
    p: float = math.nan


def compare(results: Mapping[str, Sequence[Any]],
            quantities: Sequence[Quantity]) -> list[Compared]:
    """Compare grounds; results: ground → results of the same worlds in the same order."""
    found = []
    for quantity in quantities:
        first: Array | None = None
        for ground, each in results.items():
            values = np.array([quantity.of(result) for result in each], dtype=float)
            values[~np.isfinite(values)] = math.nan
            own = quantity.estimate(values)
            if first is None:
                first = values
                found.append(Compared(quantity, ground, own))
                continue
            more = values - first
            more = more[~np.isnan(more)]
            p = (either_alone_p(int(np.sum(more > 0.0)), int(np.sum(more < 0.0)))
                 if quantity.share else signed_rank_p(more))
            found.append(Compared(quantity, ground, own, Mean.of(more), p))
    return found


def comparison_text(compared: Sequence[Compared], first: str) -> str:
    """Return the comparison as a Markdown table."""
    rows = []
    for c, q in zip(compared, adjusted([c.p for c in compared])):
        digits = c.quantity.digits
        against = ['–'] * 3 if c.difference is None else [
            c.difference.text(digits, '+'), f'{c.p:.2g}', f'{q:.2g}']
        rows.append([c.quantity.name, c.ground, c.estimate.text(digits), str(c.estimate.count),
                     *against])
    return '\n'.join([
        f'Means with {100 * CONFIDENCE:.0f} % intervals of Student (shares: Wilson); differences '
        f'to {first} on the same worlds; p of the signed-rank test of Wilcoxon (shares: McNemar); '
        'q is p corrected for the number of tests in this table (Benjamini and Hochberg).', '',
        *markdown_table(('quantity', 'ground', 'mean', 'n', 'difference', 'p', 'q'), rows), ''])


def plot_comparison(results: Mapping[str, Sequence[Any]], quantities: Sequence[Quantity],
                    path: Path) -> None:
    """Write a figure: each quantity over the grounds, one line a world, means with intervals."""
    columns = math.ceil(len(quantities) / 2)
    figure = Figure(figsize=(4.0 * columns, 6.5), layout='constrained')
    panels = figure.subplots(2, columns, squeeze=False).ravel()
    places = np.arange(len(results))
    for quantity, axes in zip(quantities, panels):
        values = np.array([[quantity.of(r) for r in each] for each in results.values()], float)
        values[~np.isfinite(values)] = math.nan
        axes.plot(places, values, '.-', color='0.75', lw=0.8, ms=4)
        for place, row in zip(places, values):
            own = quantity.estimate(row)
            if own.count:
                axes.errorbar(place, own.value, [[own.value - own.low], [own.high - own.value]],
                              fmt='o', color='C0', capsize=4)
        axes.set(title=quantity.name)
        axes.set_xticks(places, list(results))
        axes.grid(alpha=0.3)
    for axes in panels[len(quantities):]:
        axes.remove()
    save_figure(figure, path, StudyError)


SIZE_M, SAMPLES = 12.8, 257   # of the worlds: room for a walk, and no more

WALK_QUANTITIES = (
    Quantity('speed [m/s]', lambda w: w.speed_mps, 4),
    Quantity('slip [%]', lambda w: 1e2 * w.slip, 1),
    Quantity('electric cost of transport', lambda w: w.transport, 2),
    Quantity('electric power [W]', lambda w: w.power_w, 3),
    Quantity('pitch RMS [°]', lambda w: w.pitch_rms_deg, 2),
    Quantity('share that stops', lambda w: float(w.outcome != WALKED), 2, share=True))

Walks = Mapping[float, Mapping[str, Sequence[GroundWalk]]]


def walk_study(scenario: Scenario, grounds: Sequence[str], speeds_mps: Sequence[float],
               seeds: Sequence[int], duration_s: float = DURATION_S, workers: int = 1,
               progress: Progress = silent) -> Walks:
    """Return speed → ground → walks in the order of seeds."""
    worlds = WorldConfig()
    relief = dataclasses.replace(
        worlds, size_m=SIZE_M, craters=dataclasses.replace(worlds.craters, density=0.0),
        rocks=dataclasses.replace(worlds.rocks, abundance=0.0),
        surroundings=dataclasses.replace(worlds.surroundings, samples=SAMPLES))
    jobs = [(speed, name, seed) for seed in seeds for speed in speeds_mps for name in grounds]
    walks = dict(zip(jobs, map_in_processes(
        functools.partial(_on_relief, scenario, relief, duration_s), jobs, workers, progress)))
    return {speed: {name: [walks[speed, name, seed] for seed in seeds] for name in grounds}
            for speed in speeds_mps}


def write_walks(walks: Walks, folder: Path) -> str:
    """Write grounds.md and a figure for each speed into a folder; return the text."""
    parts = ['# Straight walks on several grounds', '']
    for speed, results in walks.items():
        parts += [f'## {speed:g} m/s', '',
                  comparison_text(compare(results, WALK_QUANTITIES), next(iter(results)))]
        plot_comparison(results, WALK_QUANTITIES, folder / f'grounds_{speed:g}.png')
    return write_report(folder, 'grounds', '\n'.join(parts))


def _on_relief(scenario: Scenario, relief: WorldConfig, duration_s: float,
               job: tuple[float, str, int]) -> GroundWalk:
    speed, name, seed = job
    return measure(scenario, Ground(name), speed, duration_s, _relief_world(relief, seed))


@functools.lru_cache(maxsize=1)
def _relief_world(config: WorldConfig, seed: int) -> World:
    return build_world(config, seed)
