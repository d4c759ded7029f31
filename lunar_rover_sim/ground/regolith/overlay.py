"""Changes of the ground by the rover: height and compaction on a sparse fine grid.

The sample (ix, iy) lies at x = 5 mm ix, y = 5 mm iy; whole numbers, 0 at the origin of the world.
Samples exist in tiles of 20 x 20 (10 cm) around what was touched; elsewhere both values are 0.
Larger tiles would hold more of what is not touched: a track is 2 to 4 cm wide.

Height change [m] is added to the height of the untouched world. Compaction [m] is the height that
a column of soil has lost by being pressed together: heights and compaction add up to 0 over the
whole overlay, but for the rounding to float32, which `residue_m` carries on to the next change.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

CELL_M = 0.005
TILE = 20
TileKey = tuple[int, int]
_MARGIN = 16    # tiles by which the index grows beyond what was touched


@dataclasses.dataclass(frozen=True)
class GroundChanges:
    """Values of samples, absolute, so that the newest message on a sample is all that counts.

    Attributes:
        index: (n, 2) int32, ix and iy, sorted.
        height_m: (n,) float32.
        compaction_m: (n,) float32.
    """

    index: NDArray[np.int32]
    height_m: NDArray[np.float32]
    compaction_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.index)


@dataclasses.dataclass(frozen=True)
class _Tile:
    """Views of the samples of a tile in the pool, (TILE, TILE) each."""

    height: NDArray[np.float32]
    compaction: NDArray[np.float32]
    changed: NDArray[np.bool_]


class Overlay:
    """The changes of the ground; arrays are indexed [iy, ix] as those of a HeightGrid.

    Attributes:
        index: (rows, columns) int32, which tile of `samples` lies where; -1: none. Its first one
            is the tile `origin`.
        origin: (2,) tx and ty.
        samples: (tiles, 2, TILE, TILE) float32, height change and compaction [m].
        changed: (tiles, TILE, TILE) which samples have changed since `take_changes`.
        writes: number of writes.
        residue_m: what rounding to float32 has left of all changes [m].

    Compiled code reads and writes these arrays; a new tile may replace them.
    """

    def __init__(self) -> None:
        self.index = np.full((1, 1), -1, np.int32)
        self.origin = np.zeros(2, np.int64)
        self.samples = np.zeros((0, 2, TILE, TILE), np.float32)
        self.changed = np.zeros((0, TILE, TILE), bool)
        self._tiles: dict[TileKey, int] = {}
        self._dirty: set[TileKey] = set()
        # Tile → number of its last write, in the order of these.
        self._written: dict[TileKey, int] = {}
        self.writes = 0
        self.residue_m = 0.0

    # Reading

    def tiles_since(self, writes: int, side: int = TILE) -> list[TileKey]:
        """Return the tiles written since `self.writes` had a value; 0: all.

        Args:
            writes: that value.
            side: samples of a tile along one side, a multiple of TILE.

        Returns:
            Tiles (tx, ty), each once: the samples from (side tx, side ty) on.
        """
        tiles: dict[TileKey, None] = {}
        for (tx, ty), number in reversed(self._written.items()):
            if number <= writes:
                break
            tiles[tx * TILE // side, ty * TILE // side] = None
        return list(tiles)

    def height_change(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the height change [m] at (..., 2) positions [m], bilinear between samples."""
        return self._interpolate(xy_m, 'height')

    def compaction(self, xy_m: ArrayLike) -> NDArray[np.float64]:
        """Return the compaction [m] at (..., 2) positions [m], bilinear between samples."""
        return self._interpolate(xy_m, 'compaction')

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return height change and compaction [m] at one position, bilinear."""
        xy = (x_m, y_m)
        return float(self.height_change(xy)), float(self.compaction(xy))

    def window(self, ix: int, iy: int, nx: int,
               ny: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return copies of height change and compaction, (ny, nx), from the sample (ix, iy) on."""
        height, compaction = np.zeros((ny, nx)), np.zeros((ny, nx))
        for key, there, here in pieces(ix, iy, nx, ny, self._tiles):
            tile = self._tile_at(self._tiles[key])
            height[here] = tile.height[there]
            compaction[here] = tile.compaction[there]
        return height, compaction

    @property
    def memory_bytes(self) -> int:
        """Memory of the samples."""
        return len(self._tiles) * TILE * TILE * 9

    def sums_m(self) -> tuple[float, float]:
        """Return the sums of height change and of compaction over all samples [m]."""
        tiles = [self._tile_at(self._tiles[key]) for key in sorted(self._tiles)]
        return (math.fsum(v for t in tiles for v in t.height[t.height != 0.0].tolist()),
                math.fsum(v for t in tiles for v in t.compaction[t.compaction != 0.0].tolist()))

    # Writing

    def put(self, ix: int, iy: int, height_m: NDArray[np.float64],
            compaction_m: NDArray[np.float64]) -> None:
        """Write a window back, rounded to float32, and take the rounding into the residue."""
        height, compaction = height_m.astype(np.float32), compaction_m.astype(np.float32)
        self.residue_m += float((height_m - height).sum() + (compaction_m - compaction).sum())
        ny, nx = height.shape
        for key, there, here in pieces(ix, iy, nx, ny):
            tile = self._tile(key)
            if tile is None:
                if not (height[here].any() or compaction[here].any()):
                    continue
                tile = self._make(key)
            tile.changed[there] |= ((tile.height[there] != height[here])
                                    | (tile.compaction[there] != compaction[here]))
            tile.height[there] = height[here]
            tile.compaction[there] = compaction[here]
            self._note_write(key)

    def reserve(self, ix: int, iy: int, nx: int, ny: int) -> list[TileKey]:
        """Make all tiles of a window, and return them: for compiled code that writes to them."""
        keys = [(tx, ty) for ty in range(iy // TILE, (iy + ny - 1) // TILE + 1)
                for tx in range(ix // TILE, (ix + nx - 1) // TILE + 1)]
        for key in keys:
            if key not in self._tiles:
                self._make(key)
        return keys

    def note_writes(self, keys: Iterable[TileKey]) -> None:
        """Take down that compiled code has written to tiles."""
        for key in keys:
            self._note_write(key)

    def apply(self, changes: GroundChanges) -> None:
        """Take over the values of another overlay."""
        tiles, inside = np.divmod(changes.index, TILE)
        order = np.lexsort((tiles[:, 1], tiles[:, 0]))
        begins = np.flatnonzero(np.any(np.diff(tiles[order], axis=0), axis=1)) + 1
        for chosen in np.split(order, begins):
            if not len(chosen):
                continue
            key = int(tiles[chosen[0], 0]), int(tiles[chosen[0], 1])
            tile = self._make(key)
            there = inside[chosen, 1], inside[chosen, 0]
            tile.height[there] = changes.height_m[chosen]
            tile.compaction[there] = changes.compaction_m[chosen]
            tile.changed[there] = True
            self._note_write(key)

    def _note_write(self, key: TileKey) -> None:
        self._dirty.add(key)
        self.writes += 1
        self._written.pop(key, None)
        self._written[key] = self.writes

    def take_changes(self) -> GroundChanges:
        """Return the samples that have changed since the last call, and forget that they did."""
        changes = self._collect(sorted(self._dirty), only_changed=True)
        for key in self._dirty:
            self.changed[self._tiles[key]] = False
        self._dirty.clear()
        return changes

    def snapshot(self) -> GroundChanges:
        """Return all samples that are not 0."""
        return self._collect(sorted(self._tiles), only_changed=False)

    def copy(self) -> Overlay:
        """Return an independent overlay of the same values, with nothing changed since."""
        other = Overlay()
        other.restore(self)
        other.take_changes()
        return other

    def restore(self, other: Overlay) -> None:
        """Take over all values of another overlay; what differs counts as changed."""
        for key in sorted(self._tiles.keys() | other._tiles.keys()):
            tile, source = self._make(key), other._tile(key)
            height, compaction = (0.0, 0.0) if source is None else (source.height,
                                                                    source.compaction)
            tile.changed[:] |= (tile.height != height) | (tile.compaction != compaction)
            tile.height[:] = height
            tile.compaction[:] = compaction
            self._note_write(key)
        self.residue_m = other.residue_m

    def _collect(self, keys: list[TileKey], only_changed: bool) -> GroundChanges:
        index, heights, compactions = [], [], []
        for key in keys:
            tile = self._tile_at(self._tiles[key])
            chosen = tile.changed if only_changed else (
                (tile.height != 0.0) | (tile.compaction != 0.0))
            jy, jx = np.nonzero(chosen)
            index.append(np.stack([jx + key[0] * TILE, jy + key[1] * TILE], axis=-1))
            heights.append(tile.height[chosen])
            compactions.append(tile.compaction[chosen])
        if not index:
            return GroundChanges(np.zeros((0, 2), np.int32), np.zeros(0, np.float32),
                                 np.zeros(0, np.float32))
        return GroundChanges(np.concatenate(index).astype(np.int32), np.concatenate(heights),
                             np.concatenate(compactions))

    def _tile(self, key: TileKey) -> _Tile | None:
        number = self._tiles.get(key)
        return None if number is None else self._tile_at(number)

    def _tile_at(self, number: int) -> _Tile:
        return _Tile(self.samples[number, 0], self.samples[number, 1], self.changed[number])

    def _make(self, key: TileKey) -> _Tile:
        """Return a tile, which is made if there is none."""
        number = self._tiles.get(key)
        if number is None:
            number = self._tiles[key] = len(self._tiles)
            if number == len(self.samples):
                more = max(8, number // 4)
                self.samples = np.concatenate(
                    [self.samples, np.zeros((more, 2, TILE, TILE), np.float32)])
                self.changed = np.concatenate([self.changed, np.zeros((more, TILE, TILE), bool)])
            self._enter(key, number)
        return self._tile_at(number)

    def _enter(self, key: TileKey, number: int) -> None:
        """Enter a tile into the index, which grows where the tile lies beyond it."""
        corner = np.array(key) - self.origin
        size = self.index.shape[::-1]
        if np.any(corner < 0) or np.any(corner >= size):
            low = np.minimum(self.origin, np.array(key) - _MARGIN)
            high = np.maximum(self.origin + size, np.array(key) + _MARGIN + 1)
            index = np.full((high - low)[::-1], -1, np.int32)
            x, y = self.origin - low
            index[y:y + size[1], x:x + size[0]] = self.index
            self.index, self.origin = index, low
            corner = np.array(key) - low
        self.index[corner[1], corner[0]] = number

    def _interpolate(self, xy_m: ArrayLike, name: str) -> NDArray[np.float64]:
        grid = np.asarray(xy_m, dtype=float) / CELL_M
        low = np.floor(grid)
        u, v = np.moveaxis(grid - low, -1, 0)
        ix, iy = np.moveaxis(low.astype(np.int64), -1, 0)
        result = np.zeros(grid.shape[:-1])
        for dx, dy, weight in ((0, 0, (1.0 - u) * (1.0 - v)), (1, 0, u * (1.0 - v)),
                               (0, 1, (1.0 - u) * v), (1, 1, u * v)):
            result += weight * self._samples(ix + dx, iy + dy, name)
        return result

    def _samples(self, ix: NDArray[np.int64], iy: NDArray[np.int64],
                 name: str) -> NDArray[np.float64]:
        values = np.zeros(np.shape(ix))
        tx, ty = ix // TILE, iy // TILE
        for key in sorted(set(zip(np.ravel(tx).tolist(), np.ravel(ty).tolist()))):
            tile = self._tile(key)
            if tile is not None:
                chosen = (tx == key[0]) & (ty == key[1])
                values[chosen] = getattr(tile, name)[iy[chosen] % TILE, ix[chosen] % TILE]
        return values


_Piece = tuple[TileKey, tuple[slice, slice], tuple[slice, slice]]


def pieces(ix: int, iy: int, nx: int, ny: int,
           tiles: Container[TileKey] | None = None) -> Iterator[_Piece]:
    """Yield (tile, its slices, slices of the window) of a window that begins at (ix, iy).

    Args:
        ix, iy, nx, ny: First sample of the window, and its size.
        tiles: Those to yield; None: all.
    """
    for ty in range(iy // TILE, (iy + ny - 1) // TILE + 1):
        y0, y1 = max(iy, ty * TILE), min(iy + ny, (ty + 1) * TILE)
        for tx in range(ix // TILE, (ix + nx - 1) // TILE + 1):
            if tiles is not None and (tx, ty) not in tiles:
                continue
            x0, x1 = max(ix, tx * TILE), min(ix + nx, (tx + 1) * TILE)
            yield ((tx, ty),
                   (slice(y0 - ty * TILE, y1 - ty * TILE), slice(x0 - tx * TILE, x1 - tx * TILE)),
                   (slice(y0 - iy, y1 - iy), slice(x0 - ix, x1 - ix)))
