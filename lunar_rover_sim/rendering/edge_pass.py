"""The pass of the edges: outlines of ground, rocks and rover without steps, in radiance."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl

from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment, LitTargets
from lunar_rover_sim.rendering.view import View, Window

_DEPTHS = {'FIND': 0.0, 'MIX': 0.5, 'COPY': 0.8}    # of each step, clip space; 1: no edge


class EdgePass:
    """Mixes the pixels beside edges; see shaders/edges.frag.

    Depth, labels and normals stay those of the surface at the centre of each pixel.
    """

    def __init__(self, context: moderngl.Context, lit: LitTargets) -> None:
        """Compile the programs; lit: what they work on."""
        self._context, self._lit = context, lit
        size = lit.radiance.size
        self._mixed = attachment(context, size)
        self._depth = context.depth_renderbuffer(size)
        self._found = context.framebuffer(depth_attachment=self._depth)
        self._mixing = context.framebuffer([self._mixed], self._depth)
        self._back = context.framebuffer([lit.radiance], self._depth)
        self._programs = {name: load_program(context, 'edges', 'edges', **{name: 1})
                          for name in _DEPTHS}
        self._screens = {name: context.vertex_array(program, [])
                         for name, program in self._programs.items()}
        for name, program in self._programs.items():
            set_uniform(program, u_drawn=0, u_depth=1, u_z=_DEPTHS[name])

    def draw(self, images: Sequence[tuple[View, Window]]) -> None:
        """Smooth the edges in images of the lit scene, given by their cameras and places."""
        # Depth rejects blocks of pixels without an edge before they are computed, which a branch
        # on llvmpipe does not.
        self._context.enable_only(self._context.DEPTH_TEST)
        self._lit.depth.use(1)
        for name, target, source in (('FIND', self._found, None),
                                     ('MIX', self._mixing, self._lit.radiance),
                                     ('COPY', self._back, self._mixed)):
            target.use()
            if source is None:
                target.clear()
            else:
                self._context.depth_func = '>'
                source.use(0)
            for view, window in images:
                view.bind()
                target.viewport = window
                self._screens[name].render(vertices=3)
        self._context.depth_func = '<'

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._screens.values(), *self._programs.values(), self._found, self._mixing,
                    self._back, self._depth, self._mixed)
