"""Rocks as convex hulls: their planes, and how high they are over cells of the ground."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.compiled import read_only
from lunar_rover_sim.frames import Array, matrix_from_wxyz
from lunar_rover_sim.lidar.ray_arrays import RockArrays
from lunar_rover_sim.world.rocks import Rocks, RockShape

_MERGED = 1e-5              # normals and offsets of faces that count as one plane


class RockHulls:
    """The planes of all rocks.

    rocks: as given; radius_m: (m,) of balls around their centroids; arrays: for rays
    """

    NOWHERE_M = -1e6        # height of what is not there

    def __init__(self, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
        self.rocks = rocks
        self._planes = [_planes(shape) for shape in shapes]
        reach = np.array([np.linalg.norm(s.vertices, axis=1).max() for s in shapes] or [1.0])
        self._R = (matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks)
                   else np.zeros((0, 3, 3)))
        self.radius_m: Array = reach[rocks.shape] * rocks.diameter_m
        counts = [len(planes) for planes in self._planes]
        self.arrays = RockArrays(
            position_m=read_only(rocks.position_m, float), radius_m=self.radius_m,
            R_world_rock=np.ascontiguousarray(self._R), diameter_m=rocks.diameter_m,
            shape=read_only(rocks.shape, np.int32),
            planes=np.concatenate([np.zeros((0, 4)), *self._planes]),
            plane_first=np.cumsum([0, *counts]))

    def tops(self, rock: int, x_m: Array, y_m: Array, half_m: float) -> Array:
        """Return an upper bound of a rock's height [m] over square cells, NOWHERE_M beside it.

        x_m: (c,), y_m: (r,) centres of the cells; half_m: half their side; the result is (r, c)
        """
        rocks, kind = self.rocks, self.rocks.shape[rock]
        N = self._planes[kind][:, :3] @ self._R[rock].T
        D = self._planes[kind][:, 3] * rocks.diameter_m[rock] + N @ rocks.position_m[rock]
        # Over a cell, the part of n . x that x and y can take away at most.
        slack = half_m * np.abs(N[:, :2]).sum(axis=1)
        level = (N[:, 0, None, None] * x_m + N[:, 1, None, None] * y_m[:, None])
        room = D[:, None, None] - level + slack[:, None, None]
        with np.errstate(divide='ignore', invalid='ignore'):
            height = room / N[:, 2, None, None]
        above = N[:, 2] > 1e-9
        below = N[:, 2] < -1e-9
        top = height[above].min(axis=0)
        foot = height[below].max(axis=0) if below.any() else np.full(top.shape, -np.inf)
        beside = (room[~above & ~below] < 0.0).any(axis=0) | (foot > top)
        return np.where(beside, self.NOWHERE_M, top)


def _planes(shape: RockShape) -> Array:
    """Return (p, 4) planes n . x = d of a convex shape, each once."""
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal, corners = normal[length > 0.0] / length[length > 0.0, None], corners[length > 0.0]
    plane = np.column_stack([normal, np.einsum('ij,ij->i', normal, corners[:, 0])])
    _, first = np.unique(np.round(plane / _MERGED), axis=0, return_index=True)
    return plane[np.sort(first)]
