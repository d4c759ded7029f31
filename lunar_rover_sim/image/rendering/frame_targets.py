"""The framebuffers of a frame; the left image lies above the right one in all of them.

A frame is begun while the one before it is still being lit, so that there are two `FrameTargets`,
which take turns, and one `LitTargets`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.rendering.context import release_all
from lunar_rover_sim.image.rendering.view import View

_KINDS = {'f4': np.float32, 'f1': np.uint8, 'nu2': np.uint16}


class LitTargets:
    """What all frames are lit into.

    Attributes:
        radiance, depth: Textures of float32 [W m-2 sr-1], [m], of rocks and the rover. Depth is
            along the optical axis and negative, 0 where neither is seen.
        tint: Texture of the colour, as shaders/tint.glsl stores it; None without colour.
        attachments: All of them.
        framebuffer: The same.
    """

    def __init__(self, context: moderngl.Context, size: tuple[int, int], *,
                 colour: bool = False) -> None:
        self.radiance = attachment(context, size)
        self.depth = attachment(context, size)
        self.tint = context.texture(size, 2, dtype='nu2') if colour else None
        self.attachments = [self.radiance, self.depth, *([self.tint] if self.tint else [])]
        self.framebuffer = context.framebuffer(self.attachments)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self.framebuffer, *self.attachments)


class FrameTargets:
    """Where rocks and the rover of one frame are drawn.

    Attributes:
        lit: Framebuffers of rocks and the rover, of the left and the right camera.
        added: Of its radiance alone.
        views: The two cameras.
    """

    def __init__(self, context: moderngl.Context, lit: LitTargets) -> None:
        self._context, self._lit = context, lit
        self.size: tuple[int, int] = lit.radiance.size
        # Each camera has its own framebuffers: when they change, the driver begins to draw.
        self._buffers = [context.depth_renderbuffer(self.size) for _ in range(2)]
        self.lit = [context.framebuffer(lit.attachments, b) for b in self._buffers]
        self.added = [context.framebuffer([lit.radiance], b) for b in self._buffers]
        self.views = [View(context) for _ in range(2)]
        self._truth: TruthTargets | None = None

    @property
    def truth(self) -> TruthTargets:
        """Targets of truth; made when first asked for, since few frames want them."""
        if self._truth is None:
            self._truth = TruthTargets(self._context, self._lit, self._buffers)
        return self._truth

    def release(self) -> None:
        """Release the GL objects."""
        if self._truth is not None:
            self._truth.release()
        release_all(*self.views, *self.added, *self.lit, *self._buffers)


class TruthTargets:
    """Where light is drawn together with the truth of pixels, as shaders/truth.glsl has it.

    Attributes:
        framebuffers: Those of `FrameTargets.lit` with further attachments.
    """

    def __init__(self, context: moderngl.Context, lit: LitTargets,
                 depths: list[moderngl.Renderbuffer]) -> None:
        size = lit.radiance.size
        self._textures = [context.texture(size, 4, dtype='f1'), attachment(context, size, 4),
                          context.texture(size, 4, dtype='f1')]
        if lit.tint is None:    # what is drawn there is not read
            self._textures.insert(0, context.texture(size, 2, dtype='f1'))
        self.framebuffers = [context.framebuffer([*lit.attachments, *self._textures], depth)
                             for depth in depths]

    def read(self, layers: Collection[str], side: int,
             size: tuple[int, int]) -> dict[str, NDArray[Any]]:
        """Return those of 'label', 'crater', 'shadow' and 'normal' that are in `layers`.

        Args:
            side, size: As for `read_image`; the first two are (h, w) uint16, shadow is (h, w, 3)
                uint8, normal (h, w, 3) float32.
        """
        drawn = self.framebuffers[side]
        result: dict[str, NDArray[Any]] = {}
        if {'label', 'crater'} & set(layers):
            pairs = read_image(drawn, 3, side, size, 4, 'f1').view('<u2')
            result |= {'label': pairs[..., 0], 'crater': pairs[..., 1]}
        for index, name, kind in ((4, 'normal', 'f4'), (5, 'shadow', 'f1')):
            if name in layers:
                result[name] = read_image(drawn, index, side, size, 3, kind)
        return {name: result[name] for name in result if name in layers}

    def release(self) -> None:
        """Release the GL objects; the depth buffers belong to the frame."""
        release_all(*self.framebuffers, *self._textures)


class LinkTargets:
    """Where it is drawn which pixels show which link of the rover.

    Attributes:
        link: Texture of bytes: 0 where none is seen, else 1 + the index of the link.
        framebuffer: Of it.
    """

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self.link = context.texture(size, 1, dtype='f1')
        self._buffer = context.depth_renderbuffer(size)
        self.framebuffer = context.framebuffer([self.link], self._buffer)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self.framebuffer, self._buffer, self.link)


def attachment(context: moderngl.Context, size: tuple[int, int],
               components: int = 1) -> moderngl.Texture:
    """Return a texture of float32 to draw into; its size is width and height [px]."""
    texture = context.texture(size, components, dtype='f4')
    texture.filter = (context.NEAREST, context.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture


def read_image(target: moderngl.Framebuffer, index: int, side: int, size: tuple[int, int],
               components: int = 1,
               kind: str = 'f4') -> NDArray[Any]:
    """Read one image of attachment `index`: (h, w) or (h, w, components).

    Args:
        side: 0 for the left image, 1 for the right.
        size: Rows and columns drawn of each.
        kind: Of float32, of bytes ('f1') or of numbers of 16 bits ('nu2').
    """
    h, w = size
    shape = (h, w) if components == 1 else (h, w, components)
    pixels = np.empty(shape, _KINDS[kind])
    target.read_into(pixels, viewport=(0, side * h, w, h), components=components,
                     attachment=index, alignment=1, dtype=kind)
    return pixels
