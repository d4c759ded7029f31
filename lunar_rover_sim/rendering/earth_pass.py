"""The pass of the Earth: its disc in the images, before whatever stands in front of the sky."""

from __future__ import annotations

import dataclasses
import math

import moderngl
import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.illumination.earth_disc import earth_disc, EarthDisc
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import LitTargets
from lunar_rover_sim.rendering.projection import Projection
from lunar_rover_sim.rendering.scene import Scene

_FINE = 64      # samples across the disc, at least, that make its image


class EarthPass:
    """Draws the Earth into the radiance of the sky. It makes GL objects only if there is one."""

    def __init__(self, context: moderngl.Context, lit: LitTargets, projection: Projection,
                 config: RenderConfig) -> None:
        """projection: of both cameras."""
        self._context, self._lit, self._projection = context, lit, projection
        self._owned: list[moderngl.Texture | moderngl.Framebuffer | moderngl.Program
                          | moderngl.VertexArray] = []
        self.relight(config)

    def relight(self, config: RenderConfig) -> None:
        """Move the Earth to the date of the sun."""
        self._earth = earth_disc(config.sun, config.earth) if config.earth.drawn else None
        if self._earth is not None and not self._owned:
            self._make(self._earth)

    def _make(self, earth: EarthDisc) -> None:
        K = self._projection.K
        # A tenth more than its present size, which varies by 7 %; longer towards the corners.
        across = 2.2 * K[0, 0] * math.tan(earth.radius_rad)
        corner = np.abs(K[:2, 2]).max() * math.sqrt(2.0) / K[0, 0]
        self._side = 2 * math.ceil(0.5 * across * (1.0 + corner**2)) + 2
        self._finer = int(np.clip(math.ceil(_FINE / across), 2, 16))
        self._patch = self._context.texture((self._side, self._side), 1, dtype='f4')
        self._target = self._context.framebuffer([self._lit.radiance])
        self._program = load_program(self._context, 'screen', 'earth')
        self._screen = self._context.vertex_array(self._program, [])
        self._owned = [self._screen, self._program, self._target, self._patch]

    def draw(self, scene: Scene) -> None:
        """Add the disc to the sky of a lit scene; both cameras see it in one place."""
        if self._earth is None:
            return
        R = scene.T_world_cameras[0][:3, :3]
        direction = R.T @ self._earth.direction
        if direction[2] <= 0.0:
            return
        K, side = self._projection.K, self._side
        limit = 1e6     # of pixels, so that directions near the plane of the lens stay whole
        centre = np.clip((K @ direction)[:2] / direction[2], -limit, limit)
        first = np.rint(centre).astype(int) - side // 2
        size = np.array([self._projection.width, self._projection.height])
        low, high = np.maximum(first, 0), np.minimum(first + side, size)
        if np.any(low >= high):
            return
        self._patch.write(self._image(first, dataclasses.replace(
            self._earth, direction=direction, sun_direction=R.T @ self._earth.sun_direction)))
        self._context.enable_only(self._context.BLEND)
        self._context.blend_func = self._context.ONE, self._context.ONE
        self._patch.use(0)
        self._lit.depth.use(1)
        set_uniform(self._program, u_patch=0, u_depth=1)
        width, height = (int(n) for n in high - low)
        self._target.use()
        for k in scene.request.lit_sides:
            x, y = scene.samples.windows[k][:2]
            self._target.viewport = (x + int(low[0]), y + int(low[1]), width, height)
            set_uniform(self._program, u_corner=(float(x + first[0]), float(y + first[1])))
            self._screen.render(vertices=3)

    def _image(self, first: Array, earth: EarthDisc) -> bytes:
        """Return (side, side) mean radiance of pixels; earth: in axes of the cameras."""
        K, side, finer = self._projection.K, self._side, self._finer
        fine = (np.arange(side * finer) + 0.5) / finer - 0.5
        x, y = (fine + first[0] - K[0, 2]) / K[0, 0], (fine + first[1] - K[1, 2]) / K[1, 1]
        rays = np.stack(np.broadcast_arrays(x[None], y[:, None], 1.0), axis=-1)
        radiance = earth.radiance(rays).reshape(side, finer, side, finer).mean(axis=(1, 3))
        return radiance.astype(np.float32).tobytes()

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._owned)
