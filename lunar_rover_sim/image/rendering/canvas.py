"""Targets that a pair of images is drawn into; the left image lies above the right one.

A frame is begun while the one before it is still being lit, so that there are two `FrameTargets`,
which take turns, and one `SurfaceTargets`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.rendering.context import GlOwner, release_all
from lunar_rover_sim.image.rendering.projection import Projection, View, Window

_KINDS = {'f4': np.float32, 'u4': np.uint32}
DEPTH, SURFACE, FACE = range(3)     # attachments, as shaders/surface.frag has them


class SurfaceTargets:
    """Where all frames draw what is where of rocks and the rover.

    Attributes:
        size: Width and height of the attachments [px].
        attachments: Depth along the optical axis, negative, 0 where neither is seen [m]; packed
            normal and number. The latter mean nothing where depth is 0.
    """

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self._context, self.size = context, size
        self.attachments = [attachment(context, size), attachment(context, size, 2, 'u4')]
        self._face: moderngl.Texture | None = None

    @property
    def face(self) -> moderngl.Texture:
        """The true normals; made when first asked for, since few frames want them."""
        if self._face is None:
            self._face = attachment(self._context, self.size, 4)
        return self._face

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self.attachments, *([self._face] if self._face else []))


class FrameTargets:
    """Where rocks and the rover of one frame are drawn.

    Attributes:
        views: The two cameras.
    """

    def __init__(self, context: moderngl.Context, surfaces: SurfaceTargets) -> None:
        self._context, self._surfaces = context, surfaces
        # Each camera has its own framebuffers: when they change, the driver begins to draw.
        self._buffers = [context.depth_renderbuffer(surfaces.size) for _ in range(2)]
        self._plain = [context.framebuffer(surfaces.attachments, b) for b in self._buffers]
        self._with_faces: list[moderngl.Framebuffer] = []
        self.views = [View(context) for _ in range(2)]

    def of(self, side: int, *, faces: bool) -> moderngl.Framebuffer:
        """Return what a camera is drawn into; faces: with true normals."""
        if not faces:
            return self._plain[side]
        if not self._with_faces:
            every = [*self._surfaces.attachments, self._surfaces.face]
            self._with_faces = [self._context.framebuffer(every, b) for b in self._buffers]
        return self._with_faces[side]

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self.views, *self._with_faces, *self._plain, *self._buffers)


def attachment(context: moderngl.Context, size: tuple[int, int], components: int = 1,
               kind: str = 'f4') -> moderngl.Texture:
    """Return a texture to draw into, of float32 or uint32; size: width and height [px]."""
    texture = context.texture(size, components, dtype=kind)
    texture.filter = (context.NEAREST, context.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture


def read_image(target: moderngl.Framebuffer, index: int, side: int, size: tuple[int, int],
               components: int = 1, kind: str = 'f4') -> NDArray[Any]:
    """Read one image of attachment `index`: (h, w) or (h, w, components).

    Args:
        side: 0 for the left image, 1 for the right.
        size: Rows and columns drawn of each.
        kind: Of float32 or uint32.
    """
    h, w = size
    shape = (h, w) if components == 1 else (h, w, components)
    pixels = np.empty(shape, _KINDS[kind])
    target.read_into(pixels, viewport=(0, side * h, w, h), components=components,
                     attachment=index, alignment=1, dtype=kind)
    return pixels


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
