"""Rocks as convex hulls: where rays meet them, and which cells of the ground they stand over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, matrix_from_wxyz
from lunar_rover_sim.world.rocks import Rocks, RockShape

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_NEVER = -1e6               # height of what is nowhere
_MERGED = 1e-5              # normals and offsets of faces that count as one plane


class RockHulls:
    """The planes n . x = d of all shapes, padded to the same number; d is 1 for padding, n is 0.

    rocks: as given; radius_m: (m,) of balls around their centroids
    """

    def __init__(self, rocks: Rocks, shapes: tuple[RockShape, ...]) -> None:
        self.rocks = rocks
        planes = [_planes(shape) for shape in shapes]
        most = max((len(p) for p in planes), default=1)
        self._normals = np.zeros((len(shapes), most, 3))
        self._offsets = np.ones((len(shapes), most))
        for k, plane in enumerate(planes):
            self._normals[k, :len(plane)], self._offsets[k, :len(plane)] = plane[:, :3], \
                plane[:, 3]
        reach = np.array([np.linalg.norm(s.vertices, axis=1).max() for s in shapes] or [1.0])
        self._R = (matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks)
                   else np.zeros((0, 3, 3)))
        self._diameter_m = rocks.diameter_m
        self.radius_m: Array = reach[rocks.shape] * self._diameter_m

    def meet(self, rock: NDArray[np.integer], origin_m: Array,
             direction: Array) -> tuple[Array, Array]:
        """Return where rays enter rocks, and the normals there.

        rock: (m,) rock of each ray; origin_m, direction: (m, 3) world frame, unit length
        Returns (m,) distances [m], inf without a hit or with an origin inside, and (m, 3) outward
        unit normals, world frame.
        """
        distance, normal = np.full(len(rock), np.inf), np.zeros((len(rock), 3))
        if not len(rock):
            return distance, normal
        # Rays that miss the ball around a rock need no planes.
        rocks = self.rocks
        away = rocks.position_m[rock] - origin_m
        along = np.einsum('ij,ij->i', away, direction)
        miss2 = np.einsum('ij,ij->i', away, away) - along * along
        near = np.flatnonzero((miss2 < self.radius_m[rock] ** 2) & (along > 0.0))
        # One product of matrices for each shape is much faster than one of gathered planes.
        near = near[np.argsort(rocks.shape[rock[near]], kind='stable')]
        shape = rocks.shape[rock[near]]
        bounds = np.flatnonzero(np.diff(shape)) + 1
        for chosen in np.split(near, bounds):
            if not len(chosen):
                continue
            which = rock[chosen]
            R, size = self._R[which], self._diameter_m[which, None]
            start = np.einsum('mij,mi->mj', R, -away[chosen]) / size
            ray = np.einsum('mij,mi->mj', R, direction[chosen])
            kind = rocks.shape[which[0]]
            N = self._normals[kind]
            speed = ray @ N.T
            gap = self._offsets[kind] - start @ N.T     # < 0: outside that plane
            with np.errstate(divide='ignore', invalid='ignore'):
                at = gap / speed
            enter = np.where(speed < 0.0, at, -np.inf)
            leave = np.where(speed > 0.0, at, np.inf)
            # Parallel to a plane, and outside it.
            leave[(speed == 0.0) & (gap < 0.0)] = -np.inf
            face = enter.argmax(axis=1)
            first = enter[np.arange(len(chosen)), face]
            hit = (first <= leave.min(axis=1)) & (first > 0.0)
            distance[chosen[hit]] = (first * size[:, 0])[hit]
            normal[chosen[hit]] = np.einsum('mij,mj->mi', R[hit], N[face[hit]])
        return distance, normal

    def tops(self, rock: int, x_m: Array, y_m: Array, half_m: float) -> Array:
        """Return an upper bound of a rock's height [m] over square cells, -1e6 beside it.

        x_m: (c,), y_m: (r,) centres of the cells; half_m: half their side; the result is (r, c)
        """
        rocks, kind = self.rocks, self.rocks.shape[rock]
        N = self._normals[kind] @ self._R[rock].T
        D = self._offsets[kind] * self._diameter_m[rock] + N @ rocks.position_m[rock]
        D = np.where(self._normals[kind].any(axis=1), D, np.inf)
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
        return np.where(beside, _NEVER, top)


def _planes(shape: RockShape) -> Array:
    """Return (p, 4) planes n . x = d of a convex shape, each once."""
    corners = shape.vertices[shape.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal, corners = normal[length > 0.0] / length[length > 0.0, None], corners[length > 0.0]
    plane = np.column_stack([normal, np.einsum('ij,ij->i', normal, corners[:, 0])])
    _, first = np.unique(np.round(plane / _MERGED), axis=0, return_index=True)
    return plane[np.sort(first)]
