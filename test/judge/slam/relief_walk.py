"""A walk over rough ground whose relief is seen, and maps of that ground as from orbit."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import functools

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.shade import shaded
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.graph.pose_graph import PoseGraph

_HALF_M, _CELL_M = 160.0, 0.5
_STEP_M = 0.5
# Camera axes (right, down, ahead) in base.
T_BASE_LEFT = se3([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 0.3])


@functools.lru_cache
def heights(seed: int) -> Array:
    """Return (n, n) heights, row 0 south: waves of several lengths, as high as they are long."""
    rng = np.random.default_rng(seed)
    n, total = round(2 * _HALF_M / _CELL_M), 0.0
    for length_m in (2.0, 4.0, 8.0, 16.0, 32.0):
        waves = gaussian_filter(rng.standard_normal((n, n)), length_m / _CELL_M)
        total = total + 0.03 * length_m * waves / waves.std()
    return np.asarray(total)


def height_at(seed: int, xy_m: Array) -> Array:
    """Return heights at (..., 2) places."""
    place = (np.asarray(xy_m) + _HALF_M) / _CELL_M - 0.5
    found = map_coordinates(heights(seed), np.atleast_2d(place).T[::-1], order=1)
    return np.asarray(found.reshape(place.shape[:-1]))


def _means(values: Array, pixel_m: float) -> Array:
    factor = round(pixel_m / _CELL_M)
    rows = len(values) // factor
    return np.asarray(values.reshape(rows, factor, rows, factor).mean(axis=(1, 3)))


def with_photo(orbital: OrbitalMap, seed: int) -> OrbitalMap:
    """Return a map with a photo of the ground of a seed, of 1 m a pixel."""
    config = dataclasses.replace(orbital.config, photo_pixel_m=1.0)
    light = shaded(heights(seed).astype(np.float32), _CELL_M, config.sun_azimuth_deg,
                   config.sun_elevation_deg)
    first = -_HALF_M + 0.5 * config.photo_pixel_m
    photo = np.clip(230.0 * _means(light, config.photo_pixel_m), 1.0, 255.0).astype(np.uint8)
    return dataclasses.replace(orbital, config=config, photo=photo, photo_first_m=(first, first))


def orbital(seed: int) -> OrbitalMap:
    """Return a map of 2 m a pixel with the errors that it states."""
    config = OrbitalConfig(photo_pixel_m=0.0, bias_stddev_m=1.0, tilt_stddev_deg=0.0)
    mean = _means(heights(seed), config.pixel_m)
    rng = np.random.default_rng([seed, 1])
    # Filtered noise is alike by exp(-(d / 2 sigma)^2).
    error = gaussian_filter(rng.standard_normal(mean.shape),
                            0.5 * config.correlation_m / config.pixel_m)
    mean = mean + config.height_stddev_m * error / error.std() + rng.standard_normal()
    first = -_HALF_M + 0.5 * config.pixel_m
    return OrbitalMap(mean.astype(np.float32), (first, first),
                      MappedCraters(np.zeros((0, 2)), np.zeros(0)), np.zeros((0, 0), np.uint8),
                      (0.0, 0.0), config)


@dataclasses.dataclass
class Walk:
    """What became of it: by keyframe the news, the error (3,) in the site and what was told."""

    news: list[str]
    errors_m: list[Array]
    sigmas_m: list[float]       # largest horizontal standard deviation that is told


def walk(anchor: Anchor, start_m: Array, heading_rad: float, length_m: float, seed: int = 0,
         ground_of: Callable[[float], int] = lambda _way_m: 0) -> Walk:
    """Walk, and look at the map after each keyframe.

    Args:
        ground_of: Seed of the ground that is seen at a way; poses are those on the first one.
    """
    rng = np.random.default_rng([seed, 2])
    graph, found = PoseGraph(), Walk([], [], [])
    xy, before, drifted = np.array(start_m, float), np.eye(4), np.eye(4)
    origin = np.array([*xy, float(height_at(ground_of(0.0), xy))])
    anchor.begin(graph, True)
    for key in range(round(length_m / _STEP_M)):
        way = key * _STEP_M
        yaw = heading_rad + 0.5 * np.sin(way / 12.0)
        if key:
            xy = xy + _STEP_M * np.array([np.cos(yaw), np.sin(yaw)])
        true = np.array([*xy, float(height_at(ground_of(0.0), xy))])
        T = se3(matrix_from_wxyz(wxyz_from_rpy(0.0, 0.0, yaw)), true - origin)
        sigma = np.array([*3 * [1e-5], *3 * [0.01]])
        if key:
            moved = np.linalg.inv(before) @ T
            moved[:3, 3] += sigma[3:] * rng.standard_normal(3)
            drifted = drifted @ moved
            graph.add(key, drifted)
            graph.between(key - 1, key, moved, np.diag(sigma**2))
        else:
            drifted = T
            graph.add(0, T)
            graph.prior(0, T, 1e-10 * np.eye(6))
        graph.solve()
        before = T
        ahead = rng.uniform(0.7, 4.5, 120)
        seen = np.column_stack([ahead, ahead * rng.uniform(-0.6, 0.6, 120)])
        there = height_at(ground_of(way), xy + seen @ T[:2, :2].T) - true[2]
        points = np.column_stack([seen, there + 0.01 * ahead * rng.standard_normal(120)])
        anchor.add(key, graph.pose(key), (points - T_BASE_LEFT[:3, 3]) @ T_BASE_LEFT[:3, :3],
                   T_BASE_LEFT)
        found.news.append(anchor.look(graph))
        graph.solve()
        told, P = anchor.told(graph, key)
        R = told[:3, :3]
        found.errors_m.append(told[:3, 3] - true)
        found.sigmas_m.append(float(np.sqrt(np.linalg.eigvalsh(
            (R @ P[3:, 3:] @ R.T)[:2, :2])[-1])))
    return found
