"""Prints in the overlay, compiled: round tips press them in, and their walls slide.

What the underside of a ball displaces on its way leaves the samples that it covers. A part is
compacted there. The rest makes a rim on the samples around, more of it where the tip moves to. A
sample gets none where the ball presses, and all of its share once it is clear of the ball by
`CLEAR_M`: so a print is a continuous function of the way.

Disturbed soil slides until no slope is steeper than its angle of repose: between neighbouring
samples (eight around each) a part of the excess of height over the distance times tan(repose)
moves down, as in the erosion of Chrono's deformable terrain (SCM), one direction of neighbours
after the other. Where the untouched ground is as steep as that, everything holds: what falls there
would run on without end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.regolith.law import height_on, Heights
from lunar_rover_sim.ground.regolith.overlay import CELL_M, NearTiles, Overlay, TILE
from lunar_rover_sim.ground.world.grid import HeightGrid

RIM_RADII = 1.2         # width of a fresh rim, before it slides
CLEAR_M = 0.001
TOLERANCE_DEG = 0.8     # of the slope that is left
SLIDE_S = 0.1           # time after which walls slide, for all prints of a leg at once
WIDEST = 40             # samples of such prints, along one side
SPREAD = 4              # samples around them to which their walls mostly slide
_SWEEPS, _MOST_SWEEPS = 32, 384     # from one check whether soil still slides to the next; most
_GROW, _OVER_EDGE_M = 6, 2e-4    # samples by which a window grows where so much runs over its edge

Point = Sequence[float]     # x, y, z
Window = tuple[int, int, int, int]


def press(overlay: Overlay, ground: HeightGrid, start: Point, end: Point, radius_m: float,
          compacted: float) -> Window:
    """Press a ball into the ground, swept from one place of its centre to another.

    Args:
        overlay: the changes, which are written to.
        ground: the untouched ground.
        start, end: centres, world frame [m].
        radius_m: of the ball.
        compacted: part of the displaced volume that is compacted, 0 to 1.

    Returns:
        The window of samples that may have changed: ix, iy, nx, ny.
    """
    reach = (1.0 + RIM_RADII) * radius_m
    ix = math.floor((min(start[0], end[0]) - reach) / CELL_M)
    iy = math.floor((min(start[1], end[1]) - reach) / CELL_M)
    nx = math.ceil((max(start[0], end[0]) + reach) / CELL_M) - ix + 1
    ny = math.ceil((max(start[1], end[1]) + reach) / CELL_M) - iy + 1
    tiles = overlay.reserve(ix, iy, nx, ny)
    pressed, overlay.residue_m = _press(
        ix, iy, nx, ny, *start, *end, radius_m, compacted, overlay.residue_m,
        Heights.of(ground), overlay.near, overlay.changed)
    if pressed:
        overlay.note_writes(tiles)
    return ix, iy, nx, ny


def relax(overlay: Overlay, ground: HeightGrid, window: Window, repose_deg: float) -> None:
    """Let a window of samples slide; it grows where soil runs over its edge."""
    ix, iy, nx, ny = window
    slope = math.tan(math.radians(repose_deg))
    more = math.tan(math.radians(repose_deg + TOLERANCE_DEG)) - slope
    while True:
        base = heights(ground, ix, iy, nx, ny)
        change, compaction = overlay.window(ix, iy, nx, ny)
        slid = np.zeros((ny, nx))
        moved, over_edge = _slide(base, change, slid, slope, more)
        if not over_edge:
            break
        ix, iy, nx, ny = ix - _GROW, iy - _GROW, nx + 2 * _GROW, ny + 2 * _GROW
    if moved:
        # Its sum is 0 but for rounding, which goes to the residue.
        overlay.residue_m -= float(slid.sum())
        overlay.put(ix, iy, change + slid, compaction)


def heights(ground: HeightGrid, ix: int, iy: int, nx: int, ny: int) -> Array:
    """Return the (ny, nx) heights [m] of the untouched ground on samples; NaN beyond it."""
    found = np.empty((ny, nx))
    _heights(found, ix, iy, Heights.of(ground))
    return found


def hull(one: Window, other: Window) -> Window:
    """Return the smallest window that holds both."""
    ix, iy = min(one[0], other[0]), min(one[1], other[1])
    return (ix, iy, max(one[0] + one[2], other[0] + other[2]) - ix,
            max(one[1] + one[3], other[1] + other[3]) - iy)


class WallSlides:
    """Windows of prints whose walls are to slide, per leg, and the step at which they do."""

    def __init__(self, ground: HeightGrid, repose_deg: float, step_s: float, legs: int) -> None:
        self.ground = ground        # another one in another window
        self._repose_deg = repose_deg
        self._delay = round(SLIDE_S / step_s)
        self._waiting: list[Window | None] = [None] * legs
        self._due = [0] * legs
        self.next_step = math.inf       # at which `slide_due` has anything to do

    def add(self, overlay: Overlay, leg: int, window: Window, step: int) -> None:
        """Let the walls in a window slide soon, with those of the same leg."""
        waiting = self._waiting[leg]
        if waiting is not None:
            both = hull(waiting, window)
            if max(both[2:]) <= WIDEST:
                self._waiting[leg] = both
                return
            self._slide(overlay, leg)
        self._waiting[leg] = window
        self._due[leg] = step + self._delay
        self.next_step = min(self.next_step, self._due[leg])

    def slide_due(self, overlay: Overlay, step: int) -> None:
        """Let walls slide whose time has come."""
        for leg, due in enumerate(self._due):
            if self._waiting[leg] is not None and due <= step:
                self._slide(overlay, leg)
        self.next_step = min((due for leg, due in enumerate(self._due)
                              if self._waiting[leg] is not None), default=math.inf)

    def slide_all(self, overlay: Overlay) -> None:
        """Let all walls slide now."""
        for leg in range(len(self._due)):
            self._slide(overlay, leg)
        self.next_step = math.inf

    def forget(self) -> None:
        """Forget the walls that were to slide."""
        self._waiting = [None] * len(self._due)
        self.next_step = math.inf

    def state(self) -> dict[str, Any]:
        """Return which walls are to slide, and when."""
        return {'waiting': list(self._waiting), 'due': list(self._due), 'next': self.next_step}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Wait for what `state` has returned."""
        self._waiting, self._due = list(state['waiting']), list(state['due'])
        self.next_step = state['next']

    def _slide(self, overlay: Overlay, leg: int) -> None:
        window = self._waiting[leg]
        if window is not None:
            ix, iy, nx, ny = window
            relax(overlay, self.ground,
                  (ix - SPREAD, iy - SPREAD, nx + 2 * SPREAD, ny + 2 * SPREAD), self._repose_deg)
            self._waiting[leg] = None


@compiled
def _heights(found: np.ndarray, ix: int, iy: int, ground: Heights) -> None:
    for j in range(found.shape[0]):
        for i in range(found.shape[1]):
            found[j, i] = height_on(ground, (ix + i) * CELL_M, (iy + j) * CELL_M)


@compiled
def _press(ix: int, iy: int, nx: int, ny: int, x: float, y: float, z: float, end_x: float,
           end_y: float, end_z: float, radius: float, compacted: float, residue: float,
           ground: Heights, near: NearTiles, changed: np.ndarray) -> tuple[bool, float]:
    """Press a ball that goes from (x, y, z) to its end into a window, all tiles of which exist.

    Returns:
        Whether anything was pressed, and the residue of rounding [m].
    """
    slots, origin, samples = near.slots, near.origin, near.samples
    way_x, way_y, way_z = end_x - x, end_y - y, end_z - z
    length = math.hypot(way_x, way_y)
    taken, weight = np.zeros((ny, nx)), np.zeros((ny, nx))
    taken_sum = weight_sum = 0.0
    for j in range(ny):
        for i in range(nx):
            base = height_on(ground, (ix + i) * CELL_M, (iy + j) * CELL_M)
            if math.isnan(base):    # beyond the ground there is nothing to press
                continue
            # Offset from the nearest place on the way.
            dx, dy = (ix + i) * CELL_M - x, (iy + j) * CELL_M - y
            along = 1.0
            if length > 0.0:
                along = min(max((dx * way_x + dy * way_y) / (length * length), 0.0), 1.0)
            dx, dy = dx - along * way_x, dy - along * way_y
            distance = math.hypot(dx, dy)
            clear = 1.0
            if distance < radius:
                tx, ty = (ix + i) // TILE, (iy + j) // TILE
                tile = slots[ty - origin[1], tx - origin[0]]
                surface = base + samples[tile, 0, iy + j - ty * TILE, ix + i - tx * TILE]
                into = surface - (z + along * way_z
                                  - math.sqrt(radius * radius - distance * distance))
                if into > 0.0:
                    taken[j, i] = into
                    taken_sum += into
                    continue
                clear = min(-into / CLEAR_M, 1.0)
            rim = max(0.0, 1.0 - distance / ((1.0 + RIM_RADII) * radius)) * clear
            if length > 0.0 and distance > 0.0:
                rim *= 1.0 + ((dx * way_x + dy * way_y) / (distance * length)
                              * min(1.0, length / CELL_M))
            weight[j, i] = rim
            weight_sum += rim
    if taken_sum == 0.0:
        return False, residue
    # A print at the very border of the world may have no room for a rim: it is compacted then.
    part, aside = 1.0, 0.0
    if weight_sum > 0.0:
        part = compacted
        aside = (taken_sum - part * taken_sum + residue) / weight_sum
        residue = 0.0
    for j in range(ny):
        for i in range(nx):
            if taken[j, i] == 0.0 and weight[j, i] == 0.0:
                continue
            tx, ty = (ix + i) // TILE, (iy + j) // TILE
            tile = slots[ty - origin[1], tx - origin[0]]
            row, column = iy + j - ty * TILE, ix + i - tx * TILE
            change = samples[tile, 0, row, column] + (weight[j, i] * aside - taken[j, i])
            compaction = samples[tile, 1, row, column] + part * taken[j, i]
            samples[tile, 0, row, column] = change
            samples[tile, 1, row, column] = compaction
            changed[tile, row, column] = True
            residue += (change - samples[tile, 0, row, column]
                        + compaction - samples[tile, 1, row, column])
    return True, residue


@compiled
def _slide(base: np.ndarray, change: np.ndarray, slid: np.ndarray, slope: float,
           more: float) -> tuple[bool, bool]:
    """Let a window slide; `slid` becomes what each sample gains.

    Half of the tolerance is where soil comes to rest; it is looked after many sweeps whether all
    slopes are within the tolerance, so that this hardly ever depends on the last digits.

    Returns:
        Whether anything slid, and whether soil came to the edge of the window.
    """
    ny, nx = base.shape
    level = base[ny // 2, nx // 2]
    if math.isnan(level):
        level = 0.0
    step = np.zeros((ny, nx))
    moved = False
    for sweep in range(1, _MOST_SWEEPS + 1):
        steepest = 0.0      # excess over what holds, in tolerances
        for di, dj in ((1, 0), (0, 1), (1, 1), (-1, 1)):
            way = CELL_M * math.hypot(di, dj)
            held, tolerance = slope * way, more * way
            any_step = False
            for j in range(ny - dj):
                for i in range(max(0, -di), nx - max(0, di)):
                    step[j, i] = 0.0
                    lower, upper = base[j, i], base[j + dj, i + di]
                    if not abs(upper - lower) < held:   # nor beyond the ground: NaN
                        continue
                    rise = ((upper - level) - (lower - level) + change[j + dj, i + di]
                            - change[j, i] + slid[j + dj, i + di] - slid[j, i])
                    excess = abs(rise) - held
                    steepest = max(steepest, excess / tolerance)
                    if excess > 0.5 * tolerance:
                        step[j, i] = math.copysign(0.45 * (excess - 0.5 * tolerance), rise)
                        any_step = True
            if any_step:
                moved = True
                for j in range(ny - dj):
                    for i in range(max(0, -di), nx - max(0, di)):
                        slid[j + dj, i + di] -= step[j, i]
                        slid[j, i] += step[j, i]
        if not moved:
            return False, False
        if sweep % _SWEEPS == 0 or steepest <= 0.5:
            at_edge = max(np.abs(slid[0]).max(), np.abs(slid[-1]).max(),
                          np.abs(slid[:, 0]).max(), np.abs(slid[:, -1]).max())
            if at_edge > _OVER_EDGE_M:
                return True, True
            if steepest <= 1.0:
                break
    return True, False
