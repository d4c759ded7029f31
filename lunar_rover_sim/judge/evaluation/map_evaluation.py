"""Maps of a recorded drive against the true surface of its world.

As the Lunar Autonomy Challenge (NASA and Johns Hopkins APL, 2025) scores maps: in cells of 15 cm,
the error of the elevation and a flag for rocks.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from lunar_rover_sim.autonomy.navigation.elevation_map import Elevation
from lunar_rover_sim.autonomy.navigation.traversability import LETHAL, Limits
from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.message_validity import elevation_points, elevation_problem, grid_problem
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.results import plain, save_figure
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.image.lidar.ray_caster import RayCaster
from lunar_rover_sim.run.recorded_run import RecordedRun

CELL_M = 0.15
DISTANCES_M = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.4)
NEAR_M = 4.0
_SAMPLES = 5            # rays along a side of a cell
_SAMPLES_OF_MAP = 2     # and of a cell of the map
_ABOVE_M = 1.0          # rays begin this far over the highest ground and rock
_DOWN = np.array([0.0, 0.0, -1.0])


class TrueSurface:
    """Heights and rocks of a world, by rays from above."""

    def __init__(self, world: World) -> None:
        self._ground = world.ground
        # Rays are cast in the frame of the window.
        self._middle_m = np.array(world.ground.middle_m)
        local = world.local()
        rocks = local.rocks
        hulls = RockHulls(rocks, local.rock_shapes)
        self._caster = RayCaster([HeightPyramid(local.ground, hulls)], hulls)
        top = float(local.ground.heights_m.max())
        if len(rocks):
            top = max(top, float((rocks.position_m[:, 2] + rocks.diameter_m).max()))
        self._top_m = top + _ABOVE_M

    def heights(self, xy_m: ArrayLike) -> tuple[Array, Array]:
        """Return heights (...) [m] at (..., 2) places, and how far rocks rise over the ground.

        Heights are NaN outside the fine ground; rocks rise by 0 where there is none.
        """
        xy = np.asarray(xy_m, float)
        flat = xy.reshape(-1, 2)
        inside = np.flatnonzero(self._ground.contains(flat))
        height, rise = np.full(len(flat), np.nan), np.zeros(len(flat))
        if len(inside):
            origin = np.column_stack([flat[inside] - self._middle_m,
                                      np.full(len(inside), self._top_m)])
            hits = self._caster.cast(origin, np.tile(_DOWN, (len(inside), 1)), 1e4,
                                     from_one_place=False)
            height[inside] = self._top_m - hits.distance_m
            rock = hits.target >= 0
            rise[inside[rock]] = (height[inside[rock]]
                                  - self._ground.height_at(flat[inside[rock]]))
        return height.reshape(xy.shape[:-1]), np.maximum(rise, 0.0).reshape(xy.shape[:-1])

    def elevation(self, centre_m: ArrayLike, size_m: float, cell_m: float,
                  samples: int = 2) -> Elevation:
        """Return the true map of a square: means of so many samples along each side of a cell."""
        n = round(size_m / cell_m)
        origin = np.round(np.asarray(centre_m, float)[:2] / cell_m - 0.5 * n) * cell_m
        step = (np.arange(n * samples) + 0.5) * cell_m / samples
        x, y = np.meshgrid(origin[0] + step, origin[1] + step)
        height, _ = self.heights(np.stack([x, y], axis=-1))
        mean = height.reshape(n, samples, n, samples).mean(axis=(1, 3)).astype(np.float32)
        known = np.isfinite(mean)
        return Elevation(0, origin, cell_m, mean,
                         np.where(known, np.float32(1e-8), np.float32(np.nan)))


class Rates(NamedTuple):
    """Errors of the cells at some distance from the rover.

    Attributes:
        low_m, high_m: From and up to which distance [m].
        cells: Number of known cells.
        rms_m: RMS error of the elevation [m].
        median_m: Median of its absolute value [m].
        precision: Share of the flagged cells that hold a rock, or lie beside one.
        recall: Share of the cells with a rock that are flagged, or lie beside one that is.
        beyond_3_sigma: Share of the cells of the map, which are smaller, whose error is more than
            three of the standard deviations that the map states; of a normal distribution 0.003.
    """

    low_m: float
    high_m: float
    cells: int
    rms_m: float
    median_m: float
    precision: float
    recall: float
    beyond_3_sigma: float


@dataclasses.dataclass(frozen=True)
class MapEvaluation:
    """The maps of one drive.

    Attributes:
        maps: How many were judged.
        near: All cells within `NEAR_M` of the rover.
        by_distance: By distance from the rover.
        rock_m: Height from which a rock counts, since the rover cannot cross it [m].
        offset_m: Median error of the elevation [m]; an error in the height of the pose is in it.
        beyond_3_sigma: As `Rates` has it, of all cells of the map.
        sun_deg: Elevation of the sun [deg].
    """

    maps: int
    near: Rates
    by_distance: tuple[Rates, ...]
    rock_m: float
    offset_m: float
    beyond_3_sigma: float
    sun_deg: float

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values, None for NaN."""
        return plain({'maps': self.maps, 'rock_m': self.rock_m, 'offset_m': self.offset_m,
                      'beyond_3_sigma': self.beyond_3_sigma, 'sun_deg': self.sun_deg,
                      'near': self.near._asdict(),
                      'by_distance': [one._asdict() for one in self.by_distance]})


class _Cells(NamedTuple):
    """Judged cells of one or more maps: (n,) each."""

    distance_m: Array
    error_m: Array
    flagged: NDArray[np.bool_]
    rock: NDArray[np.bool_]
    beside_flag: NDArray[np.bool_]
    beside_rock: NDArray[np.bool_]
    centre_m: Array
    surprise: Array         # of each cell of the map: error over stated deviation
    surprise_at_m: Array    # and its distance


def evaluate_maps(path: Path, world: Path | None = None, most: int = 40,
                  output: Path | None = None) -> MapEvaluation:
    """Judge maps of a bag, evenly over the drive.

    Args:
        world: Folder of its world, where that is not found beside the bag or in the cache.
        most: Largest number of maps that are judged.
        output: PNG of the errors of the last map; None: none.

    Raises:
        EvaluationError: If the bag holds no map, or its world is not found.
    """
    with open_bag(path) as bag:
        if not bag.has(topics.ELEVATION.name) or not bag.has(topics.TRAVERSABILITY.name):
            raise EvaluationError(f'{path}: holds no {topics.ELEVATION.name} and '
                                  f'{topics.TRAVERSABILITY.name}; mapping_node publishes them')
        run = RecordedRun(bag)
        found = run.driven(world)
        if found is None:
            raise EvaluationError(f'{path}: its world is not found; name its folder with --world')
        nodes = run.nodes
        limits = Limits.of(nodes.rover, nodes.mapping.limits)
        window = found.world
        surface = TrueSurface(window)
        odometry = series.read_odometry(bag)
        stamps = [message.time_ns for message in bag.raw([topics.ELEVATION.name])]
        parts = []
        for stamp in series.spread(stamps, most):
            if found.at(stamp) is not window:
                window = found.at(stamp)
                surface = TrueSurface(window)
            cells = _judged(bag, stamp, odometry, surface, limits.step_m)
            if cells is not None:
                parts.append(cells)
    if not parts:
        raise EvaluationError(f'{path}: no map holds a known cell')
    every = _Cells(*(np.concatenate(values) for values in zip(*parts)))
    if output is not None:
        _plot(parts[-1], output)
    bins = tuple(_rates(every, low, high) for low, high in zip(DISTANCES_M, DISTANCES_M[1:]))
    return MapEvaluation(len(parts), _rates(every, 0.0, NEAR_M), bins, limits.step_m,
                         float(np.median(every.error_m)), _beyond(every.surprise),
                         nodes.render.sun.elevation_deg)


def _judged(bag: Bag, stamp: int, odometry: series.Odometry, surface: TrueSurface,
            rock_m: float) -> _Cells | None:
    """Judge the map of one stamp [ns]; return None where no cell of it is known."""
    found = series.messages_at(bag, (topics.ELEVATION, topics.TRAVERSABILITY), stamp)
    cloud, grid = found.get(topics.ELEVATION), found.get(topics.TRAVERSABILITY)
    if cloud is None or grid is None or not cloud.width or header_ns(grid) != stamp:
        return None
    for topic, problem in ((topics.ELEVATION, elevation_problem(cloud)),
                           (topics.TRAVERSABILITY, grid_problem(grid))):
        if problem is not None:
            raise EvaluationError(f'{bag.path}: {topic.name}: {problem}')
    points = elevation_points(cloud)
    # Cells of the same raster in every map.
    places = np.floor(points[:, :2] / CELL_M).astype(int)
    corner = places.min(axis=0) - 1
    shape = tuple((places.max(axis=0) - corner + 2)[::-1])
    flat = np.ravel_multi_index(tuple((places - corner).T[::-1]), shape)
    count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    height = np.bincount(flat, points[:, 2], shape[0] * shape[1]).reshape(shape)
    # Of nine cells of 5 cm at least five are known.
    known = count >= 0.5 * (CELL_M / grid.info.resolution) ** 2
    if not known.any():
        return None
    rows, columns = np.nonzero(known)
    low = (np.stack([columns, rows], axis=-1) + corner) * CELL_M
    inside = (np.arange(_SAMPLES) + 0.5) * CELL_M / _SAMPLES
    offsets = np.stack(np.meshgrid(inside, inside), axis=-1).reshape(-1, 2)
    true, rise = surface.heights(low[:, None] + offsets)
    is_rock = np.zeros(shape, bool)
    is_rock[rows, columns] = rise.max(axis=1) > rock_m
    is_flagged = _flags(grid, corner, shape)
    k = max(int(np.searchsorted(odometry.stamps_ns, stamp, side='right')) - 1, 0)
    centre, place = low + 0.5 * CELL_M, odometry.positions_m[k, :2]
    distance = np.linalg.norm(centre - place, axis=1)
    surprise = _surprises(points, grid.info.resolution, surface)
    known_truth = np.isfinite(surprise)
    error = height[rows, columns] / count[rows, columns] - true.mean(axis=1)
    fine = np.isfinite(error)
    beside_flag, beside_rock = (binary_dilation(flags, np.ones((3, 3)))[rows, columns]
                                for flags in (is_flagged, is_rock))
    return _Cells(distance[fine], error[fine], is_flagged[rows, columns][fine],
                  is_rock[rows, columns][fine], beside_flag[fine], beside_rock[fine],
                  centre[fine], surprise[known_truth],
                  np.linalg.norm(points[known_truth, :2] - place, axis=1))


def _surprises(points: Array, cell_m: float, surface: TrueSurface) -> Array:
    """Return errors over stated deviations of cells (n, 4): x, y, z and deviation.

    They are NaN beyond the fine ground.
    """
    inside = (np.arange(_SAMPLES_OF_MAP) + 0.5) / _SAMPLES_OF_MAP - 0.5
    offsets = cell_m * np.stack(np.meshgrid(inside, inside), axis=-1).reshape(-1, 2)
    true, _ = surface.heights(points[:, None, :2] + offsets)
    surprise: Array = (points[:, 2] - true.mean(axis=1)) / points[:, 3]
    return surprise


def _flags(grid: Any, corner: NDArray[np.integer], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which cells hold a place that is not to be crossed."""
    info = grid.info
    cost = np.asarray(grid.data, np.int8).reshape(info.height, info.width)
    rows, columns = np.nonzero(cost >= LETHAL)
    x = info.origin.position.x + (columns + 0.5) * info.resolution
    y = info.origin.position.y + (rows + 0.5) * info.resolution
    place = np.floor(np.stack([y, x], axis=-1) / CELL_M).astype(int) - corner[::-1]
    inside = np.all((place >= 0) & (place < shape), axis=1)
    flags = np.zeros(shape, bool)
    flags[tuple(place[inside].T)] = True
    return flags


def _beyond(surprise: Array) -> float:
    """Return the share of errors beyond three deviations, NaN of none."""
    return float(np.mean(np.abs(surprise) > 3.0)) if len(surprise) else float('nan')


def _rates(cells: _Cells, low_m: float, high_m: float) -> Rates:
    here = (cells.distance_m >= low_m) & (cells.distance_m < high_m)
    count = int(np.count_nonzero(here))
    nan = float('nan')
    if not count:
        return Rates(low_m, high_m, 0, nan, nan, nan, nan, nan)
    error = cells.error_m[here]
    flagged, rock = here & cells.flagged, here & cells.rock

    def share(of: NDArray[np.bool_], with_: NDArray[np.bool_]) -> float:
        total = int(np.count_nonzero(of))
        return float(np.count_nonzero(of & with_) / total) if total else nan
    return Rates(low_m, high_m, count, float(np.sqrt(np.mean(error ** 2))),
                 float(np.median(np.abs(error))), share(flagged, cells.beside_rock),
                 share(rock, cells.beside_flag),
                 _beyond(cells.surprise[(cells.surprise_at_m >= low_m)
                                        & (cells.surprise_at_m < high_m)]))


def _plot(cells: _Cells, path: Path) -> None:
    figure = Figure(figsize=(11.0, 5.0), layout='constrained')
    left, right = figure.subplots(1, 2)
    shown = left.scatter(*cells.centre_m.T, c=100.0 * cells.error_m, s=9, marker='s', vmin=-5.0,
                         vmax=5.0, cmap='coolwarm')
    figure.colorbar(shown, ax=left, label='error of the elevation [cm]')
    colour = np.where(cells.rock & cells.beside_flag, 'tab:green',
                      np.where(cells.rock, 'tab:red',
                               np.where(cells.flagged, 'tab:orange', '0.85')))
    right.scatter(*cells.centre_m.T, c=colour, s=9, marker='s')
    right.set_title('rocks: green found, red missed; orange: flagged without one', fontsize=9)
    for axes in (left, right):
        axes.set(aspect='equal', xlabel='x, east [m]', ylabel='y, north [m]')
    save_figure(figure, path, EvaluationError)
