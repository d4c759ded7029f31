"""The rover as triangle meshes, for the renderer.

The rover has a body in gold foil, a deck of solar cells, a mast with the stereo head, an antenna,
motor housings at the axles, and spoke legs with dark round tips. The geometry follows the
description: legs and tips are drawn where they collide.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.frames import Array, BASE_FRAME, se3
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import camera_poses, MAST_RADIUS_M
from lunar_rover_sim.rover.primitives import box, cylinder, merge, Mesh, sphere, transformed

GOLD = (0.62, 0.45, 0.16)
ALUMINIUM = (0.55, 0.55, 0.57)
WHITE = (0.80, 0.80, 0.78)
CELLS = (0.04, 0.05, 0.11)
FRAME = (0.35, 0.35, 0.37)
BLACK = (0.02, 0.02, 0.02)
RUBBER = (0.06, 0.06, 0.065)
# Gloss of these: roughness alpha of GGX, reflectance at normal incidence, and how crumpled the
# surface is, as the usual tilt of its facets. Metals and foil mirror most of their light; paint,
# rubber and cover glass 4 %. Choices within what such surfaces have.
GLOSS = {GOLD: (0.22, 0.75, 0.22), ALUMINIUM: (0.38, 0.6, 0.0), WHITE: (0.55, 0.04, 0.0),
         CELLS: (0.08, 0.04, 0.0), FRAME: (0.45, 0.25, 0.0), BLACK: (0.05, 0.04, 0.0),
         RUBBER: (0.6, 0.04, 0.0)}


class VisualPart(NamedTuple):
    """One part of one colour.

    Attributes:
        link: base_link or the name of a leg.
        vertices: (v, 3) float32 in that link's frame [m], leg frames at the axle with joint angle
            0.
        faces: (f, 3) int32, counter-clockwise seen from outside.
        albedo: Linear red, green, blue reflectance.
        gloss: As in `GLOSS`.
    """

    link: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    albedo: tuple[float, float, float]
    gloss: tuple[float, float, float]


@functools.lru_cache(maxsize=2)     # each renderer asks three times
def visual_parts(rover: RoverDescription) -> tuple[VisualPart, ...]:
    """Return the rover's parts; about 5,500 triangles."""
    parts = [_part(BASE_FRAME, mesh, albedo) for mesh, albedo in _base(rover)]
    for leg, (_, y, _) in zip(rover.legs.names, rover.legs.axle_positions_m()):
        parts += [_part(leg, mesh, albedo) for mesh, albedo in _leg(rover, math.copysign(1, y))]
    return tuple(parts)


def link_poses(rover: RoverDescription,
               joint_angle_rad: ArrayLike | None = None) -> dict[str, Array]:
    """Return T_base_link (4, 4) of base_link and the legs.

    Args:
        joint_angle_rad: (legs,) joint angles [rad]; None or empty: all 0.
    """
    poses = {BASE_FRAME: np.eye(4)}
    angles = np.asarray([] if joint_angle_rad is None else joint_angle_rad, dtype=float)
    if not len(angles):
        angles = np.zeros(len(rover.legs.each))
    for leg, position, angle in zip(rover.legs.names, rover.legs.axle_positions_m(), angles):
        c, s = math.cos(angle), math.sin(angle)
        poses[leg] = se3(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), position)
    return poses


def _base(rover: RoverDescription) -> list[tuple[Mesh, tuple[float, float, float]]]:
    length, width, height = (rover.chassis.length_m, rover.chassis.width_m,
                             rover.chassis.height_m)
    legs = rover.legs
    top = height / 2
    bevel = 0.15 * height
    body = box((length, width, height), bevel=bevel)
    # The deck overhangs the body a little and leaves room for the mast in front.
    mast = np.array(rover.stereo.position_m)
    front = min(mast[0] - 3.0 * MAST_RADIUS_M, length / 2)
    rear = -length / 2 - 0.01
    if front - rear < 0.05:
        front = length / 2
    deck_length, deck_x, deck_z = front - rear, (front + rear) / 2, top + 0.008
    deck = box((deck_length, width + 0.02, 0.006), (deck_x, 0.0, deck_z))
    cells = []
    columns, rows = 4, 3
    cell = np.array([deck_length / columns, (width + 0.02) / rows])
    for i in range(columns):
        for j in range(rows):
            centre = (rear + (i + 0.5) * cell[0], (j - 0.5 * (rows - 1)) * cell[1],
                      deck_z + 0.0035)
            cells.append(box((cell[0] - 0.006, cell[1] - 0.006, 0.002), centre))
    spacers = [cylinder((x, y, top - 0.001), (x, y, deck_z), 0.004, 8)
               for x in (rear + 0.03, front - 0.02) for y in (-width / 3, width / 3)]
    motors = []
    for x, y, z in legs.axle_positions_m():
        inner = math.copysign(width / 2 - 0.01, y)
        motors.append(cylinder((x, inner, z), (x, y - math.copysign(0.008, y), z), 0.011, 16))
    items = [(body, GOLD), (merge(motors), ALUMINIUM), (merge([deck, *spacers]), FRAME),
             (merge(cells), CELLS)]
    items += _mast(rover, top)
    antenna = np.array([-length / 2 + 0.03, -width / 2 + 0.02, top])
    whip = merge([cylinder(antenna, antenna + (-0.02, 0.0, 0.12), 0.0015, 6),
                  sphere(antenna + (-0.02, 0.0, 0.12), 0.004, 8, 5)])
    items.append((whip, WHITE))
    return items


def _mast(rover: RoverDescription, top: float) -> list[tuple[Mesh, tuple[float, float, float]]]:
    """Return mast and stereo head; the lenses are at the camera poses, the housing behind them."""
    x, y, z = rover.stereo.position_m
    left, right = camera_poses(rover)
    depth, head_height = 0.028, 0.036
    width = rover.stereo.baseline_m + 0.04
    # Nothing of the head may stand in front of the lenses.
    middle = left.copy()
    middle[:3, 3] = (left[:3, 3] + right[:3, 3]) / 2
    setback = 0.008
    head = transformed(box((depth, width, head_height), (-setback - depth / 2, 0.0, 0.0),
                           bevel=0.004), middle)
    rims, glass = [], []
    for pose in (left, right):
        rims.append(transformed(cylinder((-setback - 0.002, 0.0, 0.0), (-0.003, 0.0, 0.0), 0.012,
                                         20), pose))
        glass.append(transformed(cylinder((-0.004, 0.0, 0.0), (-0.002, 0.0, 0.0), 0.009, 20),
                                 pose))
    items = [(head, WHITE), (merge(rims), FRAME), (merge(glass), BLACK)]
    foot_x = float(middle[0, 3]) - setback - depth / 2
    if z - head_height / 2 > top:
        items.append((cylinder((foot_x, y, top - 0.002), (foot_x, y, z), MAST_RADIUS_M, 16),
                      ALUMINIUM))
    return items


def _leg(rover: RoverDescription, side: float) -> list[tuple[Mesh, tuple[float, float, float]]]:
    legs = rover.legs
    hub_radius = max(2.2 * legs.spoke_radius_m, 0.012)
    hub = cylinder((0.0, -0.009, 0.0), (0.0, 0.009, 0.0), hub_radius, 20)
    cap = cylinder((0.0, side * 0.009, 0.0), (0.0, side * 0.013, 0.0), 0.6 * hub_radius, 16)
    spokes, tips = [], []
    for direction in np.array(legs.spoke_directions()):
        end = (legs.spoke_length_m - legs.tip_radius_m) * direction
        spokes.append(cylinder((0.0, 0.0, 0.0), end, legs.spoke_radius_m, 12))
        tips.append(sphere(end, legs.tip_radius_m, 16, 10))
    return [(merge([hub, *spokes]), ALUMINIUM), (cap, GOLD), (merge(tips), RUBBER)]


def _part(link: str, mesh: Mesh, albedo: tuple[float, float, float]) -> VisualPart:
    vertices, faces = mesh[0].astype(np.float32), mesh[1].astype(np.int32)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return VisualPart(link, vertices, faces, albedo, GLOSS[albedo])
