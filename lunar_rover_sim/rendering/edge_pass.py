"""The pass of the edges: outlines of rocks and rover without steps, in radiance."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment, LitTargets
from lunar_rover_sim.rendering.projection import Projection

_MARGIN_PX = 2.0        # around a ball, for the pixels beside its outline


class EdgePass:
    """Mixes the pixels beside the outlines of objects; see shaders/edges.frag.

    Only rectangles around objects are drawn, since a pass over all pixels would take a sixth of
    the time of a frame on llvmpipe. Depth, labels and normals stay those of the surface at the
    centre of each pixel.
    """

    def __init__(self, context: moderngl.Context, lit: LitTargets,
                 projection: Projection) -> None:
        """Compile the programs; lit: what they work on; projection: of both cameras."""
        self._context, self._lit, self._projection = context, lit, projection
        size = lit.radiance.size
        self._mixed = attachment(context, size)
        # Pixels are mixed into a second texture, and brought back.
        self._targets = [context.framebuffer([self._mixed]), context.framebuffer([lit.radiance])]
        self._programs = [load_program(context, 'edges', 'edges'),
                          load_program(context, 'edges', 'edges', COPY=1)]
        self._boxes = context.buffer(reserve=16 * 1024, dynamic=True)
        self._arrays: list[moderngl.VertexArray] = []
        for program in self._programs:
            set_uniform(program, u_drawn=0, u_depth=1, u_rows=0.5 * size[1],
                        u_texel=(1.0 / size[0], 1.0 / size[1]))
            self._arrays.append(context.vertex_array(program,
                                                     [(self._boxes, '4f /i', 'i_box')]))

    def draw(self, cameras: dict[int, Array], balls_m: Array) -> None:
        """Smooth the outlines of objects that lie within balls, in the lit images.

        cameras: T_world_camera (4, 4) by the number of the image; balls_m: (m, 4) centres, radii
        """
        boxes = np.concatenate([self._around(T, side, balls_m[:, :3], balls_m[:, 3])
                                for side, T in cameras.items()])
        if not len(boxes):
            return
        data = boxes.astype(np.float32).tobytes()
        if len(data) > self._boxes.size:
            self._boxes.orphan(2 * len(data))
        self._boxes.write(data)
        self._context.enable_only(self._context.NOTHING)
        self._lit.depth.use(1)
        for target, source, array in zip(self._targets, (self._lit.radiance, self._mixed),
                                         self._arrays):
            target.use()
            target.viewport = (0, 0, *self._mixed.size)
            source.use(0)
            array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(boxes))

    def _around(self, T_world_camera: Array, side: int, centres_m: Array,
                radii_m: Array) -> NDArray[np.float64]:
        """Return (k, 4) rectangles in clip space around the balls that a camera sees."""
        K, w, h = self._projection.K, self._projection.width, self._projection.height
        T = inverse(T_world_camera)
        points = centres_m @ T[:3, :3].T + T[:3, 3]
        ahead = points[:, 2] + radii_m > 0.0
        points, radii = points[ahead], radii_m[ahead]
        depth = points[:, 2]
        size = np.array([w, h], float)
        centre = points[:, :2] / np.maximum(depth, 1e-3)[:, None] * K[0, 0] + K[:2, 2] + 0.5
        slope = np.linalg.norm(points, axis=1) / np.maximum(depth, 1e-3)
        reach = K[0, 0] * radii * slope**2 / np.maximum(depth - radii, 1e-3) + _MARGIN_PX
        inside = (depth < 1.5 * radii)[:, None]         # the camera may be in the ball
        low = np.where(inside, 0.0, np.clip(centre - reach[:, None], 0.0, size))
        high = np.where(inside, size, np.clip(centre + reach[:, None], 0.0, size))
        boxes = np.concatenate([np.floor(low), np.ceil(high)], axis=1)
        boxes = boxes[np.all(high > low, axis=1)]
        boxes[:, 1::2] += side * h
        return boxes / np.tile(0.5 * np.array(self._mixed.size), 2) - 1.0

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._arrays, self._boxes, *self._programs, *self._targets, self._mixed)
