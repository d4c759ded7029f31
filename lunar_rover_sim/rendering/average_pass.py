"""The pass of supersampling: the radiance of a pixel from that of its samples."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl

from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import LitTargets
from lunar_rover_sim.rendering.view import Window


class AveragePass:
    """Averages radiance over the samples of each pixel."""

    def __init__(self, context: moderngl.Context, samples: LitTargets, pixels: LitTargets,
                 times: int) -> None:
        """Compile the program; times: samples along a side of a pixel."""
        self._context, self._samples = context, samples
        self._target = context.framebuffer([pixels.radiance])
        self._program = load_program(context, 'screen', 'average', TIMES=times)
        set_uniform(self._program, u_samples=0,
                    u_texel=tuple(1.0 / n for n in samples.radiance.size))
        self._screen = context.vertex_array(self._program, [])

    def draw(self, windows: Sequence[Window]) -> None:
        """Fill windows of the pixels."""
        self._context.enable_only(self._context.NOTHING)
        self._samples.radiance.use(0)
        self._target.use()
        for window in windows:
            self._target.viewport = window
            self._screen.render(vertices=3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._screen, self._program, self._target)
