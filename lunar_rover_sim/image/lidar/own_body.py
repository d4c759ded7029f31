"""Beams that meet the rover that carries the sensor: its body, which stands, and its legs.

The body is what collides of it and what is drawn of it. A leg is what collides: a capsule and a
sphere for each spoke. Few beams can meet a leg, however it stands; they are chosen once.
"""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, BASE_FRAME
from lunar_rover_sim.image.lidar.beam_pattern import BeamPattern
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY, rover_spec
from lunar_rover_sim.rover.mounts import lidar_pose
from lunar_rover_sim.rover.visual import visual_parts

_COLLIDES, _DRAWN, _LEGS = 1, 2, 3      # groups of geoms


@dataclasses.dataclass(frozen=True)
class _Leg:
    """A leg and the beams that may meet it.

    Attributes:
        number: In the rover's legs.
        beam: (m,).
        origin: (3,) of the beams from the axle, base axes.
        direction: (m, 3).
    """

    number: int
    beam: NDArray[np.int64]
    origin: Array
    direction: Array


class OwnBody:
    """The rover as the beams of its sensor meet it.

    Attributes:
        body_m: (n,) distances at which beams meet the body, inf for none.
        body_normal: (n, 3) outward unit normals there, base axes.
        free: (m,) beams that do not meet the body.
        legs_met: Whether any beam may meet a leg.
    """

    def __init__(self, rover: RoverDescription, pattern: BeamPattern) -> None:
        """Look where the n beams of a pattern meet the body.

        Raises:
            ConfigError: For a mount from which every beam meets it, as within the chassis.
        """
        T_base_lidar = lidar_pose(rover)
        origin = T_base_lidar[:3, 3]
        rays = pattern.direction @ T_base_lidar[:3, :3].T
        self.body_m, self.body_normal = _body(rover, origin, rays)
        self.free = np.flatnonzero(np.isinf(self.body_m))
        if not len(self.free):
            raise ConfigError(f'rover.lidar.position_m: {list(rover.lidar.position_m)} is not '
                              f'valid with rpy_deg = {list(rover.lidar.rpy_deg)}; valid is '
                              'outside chassis and mast, where a beam passes them')
        legs = rover.legs
        self._column = np.asarray(pattern.column, np.int64)
        self._ends = np.array([(legs.spoke_length_m - legs.tip_radius_m) * np.asarray(d, float)
                               for d in legs.spoke_directions()])
        self._radii = legs.spoke_radius_m, legs.tip_radius_m
        self._legs = []
        for number, axle in enumerate(legs.axle_positions_m()):
            o = origin - np.asarray(axle, float)
            beam = np.flatnonzero(_passes(o, rays, legs.spoke_length_m, max(self._radii)))
            if len(beam):
                self._legs.append(_Leg(number, beam, o, rays[beam]))

    @property
    def legs_met(self) -> bool:
        """Whether any beam may meet a leg."""
        return bool(self._legs)

    def legs(self, joint_angle_rad: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Return which beams meet a leg: (m,) beams, distances [m], and (m, 3) normals, base axes.

        Args:
            joint_angle_rad: (columns, legs) angles at each column.
        """
        beams, distances, normals = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros((0, 3))]
        for leg in self._legs:
            angle = joint_angle_rad[self._column[leg.beam], leg.number]
            c, s = np.cos(angle), np.sin(angle)
            origin = np.broadcast_to(leg.origin, leg.direction.shape)
            distance, normal = self._spokes(_turned(origin, c, s), _turned(leg.direction, c, s))
            met = np.isfinite(distance)
            beams.append(leg.beam[met])
            distances.append(distance[met])
            normals.append(_turned(normal[met], c[met], -s[met]))
        return np.concatenate(beams), np.concatenate(distances), np.concatenate(normals)

    def _spokes(self, o: Array, d: Array) -> tuple[Array, Array]:
        """Return (m,) distances at which rays meet a leg, inf for none, and (m, 3) normals there.

        Args:
            o: (m, 3) origins in axes of the leg, at its axle.
            d: (m, 3) directions in the same axes.
        """
        rod_m, tip_m = self._radii
        nearest, normal = np.full(len(d), np.inf), np.zeros((len(d), 3))
        for end in self._ends:
            axis = end / np.linalg.norm(end)
            for at, radius in ((np.zeros(3), rod_m), (end, rod_m), (end, tip_m)):
                _note(nearest, normal, _sphere(o - at, d, radius), o - at, d)
            across_o, across_d = (v - (v @ axis)[:, None] * axis for v in (o, d))
            distance = _rod(o @ axis, d @ axis, across_o, across_d, np.linalg.norm(end), rod_m)
            _note(nearest, normal, distance, across_o, across_d)
        return nearest, normal


def _note(nearest: Array, normal: Array, distance: Array, o: Array, d: Array) -> None:
    """Take over distances that are nearer, and normals: along o + distance d."""
    new = np.flatnonzero(distance < nearest)
    nearest[new] = distance[new]
    out = o[new] + distance[new, None] * d[new]
    normal[new] = out / np.linalg.norm(out, axis=1, keepdims=True)


def _sphere(o: Array, d: Array, radius: float) -> Array:
    """Return where rays enter a sphere about the origin, inf where they do not."""
    along = np.einsum('ij,ij->i', o, d)
    rest = along * along - np.einsum('ij,ij->i', o, o) + radius * radius
    distance = -along - np.sqrt(np.maximum(rest, 0.0))
    return np.where((rest >= 0.0) & (distance >= 0.0), distance, np.inf)


def _rod(o_axis: Array, d_axis: Array, across_o: Array, across_d: Array, length: np.floating,
         radius: float) -> Array:
    """Return where rays enter the side of a cylinder that begins at the origin, else inf.

    Args:
        o_axis: (m,) origins along the axis.
        d_axis: (m,) directions along the axis.
        across_o: (m, 3) origins across it.
        across_d: (m, 3) directions across it.
    """
    a = np.maximum(np.einsum('ij,ij->i', across_d, across_d), 1e-18)
    b = np.einsum('ij,ij->i', across_o, across_d)
    rest = b * b - a * (np.einsum('ij,ij->i', across_o, across_o) - radius * radius)
    distance = (-b - np.sqrt(np.maximum(rest, 0.0))) / a
    place = o_axis + distance * d_axis
    inside = (place >= 0.0) & (place <= length)
    return np.where((rest >= 0.0) & (distance >= 0.0) & inside, distance, np.inf)


def _turned(v: Array, c: Array, s: Array) -> Array:
    """Return (m, 3) vectors in axes that are turned about y by angles of cosine c and sine s."""
    return np.stack([c * v[:, 0] - s * v[:, 2], v[:, 1], s * v[:, 0] + c * v[:, 2]], axis=1)


def _passes(o: Array, d: Array, reach_m: float, half_m: float) -> NDArray[np.bool_]:
    """Return which rays pass the space that a leg sweeps, with its axle at the origin along y."""
    with np.errstate(divide='ignore', invalid='ignore'):
        a, b = (-half_m - o[1]) / d[:, 1], (half_m - o[1]) / d[:, 1]
    begin = np.maximum(np.nan_to_num(np.minimum(a, b), nan=-np.inf), 0.0)
    end = np.nan_to_num(np.maximum(a, b), nan=np.inf)
    beside = np.abs(d[:, 1]) < 1e-12
    begin[beside], end[beside] = 0.0, (np.inf if abs(o[1]) <= half_m else -1.0)
    flat = d[:, [0, 2]]
    nearest = -(flat @ o[[0, 2]]) / np.maximum((flat * flat).sum(axis=1), 1e-18)
    nearest = np.clip(nearest, begin, np.maximum(end, begin))
    apart = np.linalg.norm(o[[0, 2]] + nearest[:, None] * flat, axis=1)
    return (end >= begin) & (apart <= reach_m)


def _body(rover: RoverDescription, origin: Array, rays: Array) -> tuple[Array, Array]:
    """Return (n,) distances at which rays meet the body, inf for none, and (n, 3) normals."""
    spec = rover_spec(rover)
    for leg in rover.legs.names:
        for geom in spec.body(leg).geoms:
            geom.group = _LEGS
    for k, part in enumerate(p for p in visual_parts(rover) if p.link == BASE_FRAME):
        mesh = spec.add_mesh(name=f'part {k}', uservert=part.vertices.ravel(),
                             userface=part.faces.ravel(),
                             inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        spec.body(BASE_BODY).add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name,
                                      group=_DRAWN, contype=0, conaffinity=0, density=0.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qpos[3] = 1.0
    mujoco.mj_forward(model, data)
    groups = np.zeros(6, np.uint8)
    groups[[_COLLIDES, _DRAWN]] = 1
    distance, normal = np.empty(len(rays)), np.empty(3 * len(rays))
    mujoco.mj_multiRay(model, data, origin, np.ravel(rays), groups, True, -1,
                       np.empty(len(rays), np.int32), distance, normal, len(rays), 1e10)
    met = distance >= 0.0
    return (np.where(met, distance, np.inf),
            np.where(met[:, None], normal.reshape(-1, 3), 0.0))
