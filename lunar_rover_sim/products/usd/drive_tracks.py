"""The tracks of a drive on ground that gives: patches of 5 mm in place of the cells they lie in.

Where the rover changed the ground, blocks of ground cells leave their tile, and a fine mesh takes
their place whose points follow the recorded changes. Its border lies on the triangles of the cells
around it, so that no gap is seen. A patch has samples only where it changes: one at the frame
before, which holds what was, and one at the frame itself.

All of it is written for the resolution `full` of the ground, whose cells are those of the grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.messages import header_ns, imu_row, in_order, joint_order, xyz
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.series import Odometry, odometry_of, read_motion, Series
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, product_wxyz
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import CELL_M, GroundChanges
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.products.usd.ground import tile_cells, triangles
from lunar_rover_sim.products.usd.stage import (add_mesh, label, place, points, Sdf, set_faces,
                                                set_texels, Usd, UsdGeom)
from lunar_rover_sim.rover.description import Legs, RoverDescription


class DriveMotion(NamedTuple):
    """The motion of a rover; those of `others` that were recorded, by name.

    Attributes:
        odometry: Poses and twists of base_link.
        joints: (n, legs) leg angles [rad, unwrapped] at the stamps of the odometry.
        others: `joint_velocity` [rad/s], `joint_torque` [N m] and `joint_command` [rad/s] (n,
            legs); `imu` (n, 6) rates [rad/s] and specific forces [m/s2]; `contact/<leg>` (n, 3)
            force [N], world axes; `frames` (n, 0), the stamps of the images.
    """

    odometry: Odometry
    joints: Array
    others: dict[str, Series]

    @property
    def rate_hz(self) -> int:
        """State rate [Hz], from the median interval."""
        steps = np.diff(self.odometry.stamps_ns)
        return round(NS_PER_S / float(np.median(steps))) if len(steps) else 1


def motion_of(bag: Bag, legs: Legs) -> DriveMotion:
    """Return the motion in a bag, which is read once; raise BagError where it holds no drive.

    Args:
        legs: Of the recorded rover, for the order of the values.
    """
    contacts = topics.of_legs([topics.CONTACT], legs.names)
    found = read_motion(bag, legs, {
        topics.JOINT_COMMANDS.name:
            lambda m: in_order(m.velocity, joint_order(m, legs, bag.path)),
        topics.IMU_RAW.name: imu_row,
        **{topic.name: lambda m: xyz(m.wrench.force) for topic in contacts},
        topics.LEFT_INFO.name: lambda m: ()})
    odometry, states = odometry_of(found[bag.truth]), found[topics.JOINT_STATES.name]
    angles, velocity, torque = np.split(states.values, 3, axis=1)
    joints = np.stack([np.interp(odometry.stamps_ns, states.stamps_ns, angle)
                       for angle in angles.T], axis=-1)
    others = {'joint_velocity': Series(states.stamps_ns, velocity),
              'joint_torque': Series(states.stamps_ns, torque)}
    keys = {topics.JOINT_COMMANDS.name: 'joint_command', topics.IMU_RAW.name: 'imu',
            topics.LEFT_INFO.name: 'frames',
            **{topic.name: f'contact/{leg}' for leg, topic in zip(legs.names, contacts)}}
    others |= {key: found[name] for name, key in keys.items()
               if name in found and len(found[name].stamps_ns)}
    return DriveMotion(odometry, joints, others)


def link_motion(rover: RoverDescription, motion: DriveMotion) -> dict[str, tuple[Array, Array]]:
    """Return leg → positions (n, 3) and orientations_wxyz (n, 4) in the world."""
    odometry = motion.odometry
    rotation = matrix_from_wxyz(odometry.orientations_wxyz)
    result = {}
    for k, (leg, axle) in enumerate(zip(rover.legs.names, rover.legs.axle_positions_m())):
        half = 0.5 * motion.joints[:, k]
        zero = np.zeros_like(half)
        turn = np.stack([np.cos(half), zero, np.sin(half), zero], axis=-1)
        result[leg] = (odometry.positions_m + rotation @ np.asarray(axle, float),
                       product_wxyz(odometry.orientations_wxyz, turn))
    return result


def continuous(orientations_wxyz: Array) -> Array:
    """Return the same (n, 4) rotations with signs that do not jump, for interpolation."""
    flips = np.sum(orientations_wxyz[1:] * orientations_wxyz[:-1], axis=1) < 0.0
    sign = np.where(np.cumsum(np.concatenate([[False], flips])) % 2, -1.0, 1.0)
    return orientations_wxyz * sign[:, None]


TRACKS = 'tracks'
RESOLUTION = 'resolution', 'full'
_PATCH_CELLS = 4        # of the ground, along a side; less where tiles are not a multiple of it


class FrameOfGround(NamedTuple):
    """What has changed of the ground since the frame before."""

    stamp_ns: int
    changes: GroundChanges

    def around(self, middle_m: tuple[float, float]) -> FrameOfGround:
        """Return it in a frame whose origin is a place."""
        moved = np.rint(np.array(middle_m) / CELL_M).astype(self.changes.index.dtype)
        return self._replace(changes=dataclasses.replace(
            self.changes, index=self.changes.index - moved))


def read_ground_changes(bag: Bag) -> list[FrameOfGround]:
    """Return the changes of the ground in a bag; none where it was rigid."""
    if not bag.has(topics.GROUND_CHANGES.name):
        return []
    return [FrameOfGround(header_ns(message), changes_of(message))
            for _, _, message in bag.messages([topics.GROUND_CHANGES.name])]


def can_hold_tracks(grid: HeightGrid) -> bool:
    """Return whether samples of the overlay lie on those of a grid."""
    ratio = grid.cell_m / CELL_M
    return bool(abs(ratio - round(ratio)) < 1e-6 and round(ratio) >= 1 and grid.n % 2)


class _Patches:
    """How samples of the overlay, cells of the ground, patches and tiles lie to one another."""

    def __init__(self, grid: HeightGrid) -> None:
        self.grid = grid
        self.samples = round(grid.cell_m / CELL_M)      # along a cell
        self.tile = tile_cells(grid.n - 1)
        self.cells = next(k for k in (_PATCH_CELLS, 2, 1) if self.tile % k == 0)
        self.side = self.cells * self.samples           # samples along a patch
        self.corner = -self.samples * (grid.n - 1) // 2     # index of the grid's first sample

    def touched(self, index: NDArray[np.int32]) -> list[tuple[int, int]]:
        """Return (column, row) of the patches that hold samples; on a border those of both sides.
        """
        there = index.astype(np.int64) - self.corner
        found = np.concatenate([(there - np.array(shift)) // self.side
                                for shift in ((0, 0), (0, 1), (1, 0), (1, 1))])
        count = (self.grid.n - 1) // self.cells
        inside = np.all((found >= 0) & (found < count), axis=1)
        return [(int(c), int(r)) for c, r in np.unique(found[inside], axis=0)]

    def first_sample(self, patch: tuple[int, int]) -> NDArray[np.int64]:
        """Return ix and iy of the south-western sample of a patch."""
        return np.array(patch) * self.side + self.corner


class _Patch:
    """The surface of a patch over time; its middle is the origin of its points."""

    def __init__(self, patches: _Patches, patch: tuple[int, int]) -> None:
        n = patches.side + 1
        self.first = patches.first_sample(patch)
        x = (self.first[0] + np.arange(n)) * CELL_M
        y = (self.first[1] + np.arange(n)) * CELL_M
        self.xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self.middle = self.xy.mean(axis=0)
        self.base = patches.grid.height_at(np.clip(
            self.xy, -patches.grid.half_extent_m, patches.grid.half_extent_m))
        self.height = np.zeros((n, n))
        self.samples: list[tuple[float, NDArray[np.float64]]] = []

    def points(self, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (n n, 3) points with these changes of height."""
        return np.column_stack([self.xy - self.middle, self.base + height.ravel()])

    def change(self, before: float, code: float, changes: GroundChanges) -> None:
        """Take the changes at a time code; `before` is that of the frame before."""
        there = changes.index - self.first
        inside = np.all((there >= 0) & (there < len(self.height)), axis=1)
        if not self.samples or self.samples[-1][0] < before:
            self.samples.append((before, self.height.copy()))
        self.height[there[inside, 1], there[inside, 0]] = changes.height_m[inside]
        self.samples.append((code, self.height.copy()))


def write_tracks(stage: Usd.Stage, ground: Sdf.Path, grid: HeightGrid,
                 frames: Sequence[FrameOfGround], code_of: Callable[[int], float]) -> bool:
    """Write the tracks below the prim of the ground; return whether there are any.

    It is written where the stage's edit target is; code_of: stamp [ns] → time code. A grid that
    cannot hold tracks has none.
    """
    if not frames or not can_hold_tracks(grid):
        return False
    patches = _Patches(grid)
    found: dict[tuple[int, int], _Patch] = {}
    before = code_of(0)
    for frame in frames:
        code = code_of(frame.stamp_ns)
        for key in patches.touched(frame.changes.index):
            found.setdefault(key, _Patch(patches, key)).change(before, code, frame.changes)
        before = code
    if not found:
        return False
    area = stage.OverridePrim(ground)
    name, resolution = RESOLUTION
    variants = area.GetVariantSets().AddVariantSet(name)
    variants.AddVariant(resolution)
    variants.SetVariantSelection(resolution)
    with variants.GetVariantEditContext():
        _cut_tiles(stage, ground, patches, list(found))
        group = UsdGeom.Xform.Define(stage, ground.AppendChild(TRACKS)).GetPath()
        faces = triangles(patches.side + 1)
        for (column, row), patch in sorted(found.items()):
            _add_patch(stage, group.AppendChild(f'patch_{row}_{column}'), patches, patch, faces)
    variants.ClearVariantSelection()    # the reader's choice
    return True


def _add_patch(stage: Usd.Stage, path: Sdf.Path, patches: _Patches, patch: _Patch,
               faces: NDArray[np.int64]) -> None:
    mesh = add_mesh(stage, path, patch.points(patch.samples[0][1]), faces)
    place(mesh.GetPrim(), [*patch.middle, 0.0])
    heights = np.array([height.ravel() for _, height in patch.samples])
    for (code, _), height in zip(patch.samples, heights):
        mesh.GetPointsAttr().Set(points(patch.points(height)), code)
    xyz = patch.points(np.zeros_like(patch.height))
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    low[2], high[2] = (patch.base + heights).min(), (patch.base + heights).max()
    mesh.GetExtentAttr().Set(points([low, high]))
    grid = patches.grid
    texel = (patch.xy / grid.cell_m + 0.5 * grid.n) / grid.n    # as the ground has them
    set_texels(mesh, texel)
    label(mesh.GetPrim(), 'ground')


def _cut_tiles(stage: Usd.Stage, ground: Sdf.Path, patches: _Patches,
               keys: list[tuple[int, int]]) -> None:
    """Take the cells of the patches out of their tiles."""
    per_tile = patches.tile // patches.cells
    tiles: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for column, row in keys:
        tiles.setdefault((column // per_tile, row // per_tile), []).append(
            (column % per_tile, row % per_tile))
    faces = triangles(patches.tile + 1)
    cell = np.arange(patches.tile)
    for (column, row), inside in sorted(tiles.items()):
        cut = np.zeros((patches.tile, patches.tile), bool)
        for c, r in inside:
            cut[np.ix_(cell // patches.cells == r, cell // patches.cells == c)] = True
        prim = stage.OverridePrim(ground.AppendChild(f'tile_{row:02d}_{column:02d}'))
        set_faces(UsdGeom.Mesh(prim), faces[~np.repeat(cut.ravel(), 2)])
