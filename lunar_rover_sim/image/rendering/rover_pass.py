"""The pass of the rover: its meshes, link by link."""

from __future__ import annotations

import math

import moderngl
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.image.rendering import texture_units
from lunar_rover_sim.image.rendering.context import (enable, load_program, release_all,
                                                     set_uniform, Uniforms)
from lunar_rover_sim.image.rendering.projection import ViewVolume
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.visual import link_poses, visual_parts, VisualPart

_LUMINANCE = (0.2126, 0.7152, 0.0722)       # of linear red, green, blue (ITU-R BT.709)


MAP = 768               # pixels along a side of the map of the shadow of the rover on itself


class RoverPass:
    """Draws the rover.

    Attributes:
        programs: Of light, and of light with truth once that is prepared.
    """

    def __init__(self, context: moderngl.Context, rover: RoverDescription, lamp: bool) -> None:
        """Make meshes and programs; lamp: whether there is one."""
        self._context, self._rover = context, rover
        self._links = list(link_poses(rover))
        self._defines = {'LINKS': len(self._links), **({'LAMP': 1} if lamp else {})}
        data = np.concatenate([_triangles(part, self._links.index(part.link))
                               for part in visual_parts(rover)])
        self._boxes = np.stack([_box_corners(data[data[:, 7] == k, :3])
                                for k in range(len(self._links))])
        # First, second and third corners of the faces of each link.
        self._faces = [np.ascontiguousarray(data[data[:, 7] == k, :3].reshape(-1, 3, 3)
                                            .transpose(1, 0, 2)) for k in range(len(self._links))]
        self._vertices = context.buffer(data.astype(np.float32).tobytes())
        self._arrays: dict[int, moderngl.VertexArray] = {}
        self.programs = [self._load('rover', **self._defines)]
        self._mark = self._load('rover_mark', LINKS=len(self._links))
        self._from_sun = np.eye(4)      # as `cast` draws the map
        self._own_map = context.depth_texture((MAP, MAP))
        self._own_map.repeat_x = self._own_map.repeat_y = False
        self._own_target = context.framebuffer(depth_attachment=self._own_map)
        self._depth = load_program(context, 'rover_depth', 'rover_depth', LINKS=len(self._links))
        self._arrays[self._depth.glo] = context.vertex_array(
            self._depth, [(self._vertices, '3f 16x 1f 20x', 'a_position', 'a_link')])

    def _load(self, fragment: str, **defines: int) -> moderngl.Program:
        program = load_program(self._context, 'rover', fragment, **defines)
        self._arrays[program.glo] = self._context.vertex_array(
            program, [(self._vertices, '3f 3f 1f 1f 2f 3f', 'a_position', 'a_normal', 'a_albedo',
                       'a_link', 'a_tint', 'a_gloss')], skip_errors=True)
        return program

    def prepare_truth(self) -> None:
        """Be able to draw truth from now on; adds to `programs`."""
        self.programs.append(self._load('rover', TRUTH=1, **self._defines))

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
              irradiance: float) -> Uniforms:
        """Return the light on the rover.

        Args:
            radius_m: Reach of the rover from its base.
            irradiance: Of the sun, normal [W/m2].
        """
        base = T_world_links[0]
        span = base[2, 3] + radius_m * np.array([-0.5, 0.8])
        points = np.array([[*base[:2, 3], z] for z in span])
        clearance, occluder = sunlight.light_of(points)
        surroundings = float(sunlight.surroundings_at(base[:2, 3]))
        return {'u_body_span': tuple(span),
                'u_body_light': (clearance[0], occluder[0], clearance[1], occluder[1]),
                'u_ground_light': irradiance * surroundings}

    def cast(self, T_world_links: Array, sun_axes: Array, radius_m: float) -> None:
        """Draw the map of the rover's shadow on itself; another framebuffer is in use afterwards.

        Args:
            sun_axes: (3, 3) as `rock_shadow.sun_axes`.
            radius_m: Reach of the rover from its base.
        """
        axes = np.array([[1.0], [1.0], [-1.0]]) * sun_axes / (1.05 * radius_m)
        self._from_sun = np.eye(4)
        self._from_sun[:3, :3] = axes
        self._from_sun[:3, 3] = -axes @ T_world_links[0, :3, 3]
        self._own_target.use()
        self._own_target.clear(depth=1.0)
        self._context.enable_only(self._context.DEPTH_TEST)
        set_uniform(self._depth, u_links=_columns(T_world_links),
                    u_from_sun=_columns(self._from_sun[None]))
        self._arrays[self._depth.glo].render()

    def draw(self, T_world_links: Array, light: Uniforms, *, truth: bool = False,
             add: bool = False) -> None:
        """Draw the rover into the framebuffer in use.

        Args:
            add: Whether to add to the present radiance.
            truth: Whether to draw that too, into the attachments of `TruthTargets`.
        """
        enable(self._context, self._context.DEPTH_TEST, add=add)
        program = self.programs[int(truth)]
        self._own_map.use(texture_units.ROVER_OWN)
        set_uniform(program, u_links=_columns(T_world_links), u_own_map=texture_units.ROVER_OWN,
                    u_from_sun=_columns(self._from_sun[None]), **light)
        self._arrays[program.glo].render()

    def mark(self, T_world_links: Array, depth: moderngl.Texture) -> None:
        """Draw 1 + the index of the link that is seen into the framebuffer in use.

        Args:
            depth: Of all that is seen, in a texture of the same size [m].
        """
        self._context.enable_only(self._context.DEPTH_TEST)
        depth.use(texture_units.OBJECT_DEPTH)
        set_uniform(self._mark, u_links=_columns(T_world_links),
                    u_depth=texture_units.OBJECT_DEPTH)
        self._arrays[self._mark.glo].render()

    def release(self) -> None:
        """Release the GL objects."""
        release_all(*self._arrays.values(), self._vertices, *self.programs,
                    self._mark, self._depth, self._own_target, self._own_map)


def _columns(transforms: Array) -> Array:
    """Return (n, 4, 4) transforms as GL reads them, column by column."""
    return np.ascontiguousarray(transforms.transpose(0, 2, 1), np.float32)


def _box_corners(points: Array) -> Array:
    """Return the (8, 3) corners of the box around (n, 3) points."""
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    return np.stack(np.meshgrid(*ends.T, indexing='ij'), axis=-1).reshape(8, 3)


def _triangles(part: VisualPart, link: int) -> Array:
    """Return the (3 f, 13) vertices of a part: position, face normal, grey albedo, link, the
    logarithms of red and blue over green, and gloss.
    """
    corners = part.vertices[part.faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    grey = float(np.dot(part.albedo, _LUMINANCE))
    red, green, blue = part.albedo
    rest = np.broadcast_to([grey, float(link), math.log(red / green), math.log(blue / green),
                            *part.gloss], (len(corners), 3, 7))
    return np.concatenate([corners, np.repeat(normal[:, None], 3, axis=1), rest],
                          axis=2).reshape(-1, 13)
