"""The part of the ground that a rover has changed, as one fine grid for other tools."""

from __future__ import annotations

import dataclasses
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.world.export import FinePart
from lunar_rover_sim.ground.world.grid import HeightGrid

_MARGIN = 40                # samples of untouched ground around it
_MOST_SAMPLES = 6_000_000


@dataclasses.dataclass(frozen=True)
class GroundPatch(FinePart):
    """A rectangle around all that was changed, on every k-th sample of the overlay.

    Attributes:
        x_m, y_m: (nx,) and (ny,) positions.
        height_m: (ny, nx) height of the changed ground.
        change_m, compaction_m: (ny, nx) what was changed of it.
    """

    change_m: NDArray[np.float64]
    compaction_m: NDArray[np.float64]

    def around(self, middle_m: tuple[float, float]) -> GroundPatch:
        """Return it in a frame whose origin is a place."""
        return dataclasses.replace(self, x_m=self.x_m - middle_m[0], y_m=self.y_m - middle_m[1])


def changed_patch(ground: HeightGrid, overlay: Overlay) -> GroundPatch:
    """Return the patch of an overlay on its untouched ground.

    It is on samples of 5 mm, on coarser ones only beyond 6 million of them, and ends with the
    ground.

    Raises:
        WorldError: Where nothing was changed there.
    """
    changed = overlay.snapshot().index
    changed = changed[ground.contains(changed * CELL_M)]
    if not len(changed):
        raise WorldError('the ground is untouched at that time: there is no changed part')
    low, high = changed.min(axis=0) - _MARGIN, changed.max(axis=0) + _MARGIN + 1
    middle, half = np.array(ground.middle_m), ground.half_extent_m
    low = np.maximum(low, np.ceil((middle - half) / CELL_M - 1e-6).astype(int))
    high = np.minimum(high, np.floor((middle + half) / CELL_M + 1e-6).astype(int) + 1)
    nx, ny = (high - low).tolist()
    stride = math.ceil(math.sqrt(max(nx * ny / _MOST_SAMPLES, 1.0)))
    change, compaction = (values[::stride, ::stride]
                          for values in overlay.window(int(low[0]), int(low[1]), nx, ny))
    x, y = (np.arange(low[k], high[k], stride) * CELL_M for k in (0, 1))
    base = ground.height_at(np.stack(np.meshgrid(x, y), axis=-1))
    return GroundPatch(x, y, base + change, change, compaction)


def save_patch(patch: GroundPatch, path: Path) -> None:
    """Write a patch as a NumPy .npz file with its fields as arrays; WorldError if it cannot be."""
    content = io.BytesIO()
    np.savez_compressed(content, **{field.name: getattr(patch, field.name)
                                    for field in dataclasses.fields(patch)})
    atomic_write(path, content.getvalue(), WorldError)
