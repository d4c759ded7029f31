"""The pass of the lens: stray light of the sun, near and beyond the image, and of bright ground.

Stray light varies slowly but for the neighbourhood of the sun. It is computed at the corners of
cells and interpolated between them; only near the sun every pixel is computed.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import moderngl
import numpy as np

from lunar_rover_sim.camera.lens import Glare, Lens
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment
from lunar_rover_sim.rendering.image_geometry import ImageGeometry
from lunar_rover_sim.rendering.scene import ImagedSun

_CELL = 24                  # pixels along a side of a cell
_NEAR_PX = 32.0, 128.0      # from the sun: within the first, every pixel is computed; beyond, none
# Ghosts lie on the line from the sun through the middle of the image. Place, over that of the sun,
# and radius, over the focal length; a choice that looks like pictures, not a certain lens.
_GHOSTS = ((-1.0, 0.012), (-0.45, 0.03), (0.4, 0.05))


class _Sun(NamedTuple):
    """The sun in both images: direction (3,), place (2,) [px], irradiance on both lenses (2,)."""

    direction: Array
    place: Array
    flux: Array


class OpticsPass:
    """Turns pairs of radiance images, the left above the right, into what the lens passes on."""

    def __init__(self, context: moderngl.Context, lens: Lens, image: ImageGeometry,
                 most_radiance: float) -> None:
        """Compile the programs.

        image: either of both, padding included; most_radiance: of all but the sun itself,
        whose glare follows from `ImagedSun` [W m-2 sr-1]
        """
        self._context, self._lens, self._image = context, lens, image
        w, h = image.width, image.height
        rows, columns = self._cells = -(-h // _CELL), -(-w // _CELL)
        self._glare = Glare(lens, self._cells, _CELL, w * h)
        middle = (np.indices(self._cells, float)[::-1].transpose(1, 2, 0) + 0.5) * _CELL - 0.5
        self._falloff = image.falloff(middle)
        corners = np.indices((rows + 1, columns + 1), float)[::-1].transpose(1, 2, 0) * _CELL - 0.5
        self._corners_px = corners
        self._amplified = 1.0 / image.falloff(corners)  # radiance of an irradiance of one

        self._mean = attachment(context, (columns, 2 * rows))
        self._means = context.framebuffer([self._mean])
        self._reduce = load_program(context, 'screen', 'reduce', CELL=_CELL)
        set_uniform(self._reduce, u_size=(w, h, 1.0 / w, 0.5 / h), u_most=most_radiance,
                    u_rows=float(rows))
        self._mesh = load_program(context, 'stray', 'stray')
        set_uniform(self._mesh, u_direct=lens.direct_share)
        self._scatter = load_program(context, 'screen', 'scatter', **image.defines)
        set_uniform(self._scatter, u_power=-0.5 * lens.config.scatter_exponent, **image.uniforms)
        self._ghost = load_program(context, 'screen', 'ghost')
        self._places = context.buffer(((corners + 0.5) / (w, h)).astype(np.float32).tobytes())
        self._indices = context.buffer(_triangles(rows, columns).tobytes())
        self._stray = [context.buffer(reserve=4 * self._amplified.size, dynamic=True)
                       for _ in range(2)]
        self._meshes = [context.vertex_array(
            self._mesh, [(self._places, '2f', 'a_place'), (stray, '1f', 'a_stray')],
            self._indices) for stray in self._stray]
        self._screens = {p.glo: context.vertex_array(p, [])
                         for p in (self._reduce, self._scatter, self._ghost)}
        self._radiance: moderngl.Texture | None = None
        self._target: moderngl.Framebuffer | None = None

    def draw(self, radiance: moderngl.Texture, depth: moderngl.Texture, sides: Sequence[int],
             sun: ImagedSun | None) -> None:
        """Change radiance to what the lens passes on, in place.

        radiance: texture of float32 [W m-2 sr-1], the left image above the right one; depth: in a
        texture of the same size, 0 for the sky; sides: 0 left, 1 right; sun: what the cameras see
        of it, if anything
        """
        if self._lens.perfect:
            return
        if radiance is not self._radiance:
            if self._target is not None:
                self._target.release()
            self._radiance, self._target = radiance, self._context.framebuffer([radiance])
        assert self._target is not None
        seen = None if sun is None else self._seen(sun)
        stray = self._stray_irradiance(radiance, depth, sides, seen) * self._amplified
        self._context.enable_only(self._context.BLEND)
        w, h = self._image.width, self._image.height
        self._target.use()
        for side in sides:
            if seen is not None:
                stray[side] += self._far_scatter(seen, side)
            self._stray[side].orphan()
            self._stray[side].write(stray[side].astype(np.float32).tobytes())
            self._target.viewport = (0, side * h, w, h)
            self._context.blend_func = self._context.ONE, self._context.SRC_ALPHA
            self._meshes[side].render()
            if seen is not None and seen.flux[side] > 0.0:
                self._context.blend_func = self._context.ONE, self._context.ONE
                self._draw_near(seen, side)
                if self._lens.config.ghost_share > 0.0:
                    self._draw_ghosts(seen, side)

    def _seen(self, sun: ImagedSun) -> _Sun:
        hood = self._lens.hood(math.acos(min(max(float(sun.direction[2]), -1.0), 1.0)))
        return _Sun(sun.direction, self._image.place(sun.direction),
                    sun.irradiance * hood * self._image.pupil(sun.direction))

    def _stray_irradiance(self, radiance: moderngl.Texture, depth: moderngl.Texture,
                          sides: Sequence[int], sun: _Sun | None) -> Array:
        """Return (2, rows + 1, columns + 1) glare of extended light, and the veil, at corners."""
        rows, columns = self._cells
        self._context.enable_only(self._context.NOTHING)
        radiance.use(0)
        depth.use(1)
        set_uniform(self._reduce, u_radiance=0, u_depth=1)
        self._means.use()
        self._means.viewport = (0, min(sides) * rows, columns, len(sides) * rows)
        self._screens[self._reduce.glo].render(vertices=3)
        data = self._means.read(viewport=(0, 0, columns, 2 * rows), components=1, alignment=1,
                                dtype='f4')
        means = np.frombuffer(data, np.float32).reshape(2, rows, columns)[list(sides)]
        stray = np.zeros((2, rows + 1, columns + 1))
        stray[list(sides)] = self._glare.of(means * self._falloff)
        if sun is not None:
            config, area = self._lens.config, self._image.width * self._image.height
            veil = config.veil_share * (1.0 - config.ghost_share) / area
            stray += (sun.flux * veil * self._image.focal_px**2)[:, None, None]
        return stray

    def _far_scatter(self, sun: _Sun, side: int) -> Array:
        """Return (rows + 1, columns + 1) radiance of scattered sunlight, but that near the sun."""
        apart, radiance = self._image.scatter(self._corners_px, sun.direction)
        low, high = _NEAR_PX
        x = np.linalg.norm(self._corners_px - sun.place, axis=2)
        x = np.clip((x - low) / (high - low), 0.0, 1.0)
        return (x * x * (3.0 - 2.0 * x) * sun.flux[side] * self._lens.scatter(apart) * radiance)

    def _draw_near(self, sun: _Sun, side: int) -> None:
        """Draw what `_far_scatter` leaves out."""
        if not self._frame(sun.place, _NEAR_PX[1], side):
            return
        down = side * self._image.height
        centre = self._image.K[:2, 2] + 0.5
        core = math.radians(self._lens.config.scatter_core_deg)
        set_uniform(self._scatter,
                    u_axis=(centre[0], centre[1] + down, 1.0 / self._image.focal_px),
                    u_sun=(sun.direction[0], sun.direction[1],
                           sun.flux[side] * self._lens.scatter_peak, core**-2),
                    u_near=(sun.place[0] + 0.5, sun.place[1] + 0.5 + down, *_NEAR_PX))
        self._screens[self._scatter.glo].render(vertices=3)

    def _draw_ghosts(self, sun: _Sun, side: int) -> None:
        """Draw the ghosts of the sun, each as bright all over as in its middle."""
        focal, config = self._image.focal_px, self._lens.config
        centre = self._image.K[:2, 2]
        share = config.veil_share * config.ghost_share / len(_GHOSTS)
        for ratio, radius in _GHOSTS:
            place = centre + ratio * (sun.place - centre)
            if not self._frame(place, radius * focal + 1.0, side):
                continue
            falloff = float(self._image.falloff(place))
            set_uniform(self._ghost,
                        u_ghost=(place[0] + 0.5, place[1] + 0.5 + side * self._image.height,
                                 radius * focal),
                        u_radiance=sun.flux[side] * share / (falloff * math.pi * radius**2))
            self._screens[self._ghost.glo].render(vertices=3)

    def _frame(self, place: Array, radius_px: float, side: int) -> bool:
        """Draw within a square around a place of an image; return whether it is in the image."""
        size = np.array([self._image.width, self._image.height])
        low = np.clip(np.floor(place - radius_px), 0, size).astype(int)
        high = np.clip(np.ceil(place + radius_px) + 1, 0, size).astype(int)
        if np.any(low >= high) or self._target is None:
            return False
        width, height = high - low
        self._target.viewport = (int(low[0]), int(low[1]) + side * int(size[1]), int(width),
                                 int(height))
        return True

    def release(self) -> None:
        """Release the GL objects."""
        if self._target is not None:
            self._target.release()
        release_all(*self._screens.values(), *self._meshes, *self._stray, self._places,
                    self._indices, self._reduce, self._mesh, self._scatter, self._ghost,
                    self._means, self._mean)


def _triangles(rows: int, columns: int) -> Array:
    """Return the (6 rows columns,) int32 corners of two triangles per cell."""
    row, column = np.indices((rows, columns))
    first = row * (columns + 1) + column
    below = first + columns + 1
    corners = np.stack([first, below, first + 1, first + 1, below, below + 1], axis=-1)
    return corners.ravel().astype(np.int32)
