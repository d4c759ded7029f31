"""The pass of the rover: its meshes, link by link."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.image.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.image.rendering.projection import ViewVolume
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.visual import link_poses, visual_parts, VisualPart

_LUMINANCE = (0.2126, 0.7152, 0.0722)       # of linear red, green, blue (ITU-R BT.709)

MAP = 768               # pixels along a side of the map of the shadow of the rover on itself

F32 = NDArray[np.float32]


class BodyLight(NamedTuple):
    """The light on the rover, as `object_rows.light_rover` takes it.

    Attributes:
        light: World height of foot and top [m]; clearance and occluder distance at the foot and
            at the top [m]; exitance of the lit ground around [W/m2].
        from_sun: (4, 4) from world positions to clip space of the map.
        map: (MAP, MAP) depth of the rover as the sun sees it; empty before `RoverPass.cast`.
    """

    light: F32
    from_sun: F32
    map: F32


class RoverPass:
    """Draws where the rover is.

    Attributes:
        parts: (k, 7) of each part: index of its link, grey albedo, logarithms of red and blue over
            green, roughness, reflectance at normal incidence, tilt of crumples.
    """

    def __init__(self, context: moderngl.Context, rover: RoverDescription) -> None:
        """Make meshes and programs."""
        self._context, self._rover = context, rover
        self._links = list(link_poses(rover))
        parts = visual_parts(rover)
        link_of = [self._links.index(part.link) for part in parts]
        self.parts = np.array([_matter(part, link) for part, link in zip(parts, link_of)],
                              np.float32)
        data = np.concatenate([_triangles(part, k, link)
                               for k, (part, link) in enumerate(zip(parts, link_of))])
        self._boxes = np.stack([_box_corners(data[data[:, 7] == k, :3])
                                for k in range(len(self._links))])
        # First, second and third corners of the faces of each link.
        self._faces = [np.ascontiguousarray(data[data[:, 7] == k, :3].reshape(-1, 3, 3)
                                            .transpose(1, 0, 2)) for k in range(len(self._links))]
        self._vertices = context.buffer(data.astype(np.float32).tobytes())
        links = {'LINKS': len(self._links)}
        self._program = load_program(context, 'rover', 'surface', **links)
        self._array = context.vertex_array(
            self._program, [(self._vertices, '3f 3f 2f', 'a_position', 'a_normal', 'a_part')])
        self._map = context.depth_texture((MAP, MAP))
        self._map_target = context.framebuffer(depth_attachment=self._map)
        self._depth = load_program(context, 'rover_depth', 'rover_depth', **links)
        self._depth_array = context.vertex_array(
            self._depth, [(self._vertices, '3f 12x 2f', 'a_position', 'a_part')])

    def poses(self, T_world_base: Array, joint_angle_rad: ArrayLike) -> Array:
        """Return the (links, 4, 4) world poses of all links; base_link is the first."""
        local = link_poses(self._rover, joint_angle_rad)
        return np.stack([T_world_base @ local[link] for link in self._links])

    def is_in_view(self, T_world_links: Array, volume: ViewVolume) -> bool:
        """Return whether the box around any link may reach into the view volume."""
        corners = self._boxes @ T_world_links[:, :3, :3].transpose(0, 2, 1) \
            + T_world_links[:, None, :3, 3]
        within = (corners - volume.centre_m) @ volume.planes[:, :3].T + volume.planes[:, 3] > 0.0
        return bool(np.any(np.all(np.any(within, axis=1), axis=1)))

    def is_in_cone(self, T_world_links: Array, T_world_view: Array, width: float) -> bool:
        """Return whether a face may reach into a cone around the axis of a view.

        Args:
            width: Radius of the cone at depth 1.
        """
        for link, T in enumerate(inverse(T_world_view) @ T_world_links):
            # The box of a link is tested first, then its faces.
            for corners in (self._boxes[link][:, None], self._faces[link]):
                seen = corners @ T[:3, :3].T + T[:3, 3]
                low, high = seen.min(axis=0), seen.max(axis=0)
                reach = width * np.maximum(high[:, 2], 0.0)
                inside = (high[:, 2] > 0.0) & (np.maximum(low[:, 0], low[:, 1]) < reach) & (
                    np.minimum(high[:, 0], high[:, 1]) > -reach)
                if not inside.any():
                    break
            else:
                return True
        return False

    def light(self, T_world_links: Array, radius_m: float, sunlight: Sunlight,
              irradiance: float, sun_axes: Array) -> BodyLight:
        """Return the light on the rover, without the map of its shadow on itself.

        Args:
            radius_m: Reach of the rover from its base.
            irradiance: Of the sun, normal [W/m2].
            sun_axes: (3, 3) as `rock_shadow.sun_axes`.
        """
        base = T_world_links[0]
        span = base[2, 3] + radius_m * np.array([-0.5, 0.8])
        clearance, occluder = sunlight.light_of(np.array([[*base[:2, 3], z] for z in span]))
        surroundings = float(sunlight.surroundings_at(base[:2, 3]))
        axes = np.array([[1.0], [1.0], [-1.0]]) * sun_axes / (1.05 * radius_m)
        from_sun = np.eye(4)
        from_sun[:3, :3], from_sun[:3, 3] = axes, -axes @ base[:3, 3]
        return BodyLight(np.array([*span, clearance[0], occluder[0], clearance[1], occluder[1],
                                   irradiance * surroundings], np.float32),
                         from_sun.astype(np.float32), np.zeros((0, 0), np.float32))

    def cast(self, T_world_links: Array, light: BodyLight) -> BodyLight:
        """Return the light with the map of the rover's shadow on itself, which is drawn."""
        self._map_target.use()
        self._map_target.clear(depth=1.0)
        self._context.enable_only(self._context.DEPTH_TEST)
        set_uniform(self._depth, u_links=_columns(T_world_links),
                    u_from_sun=_columns(light.from_sun[None]))
        self._depth_array.render()
        seen = np.empty((MAP, MAP), np.float32)
        self._map_target.read_into(seen, components=1, attachment=-1, alignment=1, dtype='f4')
        return light._replace(map=seen)

    def draw(self, T_world_links: Array) -> None:
        """Draw the rover into the framebuffer in use."""
        self._context.enable_only(self._context.DEPTH_TEST)
        set_uniform(self._program, u_links=_columns(T_world_links))
        self._array.render()

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._array, self._depth_array, self._vertices, self._program, self._depth,
                    self._map_target, self._map)


def _columns(transforms: NDArray[np.floating[Any]]) -> F32:
    """Return (n, 4, 4) transforms as GL reads them, column by column."""
    return np.ascontiguousarray(transforms.transpose(0, 2, 1), np.float32)


def _box_corners(points: Array) -> Array:
    """Return the (8, 3) corners of the box around (n, 3) points."""
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing='ij'), axis=-1).reshape(8, 3)


def _matter(part: VisualPart, link: int) -> list[float]:
    """Return a row of `RoverPass.parts`."""
    red, green, blue = part.albedo
    return [float(link), float(np.dot(part.albedo, _LUMINANCE)), math.log(red / green),
            math.log(blue / green), *part.gloss]


def _triangles(part: VisualPart, number: int, link: int) -> Array:
    """Return the (3 f, 8) vertices of a part: position, face normal, its number, its link."""
    corners = part.vertices[part.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    rest = np.broadcast_to([float(number), float(link)], (len(corners), 3, 2))
    return np.concatenate([corners, np.repeat(normal[:, None], 3, axis=1), rest],
                          axis=2).reshape(-1, 8)
