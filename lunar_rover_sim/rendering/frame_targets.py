"""A frame under way: what is prepared of it while the frame before is still being drawn."""

from __future__ import annotations

import dataclasses
from typing import Any, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.view import View

if TYPE_CHECKING:
    import moderngl

Window = tuple[int, int, int, int]


class FrameTargets:
    """Where the ground of a frame is drawn, left image above right; two stages take turns.

    radiance, depth: what all stages light their frames into
    """

    def __init__(self, context: moderngl.Context, radiance: moderngl.Texture,
                 depth: moderngl.Texture) -> None:
        self._context = context
        self.size = radiance.size
        self.ground_depth = attachment(context, self.size)
        # Targets of their own for the eyes: at a change the driver begins to draw what it got.
        self._buffers = [context.depth_renderbuffer(self.size) for _ in range(2)]
        self.ground = [context.framebuffer([self.ground_depth], b) for b in self._buffers]
        self.objects = [context.framebuffer([radiance, depth], b) for b in self._buffers]
        self.eyes = [View(context) for _ in ('left', 'right')]
        self._truth: Any = None

    @property
    def truth(self) -> Any:
        """Framebuffer of normals and labels of the left eye; made when first asked for."""
        if self._truth is None:
            self._truth = self._context.framebuffer([attachment(self._context, self.size, 4)],
                                                    self._buffers[0])
        return self._truth


def attachment(context: moderngl.Context, size: tuple[int, int],
               components: int = 1) -> moderngl.Texture:
    """Return a texture of floats to draw into."""
    texture = context.texture(size, components, dtype='f4')
    texture.filter = (context.NEAREST, context.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What is drawn of a frame: the eyes (0 left, 1 right), their light, the left one's truth."""

    eyes: tuple[int, ...]
    lit: bool
    truth: bool


@dataclasses.dataclass(frozen=True)
class Scene:
    """A frame whose geometry is drawn: what its lighting needs.

    T_world_base, joint_angle_rad: the state that it shows; legs: (links, 4, 4) poses; cameras:
    (4, 4) of both eyes; rows: of the ground, as `Ground.rows`; shadow, body: uniforms of the
    rover's shadow and of the light on it, None if it is not in view
    """

    T_world_base: Array
    joint_angle_rad: Array
    wanted: Wanted
    targets: FrameTargets
    legs: Array
    cameras: list[Array]
    windows: list[Window]
    rows: tuple[int, int, int]
    shadow: dict[str, Any]
    body: dict[str, Any] | None

    def shows(self, T_world_base: Array, joint_angle_rad: Array, wanted: Wanted) -> bool:
        """Return whether it is the frame of this state, and nothing is missing."""
        return (self.wanted == wanted and np.array_equal(self.T_world_base, T_world_base)
                and np.array_equal(self.joint_angle_rad, joint_angle_rad))
