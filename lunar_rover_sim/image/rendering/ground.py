"""The ground as compiled loops see it: heights of all grids, relief below them, tracks on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import read_only
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.ground_rays import cast
from lunar_rover_sim.image.rendering.projection import Projection, ViewVolume
from lunar_rover_sim.image.rendering.relief_map import NO_RELIEF, ReliefMap, ReliefShape
from lunar_rover_sim.image.rendering.surface import Surface
from lunar_rover_sim.image.rendering.track_map import NO_TRACKS, TrackMap
from lunar_rover_sim.image.rendering.view import ViewNumbers

F32 = NDArray[np.float32]

Key = TypeVar('Key')

_NOWHERE = np.array([np.inf, -np.inf, np.inf, -np.inf], np.float32)


class SeenTracks(NamedTuple):
    """Where tracks are that a view may show: (4,) least and greatest x and y [m].

    Attributes:
        lit: Of all tracks.
        raised: Of those near enough to have a shape of their own.
    """

    lit: F32 = _NOWHERE
    raised: F32 = _NOWHERE


class GroundHeights(NamedTuple):
    """The heights of all grids of a world, as compiled loops take them.

    Attributes:
        heights, levels, offsets: Of `ground_rays.cast`.
        steepest: Greatest slope of the grids.
    """

    heights: F32
    levels: F32
    offsets: NDArray[np.int64]
    steepest: float

    @classmethod
    def of(cls, world: World) -> GroundHeights:
        """Gather the heights of a world in a frame of its own."""
        grids = world.levels
        return cls(
            read_only(np.concatenate([grid.heights_m.ravel() for grid in grids]), np.float32),
            np.array([[1.0 / grid.cell_m, 0.5 * (grid.n - 1), grid.n - 2.0, grid.half_extent_m]
                      for grid in grids], np.float32),
            np.cumsum([0, *(grid.n**2 for grid in grids)]), max(map(_steepest, grids)))


class Ground:
    """The ground of a world, and the depth of it in an image.

    Attributes:
        relief: The shape of the relief below the grid.
    """

    def __init__(self, world: World, detail: DetailConfig, surface: Surface,
                 heights: GroundHeights | None = None) -> None:
        """Gather the heights, unless they are given; surface: has the relief below the grid."""
        reach_m = 0.0 if surface.tiles.flat else detail.relief_shape_m
        self._relief = ReliefMap(surface, reach_m) if reach_m > 0.0 else None
        self._tracks: TrackMap | None = None
        self.enter(world, GroundHeights.of(world) if heights is None else heights)

    def enter(self, world: World, heights: GroundHeights) -> None:
        """Be the ground of another window of the site; heights: its own."""
        self._heights = heights
        if self._relief is not None:
            self._relief.enter(world.ground)

    @property
    def relief(self) -> ReliefShape:
        """The shape of the relief below the grid; `NO_RELIEF` where it has none."""
        return NO_RELIEF if self._relief is None else self._relief.shape

    def follow(self, tracks: TrackMap) -> None:
        """Have tracks from now on."""
        self._tracks = tracks

    def update(self, volume: ViewVolume, before: Callable[[], None]) -> None:
        """Bring the shape of the relief below the grid up to date for a view.

        Args:
            before: Called before anything changes.
        """
        if self._relief is not None:
            self._relief.update(volume, before)

    def tracks_in(self, volume: ViewVolume) -> SeenTracks:
        """Return where tracks are that a view may show."""
        if self._tracks is None:
            return SeenTracks()
        tracks, seen = self._tracks, self._tracks.in_view(volume)
        return SeenTracks(_around(tracks.boxes[seen]),
                          _around(tracks.boxes[seen & tracks.near & tracks.raised]))

    def depth(self, view: ViewNumbers, projection: Projection, tracks: SeenTracks,
              workers: Workers) -> F32:
        """Return the (h, w) depth of the ground in an image, 0 where there is none [m]."""
        return self.depths({0: (view, projection)}, tracks, workers)[0]

    def depths(self, images: Mapping[Key, tuple[ViewNumbers, Projection]], tracks: SeenTracks,
               workers: Workers) -> dict[Key, F32]:
        """Return the depths of several images."""
        # With a row below that is not of the image.
        result = {key: np.zeros((projection.height + 1, projection.width), np.float32)
                  for key, (_, projection) in images.items()}
        workers.map(self._cast, [(*share, result[key], *image, tracks)
                                 for key, image in images.items()
                                 for share in workers.shares(image[1].width)])
        return {key: depth[:-1] for key, depth in result.items()}

    def _cast(self, first: int, last: int, depth: F32, view: ViewNumbers, projection: Projection,
              tracks: SeenTracks) -> None:
        """Fill in columns of the depth of an image, from `first` to before `last`."""
        arrays = NO_TRACKS if self._tracks is None else self._tracks.arrays
        relief, box = self.relief, tracks.raised
        cast(depth, first, last, view.numbers,
             np.array([projection.near_m, projection.far_m, self._heights.steepest], np.float32),
             *self._heights[:3], relief.shape, relief.numbers,
             np.array([*view.middle, relief.reach_m], np.float32), bool(box[0] <= box[1]), box,
             *arrays.of_shape)


def _steepest(grid: HeightGrid) -> float:
    """Return the greatest slope of the triangles of a grid, or a little more."""
    z = grid.heights_m
    return float(np.hypot(*(np.abs(np.diff(z, axis=axis)).max() for axis in (0, 1)))) / grid.cell_m


def _around(boxes: Array) -> F32:
    """Return least and greatest x and y of (m, 2, 3) boxes."""
    if not len(boxes):
        return _NOWHERE
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return np.array([low[0], high[0], low[1], high[1]], np.float32)
