"""The benchmark of traverses: far drives over sites, by distance, rate of images and sun.

Each condition is a benchmark of its own (`benchmark.run`) in a folder of the study, so that each
is resumed, joined and sealed as any other. Sites are seeds that nothing was tuned on, and ways
over them are planned: no drive depends on what a camera saw. The anchored graph gets a map from
orbit, with errors of its own for each site, and a place within DOUBT_M of the start.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.results import markdown_table
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import ABOUT_FILE, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.judge.evaluation.statistics import Median, Share
from lunar_rover_sim.judge.slam import benchmark
from lunar_rover_sim.judge.slam.benchmark import AIDED, Cell
from lunar_rover_sim.judge.slam.drives import Drive, Judged
from lunar_rover_sim.judge.slam.estimators import ANCHORED, Estimator
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt
from lunar_rover_sim.judge.slam.table import differences, is_success, tipped_over
from lunar_rover_sim.judge.slam.ways import ALONG, planned, settings_of
from lunar_rover_sim.run.scenario import read_sections, Scenario

SCENARIO, DARK = 'expedition', 'dark'
DOUBT_M, FIX_M = 50.0, 60.0         # of the start; a first fix within this way is early
_BASE = 'reference'                 # with which the other systems are compared
_TOWARDS = 0.8, 0.6                 # of the goal
_BEYOND_M = 20.0                    # of a map around way and doubt
_ASIDE_M = 5.0                      # of the goal, in which the way of a drive to it ends
_START_S, _SLOWEST_S_PER_M = 60.0, 25.0     # after which a drive has ended, a metre of distance
_BY_LAMP = 'permanent_shadow'       # its camera and its light are those in the dark


@dataclasses.dataclass(frozen=True)
class Condition:
    """What the drives of a line of the table share.

    Attributes:
        distance_m: From the start to the goal.
        rate_hz: Of the images.
        sun: Its elevation [deg] as text, or DARK.
    """

    distance_m: float
    rate_hz: float
    sun: str

    @property
    def name(self) -> str:
        """Name of its folder."""
        light = DARK if self.sun == DARK else f'{float(self.sun):g}deg'
        return f'{self.distance_m:g}m_{self.rate_hz:g}hz_{light}'

    def settings(self, more: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the settings of the scenario; `more` come after them."""
        if self.sun == DARK:
            render = read_sections(find_file('scenario', _BY_LAMP))['render_node']
            light = [f'render_node.{name}={json.dumps(value)}' for name, value in render.items()]
        else:
            light = [f'render_node.sun.elevation_deg={float(self.sun):g}']
        return (f'render_node.frame_rate_hz={self.rate_hz:g}',
                f'recorder_node.topics=[{",".join(topic.name for topic in AIDED)}]',
                *light, *more)

    def cells(self, estimators: Sequence[Estimator], ways: Mapping[int, Array],
              more: Sequence[str] = ()) -> list[Cell]:
        """Return the cells of its benchmark.

        Args:
            ways: Seed → (n, 2) waypoints.

        Raises:
            ConfigError: If a setting is not valid.
            SlamError: If a way does not end near the goal.
        """
        for seed, way in ways.items():
            if (off_m := math.dist(_goal(self.distance_m), way[-1])) > _ASIDE_M:
                raise SlamError(f'distances: {self.distance_m:g} is not valid with this way of '
                                f'seed {seed}, which ends {off_m:.1f} m off the goal; valid is '
                                f'up to {_ASIDE_M:g} m')
        limit_s = _START_S + math.ceil(_SLOWEST_S_PER_M * self.distance_m)
        cells = benchmark.plan([SCENARIO], estimators, list(ways), limit_s,
                               overrides=(*self.settings(more), *ALONG))
        return [dataclasses.replace(cell, drive=dataclasses.replace(
            cell.drive, overrides=cell.drive.overrides + settings_of(ways[cell.drive.seed])))
            for cell in cells]


def conditions(distances_m: Sequence[float], rates_hz: Sequence[float],
               suns: Sequence[str]) -> list[Condition]:
    """Return all conditions, each distance after the other.

    Raises:
        SlamError: If a sun is neither an elevation nor DARK, or one is named twice.
    """
    for sun in suns:
        try:
            good = sun == DARK or 0.0 < float(sun) <= 90.0
        except ValueError:
            good = False
        if not good:
            raise SlamError(f'suns: {sun!r} is not valid; valid is above 0 to 90 [deg], or {DARK}')
    found = [Condition(distance, rate, sun)
             for distance in distances_m for rate in rates_hz for sun in suns]
    if len({one.name for one in found}) < len(found):
        raise SlamError('traverse: name each distance, rate and sun once')
    return found


def way_of(distance_m: float, seed: int, folder: Path, more: Sequence[str] = ()) -> Array:
    """Return the (n, 2) waypoints [m] over the true ground of a site to the goal.

    Args:
        folder: Of ways; it is planned if it is not there.
        more: Settings of the scenario.

    Raises:
        SlamError: If there is no way.
    """
    path = folder / f'seed{seed}_{distance_m:g}m.csv'
    if not path.exists():
        way = planned(Scenario.load(SCENARIO, more, seed=seed), _goal(distance_m))
        folder.mkdir(parents=True, exist_ok=True)
        atomic_write(path, lambda file: np.savetxt(file, way, '%.2f', ','))
    return np.loadtxt(path, delimiter=',', ndmin=2)


def _goal(distance_m: float) -> tuple[float, float]:
    return distance_m * _TOWARDS[0], distance_m * _TOWARDS[1]


def anchor_of(drive: Drive, maps: Path, reach_m: float) -> Anchor:
    """Return what finds the place of a drive on the map from orbit of its site.

    Args:
        maps: Folder of maps; the one of the site is made if it is not there.
        reach_m: From the start to the goal.
    """
    scenario = drive.load_scenario()
    start = scenario.physics_node.start
    rng = np.random.default_rng([drive.seed, 5])
    angle, radius = rng.uniform(-math.pi, math.pi), DOUBT_M * math.sqrt(rng.uniform())
    place = start.x_m + radius * math.cos(angle), start.y_m + radius * math.sin(angle)
    half = (max(map(abs, (start.x_m, start.y_m))) + reach_m + 2.0 * DOUBT_M + _BEYOND_M)
    folder = maps / f'seed{drive.seed}_{half:g}m'
    if not (folder / ABOUT_FILE).exists():      # it is written last
        site = Site(scenario.world, drive.seed)
        half = min(half, site.half_extent_m)
        orbital_map(site, OrbitalConfig(extent_m=2.0 * half,
                                        error_seed=drive.seed)).save(folder)
    return Anchor(OrbitalMap.load(folder), Doubt(place, DOUBT_M))


Named = tuple[Condition, Judged]


def table(judged: Sequence[Named]) -> str:
    """Return a Markdown table with a line for each condition and system, and what differs."""
    groups: dict[tuple[Condition, str], list[Judged]] = {}
    for condition, one in judged:
        groups.setdefault((condition, one.result.system), []).append(one)
    lines = []
    for (condition, system), group in groups.items():
        upright = [one for one in group if not tipped_over(one)]
        good = [one.result for one in upright if is_success(one)]
        lines.append([
            f'{condition.distance_m:g}', f'{condition.rate_hz:g}', condition.sun, system,
            _share([is_success(one) for one in upright]),
            Median.of(r.distance_m for r in good).text(0),
            Median.of(r.ate_percent for r in good).text(2),
            Median.of(r.drift_percent for r in good).text(2),
            *_of_place([one.result for one in upright if not one.failed], system),
            Median.of(r.nees_position for r in good).text(2)])
    text = markdown_table(
        ['distance [m]', 'images [Hz]', 'sun [deg]', 'system', 'success', 'driven [m]',
         'ATE [% of way]', 'drift [%]', f'first fix in {FIX_M:g} m', 'false fix',
         'error after [m]', 'p95 of it [m]', 'NEES'], lines)
    reasons = [f'- {condition.name} {one.text}: {one.result.reason}'
               for condition, one in judged if one.result.reason]
    wrong = ['', 'What went wrong:', '', *reasons] if reasons else []
    return '\n'.join([
        'Shares with intervals of Wilson, medians of successes with those of the sign test, 95 %.',
        '', *text, '', *_differences(groups), *wrong, ''])


def _share(flags: Sequence[bool]) -> str:
    found = Share.of(sum(flags), len(flags))
    return f'{sum(flags)}/{len(flags)} [{found.low:.2f}, {found.high:.2f}]' if flags else '–'


def _of_place(results: Sequence[benchmark.SlamResult], system: str) -> list[str]:
    """Return first fixes, false ones and errors after the first fix; of the others nothing."""
    if system != ANCHORED:
        return 4 * ['–']
    return [_share([r.first_fix_m <= FIX_M for r in results]),
            _share([r.false_fixes > 0 for r in results]),
            Median.of(r.absolute_median_m for r in results).text(2),
            Median.of(r.absolute_p95_m for r in results).text(2)]


def _differences(groups: dict[tuple[Condition, str], list[Judged]]) -> list[str]:
    """Say of each system whether its error differs from that of the reference."""
    found = [(f'- {condition.name}, {system}', group, groups[condition, _BASE])
             for (condition, system), group in groups.items()
             if system != _BASE and (condition, _BASE) in groups]
    of_base = f'than that of the {_BASE}'
    return differences(found, f'its error is not shown to differ from that of the {_BASE}',
                       f'its error is larger {of_base}', f'its error is smaller {of_base}')


def run(condition: Condition, cells: Sequence[Cell], folder: Path, maps: Path,
        step: benchmark.Step = lambda _cell, _text: None, retry: bool = False, jobs: int = 1,
        runner: Callable[..., list[Cell]] = benchmark.run) -> list[Named]:
    """Do what is missing of a condition in its folder, and return what became of its drives.

    Args:
        maps: Folder of the maps from orbit, which all conditions share.
        runner: As `benchmark.run`.
    """
    own = folder / condition.name
    done = runner(cells, own, step, retry, jobs,
                  anchor_of=lambda drive: anchor_of(drive, maps, condition.distance_m))
    return [(condition, cell.judged(own)) for cell in done]
