"""Targets that a pair of images is drawn into, frame after frame."""

from __future__ import annotations

import dataclasses

import moderngl

from lunar_rover_sim.image.rendering.frame_targets import FrameTargets, SurfaceTargets
from lunar_rover_sim.image.rendering.gl_owner import GlOwner
from lunar_rover_sim.image.rendering.projection import Projection
from lunar_rover_sim.image.rendering.view import Window

FRAMES_UNDER_WAY = 2    # one is lit while the next one is begun


@dataclasses.dataclass
class Drawing:
    """A pair of images of one frame.

    Attributes:
        projection: Of both cameras.
        targets: Of the frame.
        windows: Places of both images in their attachments.
        sides: Cameras that draw.
        lit_sides: Those of which light is computed.
    """

    projection: Projection
    targets: FrameTargets
    windows: list[Window]
    sides: tuple[int, ...]
    lit_sides: tuple[int, ...]


class Canvas(GlOwner):
    """Where the pairs of images of one size are drawn.

    Attributes:
        projection: Of both cameras.
        surfaces: What all frames are drawn into.
    """

    def __init__(self, context: moderngl.Context, projection: Projection) -> None:
        super().__init__()
        self.projection = projection
        with self._making():
            self.surfaces = self._own(SurfaceTargets(
                context, (projection.width, 2 * projection.height)))
            self._targets = [self._own(FrameTargets(context, self.surfaces))
                             for _ in range(FRAMES_UNDER_WAY)]

    def begin(self, sides: tuple[int, ...], lit_sides: tuple[int, ...]) -> Drawing:
        """Return the drawing of the next frame."""
        self._targets.reverse()
        w, h = self.projection.width, self.projection.height
        windows = [(0, side * h, w, h) for side in range(2)]
        return Drawing(self.projection, self._targets[0], windows, sides, lit_sides)
