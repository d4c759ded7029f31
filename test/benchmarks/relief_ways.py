"""Ways over unseen sites and the relief that stereo sees along them, without images.

Ground and rocks are those of a site, on cells of 0.2 m. A way has a course, bends at random and
turns away from slopes that the rover does not take. Rocks in its way are taken off the ground, as
the rover would walk around them. Rays meet what the sun lights; errors are those of the matcher,
as in `validate navigation`.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from lunar_rover_sim import Scenario
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world import rockfield, shapes
from lunar_rover_sim.ground.world.build import Builder
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.orbital_making import orbital_map
from lunar_rover_sim.ground.world.orbital_map import bilinear, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shade import add_domes, shadow
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.stereo.seen_depth import ERROR_PX, UNMATCHED, WRONG, WRONG_PX

HALF_M, COARSE = 172.0, 2               # of the map around the start; level of heights of courses
STEP_M = 0.5                            # between looks, as between keyframes of fast drives
CORNERS = 250                           # pixels of a look; some see the dark, or the sky
_FINE, _AROUND_M = 1, 12.0              # level of heights that are seen; so far from the way
_NEAR_M, _RANGE_M, _MARCH_M = 0.3, 8.0, 0.08
_LEAST_PX = 1.5                         # of a disparity, as in the graph
_LEAST_ROCK_M, _ROOM_M = 0.3, 0.6       # of a rock; from its side to the way
_STEEP, _WOBBLE_RAD = math.tan(math.radians(14.0)), math.radians(2.0)


@dataclasses.dataclass(frozen=True)
class Way:
    """A way and what is seen from it.

    Attributes:
        T_world_base: (n, 4, 4), STEP_M apart.
        points_m: (n, CORNERS, 3) in the left camera; NaN where fewer were matched.
        T_base_left: (4, 4).
    """

    T_world_base: Array
    points_m: Array
    T_base_left: Array


def orbital(seed: int, **otherwise: float) -> OrbitalMap:
    """Return the maps around the origin of a site from orbit, with errors of its own."""
    return orbital_map(Site(Scenario.load('site').world.with_seed(seed)), OrbitalConfig(
        extent_m=2.0 * HALF_M, error_seed=seed, **otherwise))


def way(seed: int, length_m: float, folder: Path) -> Way:
    """Return the way on a site, from a file of the folder if it is there."""
    file = folder / f'way_{seed}_{length_m:g}.npz'
    if not file.exists():
        made = _made(seed, length_m)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, **{field.name: getattr(made, field.name)
                          for field in dataclasses.fields(Way)})
    with np.load(file) as values:
        return Way(**values)


def _coarse(builder: Builder) -> HeightGrid:
    cell = builder.cells[COARSE]
    half = math.ceil(HALF_M / cell)
    return HeightGrid(builder.heights(COARSE, (-half, -half), (2 * half + 1, 2 * half + 1)), cell)


def _made(seed: int, length_m: float) -> Way:
    scenario, rng = Scenario.load('site', seed=seed), np.random.default_rng([seed, 67])
    builder = Builder(scenario.world.with_seed(seed))
    cell = builder.cells[_FINE]
    xy, yaw = _path(_coarse(builder), length_m, rng)
    middle = np.rint(0.5 * (xy.min(axis=0) + xy.max(axis=0)) / cell).astype(int)
    half = math.ceil((0.5 * float(np.ptp(xy, axis=0).max()) + _AROUND_M) / cell)
    first = int(middle[0]) - half, int(middle[1]) - half
    grid = HeightGrid(builder.heights(_FINE, first, (2 * half + 1, 2 * half + 1)), cell,
                      (float(middle[0] * cell), float(middle[1] * cell)))
    rocks = _rocks(builder, grid)
    apart, _ = cKDTree(xy).query(rocks.position_m[:, :2])
    rocks = rocks.select(apart > _ROOM_M + 0.5 * rocks.diameter_m)
    relief = grid.heights_m.copy()
    add_domes(relief, cell, first, rocks)
    sun = scenario.render_node.sun
    dark = shadow(relief, cell, sun.azimuth_deg, sun.elevation_deg)
    rig = StereoRig(scenario.rover, scenario.render_node.camera)
    poses, seen = [], np.full((len(xy), CORNERS, 3), np.nan)
    for k, (place, turn) in enumerate(zip(xy, yaw)):
        T = _standing(grid, place, turn, scenario.rover.standing_height_m, rng)
        points = _look(relief, dark, grid, rig, T, rng)
        seen[k, :len(points)] = points
        poses.append(T)
    return Way(np.array(poses), seen, rig.T_base_left)


def _rocks(builder: Builder, grid: HeightGrid) -> Rocks:
    world, box = builder.config, grid.box_m
    config = world.rocks
    craters = builder.reaching(rockfield.known_around(config, box),
                               rockfield.least_crater_m(_LEAST_ROCK_M))
    found = rockfield.population(config, world.seed, box, craters,
                                 world.clear_radius_m, _LEAST_ROCK_M)
    some = found.select(rockfield.size_classes(config)[found.size] >= _LEAST_ROCK_M)
    return rockfield.laid(config, grid, shapes.library(), some)


def _look(relief: Array, dark: Array, grid: HeightGrid, rig: StereoRig, T_world_base: Array,
          rng: np.random.Generator) -> Array:
    """Return the points (n, 3) of lit ground that pixels drawn at random see, in the camera."""
    T, first = T_world_base @ rig.T_base_left, (grid.box_m[0], grid.box_m[2])
    width, height = rig.width, rig.height
    pixel = np.column_stack([rng.uniform(0, width, CORNERS), rng.uniform(0, height, CORNERS),
                             np.ones(CORNERS)])
    rays = pixel @ np.linalg.inv(rig.K).T
    depth = np.arange(_NEAR_M, _RANGE_M, _MARCH_M)
    place = T[:3, 3] + (depth[:, None, None] * rays) @ T[:3, :3].T
    over = place[..., 2] - bilinear(relief, first, grid.cell_m, place[..., :2])
    met = np.argmax(over < 0.0, axis=0)
    ray = np.flatnonzero(met > 0)
    after = met[ray]
    high, low = over[after - 1, ray], over[after, ray]
    depth = depth[after - 1] + _MARCH_M * high / (high - low)
    hit = T[:3, 3] + (depth[:, None] * rays[ray]) @ T[:3, :3].T
    column, row = np.clip(np.rint((hit[:, :2] - first) / grid.cell_m), 0, grid.n - 1).astype(int).T
    good = ~dark[row, column] & (rng.random(len(ray)) > UNMATCHED)
    scale = rig.focal_px * rig.baseline_m
    disparity = scale / depth[good] + ERROR_PX * rng.standard_normal(int(good.sum()))
    wrong = rng.random(len(disparity)) < WRONG
    disparity[wrong] += rng.uniform(-WRONG_PX, WRONG_PX, int(wrong.sum()))
    seen = disparity > _LEAST_PX
    return np.asarray(rays[ray[good]][seen] * (scale / disparity[seen])[:, None])


def _path(grid: HeightGrid, length_m: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return places (n, 2) and headings (n,) of a way."""
    place, course, wish = np.zeros(2), rng.uniform(-math.pi, math.pi), 0.0
    yaw = course
    places, yaws = [], []
    turns = np.radians(np.linspace(-40.0, 40.0, 17))
    ahead = np.arange(0.5, 6.1, 0.5)
    for _ in range(round(length_m / STEP_M)):
        places.append(place.copy())
        yaws.append(yaw)
        wish = 0.97 * wish + 0.1 * rng.standard_normal()
        angles = yaw + turns
        looked = place + ahead[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
        z = grid.height_at(looked)
        slope = np.abs(np.diff(z, axis=0)).max(axis=0) / STEP_M
        off = np.angle(np.exp(1j * (angles - course - wish)))
        cost = np.abs(off) + 20.0 * np.maximum(slope - _STEEP, 0.0)
        yaw += 0.3 * float(turns[int(np.argmin(cost))])
        place = place + STEP_M * np.array([math.cos(yaw), math.sin(yaw)])
    return np.array(places), np.array(yaws)


def _standing(grid: HeightGrid, place: Array, yaw: float, height_m: float,
              rng: np.random.Generator) -> Array:
    """Return the pose of a rover on the ground, which wobbles as it walks."""
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-ahead[1], ahead[0]])

    def slope(direction: Array) -> float:
        before, after = grid.height_at(place + np.array([[-0.3], [0.3]]) * direction)
        return math.atan2(float(after - before), 0.6)

    pitch, roll = -slope(ahead), slope(left)
    wobble = _WOBBLE_RAD * rng.standard_normal(2)
    R = matrix_from_wxyz(wxyz_from_rpy(roll + wobble[0], pitch + wobble[1], yaw))
    return se3(R, [*place, float(grid.height_at(place)) + height_m])
