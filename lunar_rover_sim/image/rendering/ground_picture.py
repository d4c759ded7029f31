"""The ground in the images of a frame: its light and truth.

It is made before the ground changes, or the frame is finished.
"""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.image.camera.development import LitImage
from lunar_rover_sim.image.rendering.canvas import Drawing
from lunar_rover_sim.image.rendering.crater_map import CraterLists
from lunar_rover_sim.image.rendering.ground_band import Band, GroundImage, GroundSource, SeenSource
from lunar_rover_sim.image.rendering.relief_map import ReliefShape

_ZERO, _ONE, _FAR = (np.float32(x) for x in (0.0, 1.0, 1e9))
# A pixel is lit at one point, with texels of at most twice its width (see `grid_rows`). Where the
# ground in it is longer than those by three to five cells of the finest grid, it comes to take a
# seventh of the light of each of its neighbours. That brings single pixels and the share in shadow
# nearest to those of finer images (bench_resolution.py); far ground flickers less, too.
_LONGER_M, _SHARE = (0.075, 0.125), np.float32(1.0 / 7.0)
_NOWHERE_M = 1e9, 2e9
_EVEN = np.ones((0, 0), np.float32)


@dataclasses.dataclass
class Part:
    """The ground in one image.

    Attributes:
        drawing, side: Which one.
        depth_m: (h, w), 0 where there is no ground.
        lit, colour: Whether its light and its colour are wanted.
        truth: Layers that are wanted.
        relief: Below the grid.
        tracks: Least and greatest x and y of those in view [m].
        sources: Those that light it.
        lists: Of craters, where they are wanted.
    """

    drawing: Drawing
    side: int
    depth_m: NDArray[np.float32]
    lit: bool
    colour: bool
    truth: Collection[str]
    relief: ReliefShape
    tracks: NDArray[np.float32]
    sources: list[GroundSource]
    lists: CraterLists | None
    image: GroundImage = dataclasses.field(init=False)
    seen: list[SeenSource] = dataclasses.field(init=False)

    def allocate(self) -> None:
        """Make room for what is wanted, and note what loops take of the sources."""
        projection = self.drawing.projection
        size = projection.height, projection.width
        image = GroundImage(self.depth_m)
        if self.lit:    # read where there is ground
            image.radiance = np.empty(size, np.float32)
        image.of_relief = next((source for source in self.sources
                                if source.texels.views is not None), None)
        if self.lit and image.of_relief is not None:
            image.relief = np.ones(size, np.float32)
        if self.lit and self.colour:
            image.tint = np.empty(size, np.uint32)
        if self.truth:
            image.label = np.zeros(size, np.uint16)
            image.crater = np.zeros(size, np.uint16)
            image.normal = np.zeros((*size, 3), np.float32)
        if 'shadow' in self.truth:
            image.shadow = np.zeros((*size, 3), np.uint8)
        self.image, view = image, self.drawing.targets.views[self.side].numbers
        self.seen = [SeenSource(source, view, self.relief) for source in self.sources]

    def first_rows(self) -> range:
        """Return the first rows of all bands that show ground."""
        shows = np.flatnonzero(self.depth_m.any(axis=1))
        if not len(shows) or not (self.lit or self.truth):
            return range(0)
        return range(int(shows[0]) // 2 * 2, int(shows[-1]) + 1,
                     Band.rows_of(self.drawing.projection.width))

    def draw(self, band: Band, row: int) -> None:
        """Fill in a band."""
        band.draw(self.image, row, self.drawing.targets.views[self.side].numbers,
                  self.relief, self.tracks, self.seen, self.lists)


class GroundPicture:
    """The ground in all images of a frame.

    Attributes:
        images: By the drawing, as a number of `Scene.drawings`, and the side.
    """

    def __init__(self, workers: Workers, parts: dict[tuple[int, int], Part]) -> None:
        self._workers, self._parts = workers, parts
        self.images: dict[tuple[int, int], GroundImage] = {}

    def make(self) -> None:
        """Make the images, unless they are made."""
        if not self.images:
            parts = self._parts.values()
            for part in parts:
                part.allocate()
            # Rows of both eyes show the same ground one after the other: its texels are at hand.
            self._workers.map(self._draw, sorted(
                ((part, row) for part in parts for row in part.first_rows()),
                key=lambda task: task[1]))
            self.images = {key: part.image for key, part in self._parts.items()}

    def _draw(self, part: Part, row: int) -> None:
        bands = self._workers.memory.__dict__.setdefault('bands', {})
        width = part.drawing.projection.width
        if width not in bands:
            bands[width] = Band(width)
        part.draw(bands[width], row)


def far_ground(pixel: float, above_m: float) -> tuple[float, float]:
    """Return at which depth pixels begin to take light of their neighbours, and take the most [m].

    Args:
        pixel: Size of one at depth 1.
        above_m: Height of the camera above the ground.
    """
    # On level ground a pixel at depth d is pixel d wide and pixel d**2 / above_m long.
    first, last = (above_m + math.sqrt(above_m**2 + above_m * longer / pixel)
                   for longer in _LONGER_M)
    return first, last


def cover(image: LitImage, ground: GroundImage, workers: Workers,
          far_m: tuple[float, float] = _NOWHERE_M) -> None:
    """Add the ground to an image of objects, in place, where no object lies before it.

    Args:
        far_m: As `far_ground`.
    """
    radiance = ground.radiance if ground.radiance is not None else ground.depth_m
    relief = _EVEN if ground.relief is None else ground.relief
    workers.rows(_cover, len(radiance), ground.depth_m, radiance, relief,
                 np.array(far_m, np.float32), image.depth_m, image.radiance)
    if image.tint is not None and ground.tint is not None:
        workers.rows(_cover_tint, len(radiance), image.depth_m, ground.tint, image.tint)


def cover_depth(depth_m: NDArray[np.float32], ground_m: NDArray[np.float32],
                workers: Workers) -> None:
    """Add the (h, w) depth of the ground to that of objects, as `cover` does."""
    cover(LitImage(np.zeros_like(depth_m), depth_m), GroundImage(ground_m), workers)


def tell(truth: dict[str, NDArray[Any]], depth_m: NDArray[np.float32],
         ground: GroundImage) -> None:
    """Add the truth of the ground to that of objects, in place, where the ground is seen."""
    shows = (depth_m > 0.0).view(np.uint8)
    for name, layer in truth.items():
        cv2.copyTo(getattr(ground, name), shows, layer)


@compiled
def _with_neighbours(r, depth, radiance, far_m, mean):  # type: ignore[no-untyped-def]
    """Return a row of the light of (h, w) ground; far pixels take a share of their neighbours.

    Args:
        far_m: As `far_ground`.
        mean: (w,) memory for it.
    """
    h, w = depth.shape
    own, light, first, span, count = depth[r], radiance[r], far_m[0], far_m[1] - far_m[0], 0
    for c in range(w):
        count += own[c] > first
    if count == 0:
        return light
    high, low = max(r - 1, 0), min(r + 1, h - 1)
    above, below, over, under = depth[high], depth[low], radiance[high], radiance[low]
    mean[0], mean[w - 1] = light[0], light[w - 1]
    for c in range(1, w - 1):
        share = _SHARE * min(max((own[c] - first) / span, _ZERO), _ONE)
        # Where there is no ground, there is no light of it.
        a = over[c] if above[c] > _ZERO else light[c]
        b = under[c] if below[c] > _ZERO else light[c]
        d = light[c - 1] if own[c - 1] > _ZERO else light[c]
        e = light[c + 1] if own[c + 1] > _ZERO else light[c]
        mean[c] = light[c] + share * (((a - light[c]) + (b - light[c]))
                                      + ((d - light[c]) + (e - light[c])))
    return mean


@compiled
def _cover(first, last, ground_depth, ground_radiance, relief,  # type: ignore[no-untyped-def]
           far_m, depth, radiance):
    """Write the ground into rows of (h, w) depth and radiance, where no object lies before it.

    Args:
        relief: (h, w) factors that take no light of neighbours: they are means over a pixel; or
            (0, 0).
        far_m: As `far_ground`.
        depth: Negative for objects, 0 where there are none [m].
    """
    w = depth.shape[1]
    mean = np.empty(w, np.float32)
    for r in range(first, last):
        own, seen, out = ground_depth[r], depth[r], radiance[r]
        light = _with_neighbours(r, ground_depth, ground_radiance, far_m, mean)
        if len(relief):
            factors = relief[r]
            for c in range(w):
                mean[c] = light[c] * factors[c]
            light = mean
        for c in range(w):
            before = -seen[c] if seen[c] < _ZERO else _FAR
            far = own[c] if own[c] > _ZERO else _FAR
            out[c] = light[c] if far < before else out[c]
            seen[c] = own[c] if far < before else seen[c]


@compiled
def _cover_tint(first, last, depth, ground, tint):  # type: ignore[no-untyped-def]
    """Write the colour of the ground into rows of an (h, w) image where depth is of it."""
    w = depth.shape[1]
    for r in range(first, last):
        seen, own, out = depth[r], ground[r], tint[r]
        for c in range(w):
            out[c] = own[c] if seen[c] > _ZERO else out[c]
