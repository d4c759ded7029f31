"""The pass of the edges: outlines of rocks and rover without steps, in radiance."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import Array, inverse
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment, LitTargets
from lunar_rover_sim.rendering.projection import Projection

_DEPTHS = {'FIND': 0.9, 'COPY': 0.0, 'MIX': 0.0}     # in clip space; -1 is nothing found
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
        self._depth = context.depth_renderbuffer(size)
        self._found = context.framebuffer(depth_attachment=self._depth)
        self._mixing = context.framebuffer([self._mixed], self._depth)
        self._back = context.framebuffer([lit.radiance])
        self._boxes = context.buffer(reserve=16 * 1024, dynamic=True)
        self._programs = {name: load_program(context, 'edges', 'edges', **{name: 1})
                          for name in ('FIND', 'COPY', 'MIX')}
        self._arrays = {name: context.vertex_array(program, [(self._boxes, '4f /i', 'i_box')])
                        for name, program in self._programs.items()}
        for name, program in self._programs.items():
            set_uniform(program, u_drawn=0, u_depth=1, u_rows=0.5 * size[1],
                        u_texel=(1.0 / size[0], 1.0 / size[1]), u_z=_DEPTHS[name])

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
        context = self._context
        self._lit.depth.use(1)
        self._lit.radiance.use(0)
        # Depth rejects blocks of pixels without an edge before they are computed, which a branch
        # on llvmpipe does not. A pixel is found once, and mixed once, whatever boxes overlap.
        context.enable_only(context.DEPTH_TEST)
        context.depth_func = '>'
        self._found.use()
        self._found.viewport = (0, 0, *self._mixed.size)
        self._found.clear(depth=0.0)
        self._render('FIND', len(boxes))
        context.enable_only(context.NOTHING)
        self._mixing.use()
        self._mixing.viewport = (0, 0, *self._mixed.size)
        self._render('COPY', len(boxes))
        context.enable_only(context.DEPTH_TEST)
        context.depth_func = '<'
        self._render('MIX', len(boxes))
        context.enable_only(context.NOTHING)
        self._mixed.use(0)
        self._back.use()
        self._back.viewport = (0, 0, *self._mixed.size)
        self._render('COPY', len(boxes))

    def _render(self, name: str, count: int) -> None:
        self._arrays[name].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)

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
        release_all(*self._arrays.values(), self._boxes, *self._programs.values(), self._found,
                    self._mixing, self._back, self._depth, self._mixed)
