"""The pass of the rocks: instances of the shape library, chosen by view and size."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.frames import matrix_from_wxyz
from lunar_rover_sim.rendering.context import load_program, release_all
from lunar_rover_sim.rendering.projection import ViewVolume
from lunar_rover_sim.rendering.rock_meshes import coarse, facets
from lunar_rover_sim.rendering.surface import Surface
from lunar_rover_sim.world.rocks import Rocks, RockShape

F32 = NDArray[np.float32]

_INSTANCE = '3f 3f 3f 3f 4f 2f /i'
_NAMES = ('i_position', 'i_x', 'i_y', 'i_z', 'i_light', 'i_matter')
_FLOATS = 18
# Levels of detail: rocks that look smaller than so many pixels are hulls of so few vertices.
_COARSE = ((14.0, 10), (4.0, 6))
_LEVELS = 1 + len(_COARSE)


class RockPass:
    """Draws the rocks.

    programs: those that compute light or truth, for the constants of the light
    """

    def __init__(self, context: moderngl.Context, rocks: Rocks, shapes: tuple[RockShape, ...],
                 light: F32, surface: Surface, lamp: bool) -> None:
        """Make meshes and programs.

        light: (m, 4) as `Sunlight.rock_light`; surface: textures to light with; lamp: whether
        there is one
        """
        self._context, self._surface = context, surface
        lit = {'ROVER_SHADOW': 1, **({'LAMP': 1} if lamp else {})}
        self._lit = load_program(context, 'rock', 'rock', **lit)
        self._truth = load_program(context, 'rock', 'rock', TRUTH=1)
        self.programs = (self._lit, self._truth)
        self.rocks = rocks
        rotation = matrix_from_wxyz(rocks.orientation_wxyz) if len(rocks) else np.zeros((0, 3, 3))
        columns = rotation * rocks.diameter_m[:, None, None]
        self._data = np.concatenate(
            [rocks.position_m, columns[:, :, 0], columns[:, :, 1], columns[:, :, 2], light,
             rocks.albedo[:, None], np.arange(len(rocks))[:, None]], axis=1).astype(np.float32)
        self._radius = 0.75 * rocks.diameter_m
        # A kind is a shape at one level of detail.
        self._instances: dict[int, moderngl.Buffer] = {}
        self._counts: dict[int, int] = {}
        self._arrays: dict[tuple[int, int], moderngl.VertexArray] = {}
        self._vertices: list[moderngl.Buffer] = []
        for shape in shapes:
            for mesh in (shape, *(coarse(shape, vertices) for _, vertices in _COARSE)):
                self._vertices.append(context.buffer(facets(mesh).tobytes()))

    def relight(self, light: F32) -> None:
        """Take the light under another sun, (m, 4) as `Sunlight.rock_light`."""
        self._data[:, 12:16] = light

    def choose(self, volume: ViewVolume, focal_px: float, least_px: float) -> None:
        """Choose what `draw` draws: rocks that are in view and look larger than `least_px`."""
        visible = self._visible(volume, focal_px, least_px)
        distance = np.linalg.norm(self.rocks.position_m[visible] - volume.centre_m, axis=1)
        size = self.rocks.diameter_m[visible] * focal_px
        kind_of = _LEVELS * self.rocks.shape[visible]
        for least, _ in _COARSE:
            kind_of = kind_of + (size < least * distance)
        order = np.argsort(kind_of, kind='stable')
        data = self._data[visible[order]]
        kinds, starts, counts = np.unique(kind_of[order], return_index=True, return_counts=True)
        self._counts = dict(zip(kinds.tolist(), counts.tolist()))
        for kind, start, count in zip(kinds.tolist(), starts, counts):
            if kind not in self._instances:
                members = int((self.rocks.shape == kind // _LEVELS).sum())
                self._instances[kind] = self._context.buffer(reserve=4 * _FLOATS * members,
                                                             dynamic=True)
            self._instances[kind].write(data[start:start + count].tobytes())

    def draw(self, *, truth: bool = False) -> None:
        """Draw the chosen rocks, lit or as normals and labels, into the framebuffer in use."""
        self._context.enable_only(self._context.DEPTH_TEST | self._context.CULL_FACE)
        program = self._truth if truth else self._lit
        self._surface.bind_rocks(program)
        for kind, count in self._counts.items():
            key = (program.glo, kind)
            if key not in self._arrays:
                self._arrays[key] = self._context.vertex_array(
                    program, [(self._vertices[kind], '3f 3f', 'a_position', 'a_normal'),
                              (self._instances[kind], _INSTANCE, *_NAMES)], skip_errors=True)
            self._arrays[key].render(instances=count)

    def _visible(self, volume: ViewVolume, focal_px: float,
                 least_px: float) -> NDArray[np.int64]:
        """Return the indices of the rocks to draw."""
        offset = self.rocks.position_m - volume.centre_m
        distance = np.linalg.norm(offset, axis=1)
        seen = self.rocks.diameter_m * focal_px > least_px * np.maximum(distance, 1e-3)
        for plane in volume.planes:
            seen &= offset @ plane[:3] + plane[3] > -self._radius
        return np.flatnonzero(seen)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._arrays.values(), *self._instances.values(), *self._vertices,
                    *self.programs)
