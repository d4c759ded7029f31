"""The framebuffers of a frame; the left image lies above the right one in all of them.

A frame is begun while the one before it is still being lit, so that there are two `FrameTargets`,
which take turns, and one `SurfaceTargets`.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.rendering.context import release_all
from lunar_rover_sim.image.rendering.view import View

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
