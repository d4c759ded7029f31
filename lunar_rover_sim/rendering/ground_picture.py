"""The ground in the images of a frame: its depth, light and truth, made by arrays from its meshes.

It is made once the meshes are drawn, before the ground changes or the frame is finished.
"""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.development import LitImage
from lunar_rover_sim.compiled import compiled
from lunar_rover_sim.rendering.canvas import Drawing
from lunar_rover_sim.rendering.crater_map import CraterLists
from lunar_rover_sim.rendering.frame_targets import read_image
from lunar_rover_sim.rendering.ground_band import Band, GroundImage, GroundSource
from lunar_rover_sim.rendering.ground_mesh import GroundShape
from lunar_rover_sim.workers import Workers


@dataclasses.dataclass
class Part:
    """The ground in one image.

    Attributes:
        drawing, side: Which one.
        lit, colour: Whether its light and its colour are wanted.
        truth: Layers that are wanted.
        shape: Of the ground.
        sources: Those that light it, or whose tracks shape it.
        lists: Of craters, where they are wanted.
    """

    drawing: Drawing
    side: int
    lit: bool
    colour: bool
    truth: Collection[str]
    shape: GroundShape
    sources: list[GroundSource]
    lists: CraterLists | None
    image: GroundImage = dataclasses.field(init=False)

    def read(self) -> None:
        """Read the depth of the meshes, and allocate what is wanted."""
        projection = self.drawing.projection
        size = projection.height, projection.width
        image = GroundImage(read_image(self.drawing.targets.ground[self.side], 0, self.side, size))
        if self.lit:
            image.radiance = np.zeros(size, np.float32)
        if self.lit and self.colour:
            image.tint = np.zeros((*size, 2), np.uint16)
        if self.truth:
            image.label = np.zeros(size, np.uint16)
            image.crater = np.zeros(size, np.uint16)
            image.normal = np.zeros((*size, 3), np.float32)
        if 'shadow' in self.truth:
            image.shadow = np.zeros((*size, 3), np.uint8)
        self.image = image

    def first_rows(self) -> range:
        """Return the first rows of all bands."""
        rows = self.drawing.rows[0]
        return range(rows.first // 2 * 2, rows.last, Band.rows_of(self.drawing.projection.width))

    def draw(self, band: Band, row: int) -> None:
        """Fill in a band."""
        end = row + band.rows

        def meets(span: tuple[int, int]) -> bool:
            return span[0] < end and row < span[1]
        sources = [dataclasses.replace(source,
                                       tracks=source.tracks if meets(rows.tracks) else None,
                                       shadow=source.shadow if meets(rows.shaded) else None)
                   for source, rows in zip(self.sources, self.drawing.rows)]
        band.draw(self.image, row, self.drawing.targets.views[self.side].numbers, self.shape,
                  range(*self.drawing.rows[0].refined), sources, self.lists)


class GroundPicture:
    """The ground in all images of a frame.

    Attributes:
        images: By the drawing, as a number of `Scene.drawings`, and the side.
    """

    def __init__(self, workers: Workers, parts: dict[tuple[int, int], Part]) -> None:
        self._workers, self._parts = workers, parts
        self.images: dict[tuple[int, int], GroundImage] = {}
        self._read = False

    def read(self) -> None:
        """Read the meshes."""
        if not self._read:
            self._read = True
            for part in self._parts.values():
                part.read()

    def make(self) -> None:
        """Make the images, unless they are made."""
        if not self.images:
            self.read()
            tasks = [(part, row) for part in self._parts.values() for row in part.first_rows()]
            self._workers.map(self._draw, tasks)
            self.images = {key: part.image for key, part in self._parts.items()}

    def _draw(self, part: Part, row: int) -> None:
        bands = self._workers.memory.__dict__.setdefault('bands', {})
        width = part.drawing.projection.width
        if width not in bands:
            bands[width] = Band(width)
        part.draw(bands[width], row)


def cover(image: LitImage, ground: GroundImage, workers: Workers) -> None:
    """Add the ground to an image of objects, in place, where no object lies before it."""
    radiance = ground.radiance if ground.radiance is not None else ground.depth_m
    workers.rows(_cover, len(radiance), ground.depth_m, radiance, image.depth_m, image.radiance)
    if image.tint is not None and ground.tint is not None:
        np.copyto(image.tint, ground.tint, where=(image.depth_m > 0.0)[..., None])


def tell(truth: dict[str, NDArray[Any]], depth_m: NDArray[np.float32],
         ground: GroundImage) -> None:
    """Add the truth of the ground to that of objects, in place, where the ground is seen."""
    shows = depth_m > 0.0
    for name, layer in truth.items():
        np.copyto(layer, getattr(ground, name), where=shows if layer.ndim == 2
                  else shows[..., None])


@compiled
def _cover(first, last, ground_depth, ground_radiance, depth,  # type: ignore[no-untyped-def]
           radiance):
    """Write the ground into rows of (h, w) depth and radiance, where no object lies before it.

    Args:
        depth: Negative for objects, 0 where there are none [m].
    """
    w = depth.shape[1]
    for r in range(first, last):
        own, seen, light, out = ground_depth[r], depth[r], ground_radiance[r], radiance[r]
        for c in range(w):
            shows = own[c] > 0.0 and (seen[c] == 0.0 or own[c] < -seen[c])
            out[c] = light[c] if shows else out[c]
            seen[c] = own[c] if shows else seen[c]
