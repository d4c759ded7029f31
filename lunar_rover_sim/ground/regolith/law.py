"""The law of soil under the round tips of spokes, compiled: they sink, hold, slip, dig and plough.

Each tip in the ground stands on a plane of its own, the plastic depth z below the surface. MuJoCo
presses the tip against it: the elastic part e, so that the lowest point of the tip is d = z + e
deep. Every force is a continuous function of the state: nothing is switched.

Normal force. Spring and damper in line with a slider (Bingham): the soil carries

    f = min(k e + c(e) de/dt, F(z)),   F(z) = bearing of ball and rod at the depth z,

and where the left one is the smaller, the soil holds: dz/dt = 0. Where it yields, z follows from
k e + c(e) (d' - dz/dt) = F(z): at the end of each step, by bisection (backward Euler). The force
begins with 0: at touch-down as F(0) = 0, and where a tip comes back to soil that holds as the
damper, and the mass that MuJoCo's contact carries, grow with e over the first 0.2 mm (Hunt and
Crossley 1975). It passes smoothly from yielding to holding.

    F(z) = zeta pi (R z^2 - z^3 / 3) up to z = R,   zeta pi R^2 (z - R / 3) beyond,

each facet of the ball counted by its projection on the ground with zeta, the force per area and
depth of a flat plate (Li, Zhang and Goldman, Science 339, 2013: generic coefficients at beta = 0).
Above z = 2 R the rod follows, of radius r and tilted by t: zeta r tan t (z - 2 R)^2. Cohesion adds
its bearing pressure (Prandtl 1921) times the cap's area. A slope bears (1 - tan b)^2 of it (Vesic
1975), loose soil a part (`ground/regolith/looseness.py`).

Digging. A tip that slips a way w goes the way on which the soil bears its load, down or up:
dz = w s(f / F(z), z / R), s from resistive force theory (`ground/regolith/resistive_force.py`).

Friction. Coulomb's, and what sunken tip and rod plough, over the normal force:

    mu = (tan phi + H(z) / f) m,   m = 1 - exp(-way / K) (Janosi and Hanamoto 1961).

H(z) = zeta a S(z) with a the force on an upright plate over that on a flat one, and S(z) the first
moment of the silhouette: R^3 ((2 / 3) sin^3 t - u (t - u sin t)), u = 1 - z / R = cos t; below
z = 2 R it is pi R^2 (z - R), and the rod adds r (z - 2 R)^2. On a slope the soil carries itself
with a part of that strength.

The surface is the untouched ground plus what the prints there have changed when the tip touched
down. A tip that moves on meets what lies ahead, in proportion to its way. Soil that bore a print
before holds until its former depth is reached again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from llvmlite import ir
from numba import types
from numba.extending import intrinsic
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, read_only
from lunar_rover_sim.ground.regolith.overlay import CELL_M, NearTiles, TILE
from lunar_rover_sim.ground.regolith.soil import IMPEDANCE, PARKED_M
from lunar_rover_sim.ground.world.grid import height_of_triangles, HeightGrid

# What a step left to be done: nothing, a print to be pressed in, a tip that left its print, and a
# tip whose motion has diverged.
NOTHING, PRINT, LEFT, DIVERGED = 0, 1, 2, 3

_NEAR_M = 0.002          # a tip this low is about to touch down
_ONSET_M = 0.0002        # elastic depth over which damper and carried mass grow from 0
_CREEP_MPS = 1e-4        # of the speed of a tip, this is creep of MuJoCo's solver, not slip
_LIFT_OFF_M = 0.0015     # a tip this far above its plane has left its print
_GREATEST_FRICTION = 10.0
_LEAST_MOBILISED = 0.05  # part of the friction of a tip that has not slipped yet
_LEAST_BEARING_ROOT = 0.1   # a slope of 42 deg and more leaves a hundredth of the bearing
_MOST_LEAN = 2.0         # of the rod [tan]
_PRINT_DEPTH_M, _PRINT_WAY_M = 0.0005, 0.004    # a print is pressed in after so much motion
_BISECTIONS = 42         # halve a bracket of 0.1 m to the last digits of a float

Record = Any    # of a structured array; compiled code reads its fields as attributes
VECTOR = (np.float64, 3)
TIP = np.dtype([
    # where it is: leg, and the offset from the axle in the frame of the leg [m]
    ('leg', np.int64), ('offset', *VECTOR),
    # rows of MuJoCo's arrays; solref of the contact while the soil holds; what of it holds now
    ('mocap', np.int64), ('pair', np.int64), ('held', np.float64, 2), ('sprung', np.float64),
    ('damped', np.float64),
    # centre, its velocity, rate of the leg, axle from the centre: world frame [m], [m/s], [rad/s]
    ('centre', *VECTOR), ('velocity', *VECTOR), ('rate', *VECTOR), ('rod', *VECTOR),
    # the surface: position, change against the untouched ground, tilt of the print, unit normal
    ('at', np.float64, 2), ('change', np.float64), ('tilt', np.float64, 2), ('normal', *VECTOR),
    # depths along the normal [m], force [N], friction, way slipped since the touch down [m]
    ('in_ground', np.bool_), ('depth', np.float64), ('plastic', np.float64),
    ('elastic', np.float64), ('force', np.float64), ('friction', np.float64),
    ('sheared', np.float64),
    # the ball in its print: when it was pressed in, where it is, and its lowest place since
    ('pressed', *VECTOR), ('low', *VECTOR), ('event', np.int64)])

LEG = np.dtype([('axle', *VECTOR), ('attitude', np.float64, (3, 3)), ('axis', *VECTOR)])

SOIL = np.dtype([(name, np.float64) for name in (
    'radius_m', 'rod_m', 'step_s', 'elastic_npm', 'damping_nspm', 'zeta_npm3', 'friction',
    'cohesion_pa', 'cohesive_bearing_pa', 'compacted', 'shear_m', 'side_ratio', 'weak_slopes',
    'bearing_ratio', 'friction_ratio', 'deepest_m')])


# --- What soil bears --------------------------------------------------------------------------

@compiled
def bearing_n(depth_m: float, radius_m: float, zeta_npm3: float) -> float:
    """Return F(z) of the ball alone [N]; 0 above the surface."""
    if depth_m <= 0.0:
        return 0.0
    if depth_m <= radius_m:
        return zeta_npm3 * math.pi * depth_m * depth_m * (radius_m - depth_m / 3.0)
    return zeta_npm3 * math.pi * radius_m * radius_m * (depth_m - radius_m / 3.0)


@compiled
def contact_area_m2(depth_m: float, radius_m: float) -> float:
    """Return the area of the ball's cap on the surface [m^2], that of its equator from R on."""
    depth = min(max(depth_m, 0.0), radius_m)
    return math.pi * depth * (2.0 * radius_m - depth)


@compiled
def silhouette_m3(depth_m: float, radius_m: float) -> float:
    """Return S(z) [m^3]: the depth integrated over the silhouette of the ball below ground."""
    if depth_m <= 0.0:
        return 0.0
    if depth_m >= 2.0 * radius_m:
        return math.pi * radius_m * radius_m * (depth_m - radius_m)
    u = 1.0 - depth_m / radius_m
    t = math.acos(u)
    sine = math.sin(t)
    return radius_m ** 3 * (2.0 / 3.0 * sine ** 3 - u * (t - u * sine))


@compiled
def bears_n(depth_m: float, lean: float, soil: Record) -> float:
    """Return what level soil bears at a plastic depth [N].

    Args:
        depth_m: of the lowest point of the tip.
        lean: tangent of the angle between the rod and the normal.
        soil: a record of `SOIL`.
    """
    radius = soil.radius_m
    bears = bearing_n(depth_m, radius, soil.zeta_npm3)
    bears += soil.cohesive_bearing_pa * contact_area_m2(depth_m, radius)
    below = max(depth_m - 2.0 * radius, 0.0)
    return bears + soil.zeta_npm3 * soil.rod_m * lean * below * below


@compiled
def onset(elastic_m: float) -> float:
    """Return the part of damper and carried mass that an elastic depth has."""
    return min(max(elastic_m / _ONSET_M, 0.0), 1.0)


@compiled
def ploughs_n(depth_m: float, reserve: float, soil: Record) -> float:
    """Return the sideways force on tip and rod [N].

    Args:
        depth_m: of the lowest point of the tip.
        reserve: part of the strength that slope and looseness leave.
        soil: a record of `SOIL`.
    """
    radius = soil.radius_m
    below = max(depth_m - 2.0 * radius, 0.0)
    moment = silhouette_m3(depth_m, radius) + soil.rod_m * below * below
    return (soil.zeta_npm3 * soil.side_ratio * moment * reserve
            + soil.cohesion_pa * contact_area_m2(depth_m, radius))


@compiled
def bearing_on_slope(tangent: float, soil: Record) -> float:
    """Return the bearing on a slope over that on level ground: (1 - tan b)^2.

    The ground inclination factor of surcharge and weight (Vesic, in Winterkorn and Fang,
    Foundation Engineering Handbook, 1975). Hansen (1970) has (1 - 0.5 tan b)^5, 0.63, 0.37 and
    0.18 at 10, 20 and 30 deg, where this is 0.68, 0.40 and 0.18.
    """
    return max(1.0 - tangent, _LEAST_BEARING_ROOT) ** 2 if soil.weak_slopes > 0.0 else 1.0


@compiled
def dig_slope(load: float, depth: float, table: np.ndarray, deepest: float) -> float:
    """Return depth gained per way slipped, bilinear in a table, between its bounds.

    Args:
        load: as a part of F(z), from 0 to 1.
        depth: in radii, from 0 to `deepest`.
        table: (depths + 1, loads + 1) of `resistive_force.dig_table`.
        deepest: depth of its last row, in radii.
    """
    depths, loads = table.shape[0] - 1, table.shape[1] - 1
    x = min(max(load, 0.0), 1.0) * loads
    y = min(max(depth / deepest, 0.0), 1.0) * depths
    i, k = min(int(x), loads - 1), min(int(y), depths - 1)
    u, v = x - i, y - k
    return ((table[k, i] * (1.0 - u) + table[k, i + 1] * u) * (1.0 - v)
            + (table[k + 1, i] * (1.0 - u) + table[k + 1, i + 1] * u) * v)


# --- The surface ------------------------------------------------------------------------------

_height = compiled(height_of_triangles)


class Heights(NamedTuple):
    """A `HeightGrid`, as compiled code takes it."""

    samples_m: NDArray[np.float32]
    cell_m: float
    first_x: float
    first_y: float

    @staticmethod
    def of(grid: HeightGrid) -> Heights:
        """Return those of a grid."""
        return Heights(read_only(grid.heights_m, np.float32), grid.cell_m, *grid.first)


@compiled
def height_on(ground: Heights, x: float, y: float) -> float:
    """Return the height of a grid at a position in the frame of the site [m]; NaN beyond it."""
    return _height(x, y, ground.samples_m, ground.cell_m, ground.first_x, ground.first_y)


@compiled
def looseness_factors(x: float, y: float, loose: Heights,
                      soil: Record) -> tuple[float, float]:
    """Return the factors of looseness on bearing and on friction at a position.

    Args:
        x, y: position [m].
        loose: looseness times its variation; one sample where the soil is the same everywhere.
        soil: a record of `SOIL`.
    """
    if loose.samples_m.shape[0] < 2:
        return 1.0, 1.0
    looseness = height_on(loose, x, y)
    if math.isnan(looseness):       # beyond the world
        return 1.0, 1.0
    return soil.bearing_ratio ** looseness, soil.friction_ratio ** looseness


@compiled
def _changed(x: float, y: float, which: int, near: NearTiles) -> float:
    """Return height change (0) or compaction (1) of the overlay at a position, bilinear [m]."""
    gx, gy = x / CELL_M, y / CELL_M
    ix, iy = math.floor(gx), math.floor(gy)
    u, v = gx - ix, gy - iy
    value = 0.0
    for j in range(2):
        for i in range(2):
            tx, ty = (ix + i) // TILE, (iy + j) // TILE
            column, row = tx - near.origin[0], ty - near.origin[1]
            if 0 <= column < near.slots.shape[1] and 0 <= row < near.slots.shape[0]:
                tile = near.slots[row, column]
                if tile >= 0:
                    weight = (u if i else 1.0 - u) * (v if j else 1.0 - v)
                    value += weight * near.samples[tile, which, iy + j - ty * TILE,
                                                   ix + i - tx * TILE]
    return value


@compiled
def _former_depth_m(change: float, compaction: float, compacted: float) -> float:
    """Return the depth of an earlier print whose soil still bears its load [m]."""
    if compaction <= 0.0 or change >= 0.0:
        return 0.0
    return min(-change, compaction / max(compacted, 1e-3))


# --- The rover --------------------------------------------------------------------------------

@compiled
def _rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Return the matrix of a quaternion wxyz, which is brought to length 1."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array([[1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
                     [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
                     [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)]])


@compiled
def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a @ b of (3, 3) matrices; `@` would be BLAS, which rounds by the processor."""
    result = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            result[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return result


@compiled
def place_tips(qpos: np.ndarray, qvel: np.ndarray, legs: np.ndarray, tips: np.ndarray) -> None:
    """Write centre, velocity and rod of each tip for MuJoCo's positions and velocities.

    Args:
        qpos: position (3,), attitude wxyz (4,) of base_link, then the angles of the legs.
        qvel: velocity (3,), world; rate (3,), base_link; then the rates of the legs.
        legs: (legs,) records of `LEG`.
        tips: (tips,) records of `TIP`.
    """
    R = _rotation(qpos[3], qpos[4], qpos[5], qpos[6])
    wx = R[0, 0] * qvel[3] + R[0, 1] * qvel[4] + R[0, 2] * qvel[5]
    wy = R[1, 0] * qvel[3] + R[1, 1] * qvel[4] + R[1, 2] * qvel[5]
    wz = R[2, 0] * qvel[3] + R[2, 1] * qvel[4] + R[2, 2] * qvel[5]
    known = -1
    M = R
    ax = ay = az = vx = vy = vz = lx = ly = lz = 0.0
    for k in range(len(tips)):
        tip = tips[k]
        leg = tip.leg
        if leg != known:
            known = leg
            arm = legs[leg]
            half = 0.5 * qpos[7 + leg]
            sine = math.sin(half)
            turned = _rotation(math.cos(half), arm.axis[0] * sine, arm.axis[1] * sine,
                               arm.axis[2] * sine)
            M = _product(_product(R, arm.attitude), turned)
            ax = R[0, 0] * arm.axle[0] + R[0, 1] * arm.axle[1] + R[0, 2] * arm.axle[2]
            ay = R[1, 0] * arm.axle[0] + R[1, 1] * arm.axle[1] + R[1, 2] * arm.axle[2]
            az = R[2, 0] * arm.axle[0] + R[2, 1] * arm.axle[1] + R[2, 2] * arm.axle[2]
            vx = qvel[0] + wy * az - wz * ay
            vy = qvel[1] + wz * ax - wx * az
            vz = qvel[2] + wx * ay - wy * ax
            rate = qvel[6 + leg]
            a = arm.axis
            lx = wx + rate * (M[0, 0] * a[0] + M[0, 1] * a[1] + M[0, 2] * a[2])
            ly = wy + rate * (M[1, 0] * a[0] + M[1, 1] * a[1] + M[1, 2] * a[2])
            lz = wz + rate * (M[2, 0] * a[0] + M[2, 1] * a[1] + M[2, 2] * a[2])
        o = tip.offset
        rx = M[0, 0] * o[0] + M[0, 1] * o[1] + M[0, 2] * o[2]
        ry = M[1, 0] * o[0] + M[1, 1] * o[1] + M[1, 2] * o[2]
        rz = M[2, 0] * o[0] + M[2, 1] * o[1] + M[2, 2] * o[2]
        tip.centre[0], tip.centre[1], tip.centre[2] = (qpos[0] + ax + rx, qpos[1] + ay + ry,
                                                       qpos[2] + az + rz)
        tip.rod[0], tip.rod[1], tip.rod[2] = -rx, -ry, -rz
        tip.velocity[0] = vx + ly * rz - lz * ry
        tip.velocity[1] = vy + lz * rx - lx * rz
        tip.velocity[2] = vz + lx * ry - ly * rx
        tip.rate[0], tip.rate[1], tip.rate[2] = lx, ly, lz


# --- One tip ----------------------------------------------------------------------------------

@compiled
def lean_of(tip: Record) -> float:
    """Return the tangent of the angle between the rod and the normal, at most 2."""
    n, r = tip.normal, tip.rod
    up = r[0] * n[0] + r[1] * n[1] + r[2] * n[2]
    across2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2] - up * up
    across = math.sqrt(max(across2, 0.0))
    return across / up if across < _MOST_LEAN * up else _MOST_LEAN


@compiled
def slip_mps(tip: Record, radius_m: float) -> float:
    """Return the speed of the tip's lowest point along the surface [m/s]."""
    n, w, v = tip.normal, tip.rate, tip.velocity
    px, py, pz = -radius_m * n[0], -radius_m * n[1], -radius_m * n[2]
    vx = v[0] + w[1] * pz - w[2] * py
    vy = v[1] + w[2] * px - w[0] * pz
    vz = v[2] + w[0] * py - w[1] * px
    across = vx * n[0] + vy * n[1] + vz * n[2]
    return math.sqrt(max(vx * vx + vy * vy + vz * vz - across * across, 0.0))


@compiled
def yielded(depth: float, plastic: float, elastic: float, way: float, part: float, lean: float,
            soil: Record, table: np.ndarray, deepest: float) -> float:
    """Return the elastic depth at the end of a step [m]: the root of the law in the file's head.

    Args:
        depth: of the tip at the end of the step [m].
        plastic, elastic: at its beginning [m].
        way: slipped in it [m].
        part: of the bearing of level soil.
        lean: tangent of the rod's tilt.
        soil: a record of `SOIL`.
        table, deepest: as for `dig_slope`.
    """
    if depth - plastic <= 0.0 and way == 0.0:
        return depth - plastic
    low, high = min(0.0, depth - plastic), depth
    for _ in range(_BISECTIONS):
        e = 0.5 * (low + high)
        z = depth - e
        force = soil.elastic_npm * e + soil.damping_nspm * onset(e) * (e - elastic) / soil.step_s
        bears = part * bears_n(z, lean, soil)
        beyond = force > bears
        if not beyond:
            moved = 0.0
            if way > 0.0:
                load = force / bears if bears > 1e-9 else 1.0
                moved = way * dig_slope(load, plastic / soil.radius_m, table, deepest)
            beyond = plastic + moved > z
        if beyond:
            high = e
        else:
            low = e
    return 0.5 * (low + high)


@compiled
def _lie(tip: Record, x: float, y: float, soil: Record,
         ground: Heights) -> tuple[float, float]:
    """Lay the surface of a tip along the ground around a position.

    Returns:
        Its height there [m] and the tangent of its slope.
    """
    reach = soil.radius_m
    slope_x = tip.tilt[0] + (height_on(ground, x + reach, y)
                             - height_on(ground, x - reach, y)) / (2.0 * reach)
    slope_y = tip.tilt[1] + (height_on(ground, x, y + reach)
                             - height_on(ground, x, y - reach)) / (2.0 * reach)
    slope2 = slope_x * slope_x + slope_y * slope_y
    nz = 1.0 / math.sqrt(1.0 + slope2)
    tip.normal[0], tip.normal[1], tip.normal[2] = -slope_x * nz, -slope_y * nz, nz
    tip.at[0], tip.at[1] = x, y
    return height_on(ground, x, y) + tip.change, math.sqrt(slope2)


@compiled
def _follow(tip: Record, x: float, y: float, soil: Record, near: NearTiles) -> None:
    """Let a tip that moves on in the ground meet the surface ahead of it."""
    dx, dy = x - tip.at[0], y - tip.at[1]
    way = math.sqrt(dx * dx + dy * dy)
    if way == 0.0:
        return
    depth = min(max(tip.depth, 0.0), soil.radius_m)
    inner = math.sqrt(depth * (2.0 * soil.radius_m - depth)) + 1.5 * CELL_M
    ahead_x, ahead_y = x + dx / way * inner, y + dy / way * inner
    change = _changed(ahead_x, ahead_y, 0, near)
    former = _former_depth_m(change, _changed(ahead_x, ahead_y, 1, near),
                             soil.compacted)
    part = min(1.0, way / (2.0 * inner))
    # On along the lean of the print, and towards what lies ahead.
    tip.change += tip.tilt[0] * dx + tip.tilt[1] * dy
    tip.change += part * (change + former - tip.change)
    tip.tilt[0] *= 1.0 - part
    tip.tilt[1] *= 1.0 - part
    tip.plastic += part * max(0.0, former * tip.normal[2] - tip.plastic)


@compiled
def _touch(tip: Record, x: float, y: float, soil: Record, near: NearTiles) -> float:
    """Take the changed ground below a tip in the air for its surface; return its former depth."""
    change = _changed(x, y, 0, near)
    former = _former_depth_m(change, _changed(x, y, 1, near), soil.compacted)
    reach = soil.radius_m
    tip.change = change + former
    tip.tilt[0] = (_changed(x + reach, y, 0, near)
                   - _changed(x - reach, y, 0, near)) / (2.0 * reach)
    tip.tilt[1] = (_changed(x, y + reach, 0, near)
                   - _changed(x, y - reach, 0, near)) / (2.0 * reach)
    return former


@compiled
def support(tip: Record, soil: Record, table: np.ndarray, deepest: float, ground: Heights,
            loose: Heights, near: NearTiles) -> None:
    """Let the soil under a tip yield, and set depths, force, friction and event of the tip."""
    x, y, z = tip.centre[0], tip.centre[1], tip.centre[2]
    radius, step = soil.radius_m, soil.step_s
    tip.event = NOTHING
    if not tip.in_ground:
        above = z - radius - (height_on(ground, x, y)
                              + _changed(x, y, 0, near))
        if not above < _NEAR_M:     # NaN beyond the world
            return
        former = _touch(tip, x, y, soil, near)
        height, slope = _lie(tip, x, y, soil, ground)
        n = tip.normal
        depth = radius - (z - height) * n[2]
        if depth <= former * n[2]:
            return
        tip.in_ground = True
        tip.plastic, tip.elastic, tip.sheared = former * n[2], 0.0, 0.0
    else:
        _follow(tip, x, y, soil, near)
        height, slope = _lie(tip, x, y, soil, ground)
        n = tip.normal
        depth = radius - (z - height) * n[2]
        if depth - tip.plastic < -_LIFT_OFF_M:
            tip.in_ground, tip.depth, tip.force, tip.elastic = False, 0.0, 0.0, 0.0
            tip.event = LEFT
            return
    # Strength here: on slopes and in loose soil less.
    bearing, friction = looseness_factors(x, y, loose, soil)
    friction *= soil.friction
    reserve = bearing * max(0.0, 1.0 - slope / friction)
    part = bearing * bearing_on_slope(slope, soil)
    # Depths at the end of the step.
    way = max(0.0, slip_mps(tip, radius) - _CREEP_MPS) * step if depth > tip.plastic else 0.0
    lean = lean_of(tip) if depth > 2.0 * radius else 0.0
    before = max(tip.elastic, 0.0)
    elastic = yielded(depth, tip.plastic, before, way, part, lean, soil, table, deepest)
    plastic = depth - elastic
    if not abs(depth) < soil.deepest_m:
        tip.depth, tip.event = depth, DIVERGED
        return
    bears = part * bears_n(plastic, lean, soil)
    k, c = soil.elastic_npm, soil.damping_nspm * onset(elastic)
    force = min(max(k * elastic + c * (elastic - before) / step, 0.0), bears)
    # MuJoCo sees the speed of the tip against a plane at rest: its spring would press by the depth
    # at the end of the step, its damper with more than the soil bears.
    rate = -(tip.velocity[0] * n[0] + tip.velocity[1] * n[1] + tip.velocity[2] * n[2])
    tip.sprung = 1.0
    if rate > 0.0 and elastic > 0.0:
        tip.sprung = elastic / (elastic + rate * step)
        c = min(max((bears - k * elastic) / rate, 0.0), c)
    tip.damped = c / soil.damping_nspm
    tip.depth, tip.plastic, tip.elastic, tip.force = depth, plastic, elastic, force
    tip.sheared += way
    mobilised = max(1.0 - math.exp(-tip.sheared / soil.shear_m), _LEAST_MOBILISED)
    tip.friction = mobilised * min(friction + ploughs_n(depth, reserve, soil) / max(force, 1e-6),
                                   _GREATEST_FRICTION)
    _note_print(tip, elastic)


@compiled
def _note_print(tip: Record, elastic: float) -> None:
    """Note where the ball presses: at its plastic depth. A first print begins where it touched."""
    n, low, last = tip.normal, tip.low, tip.pressed
    x = tip.centre[0] + elastic * n[0]
    y = tip.centre[1] + elastic * n[1]
    z = tip.centre[2] + elastic * n[2]
    if math.isnan(last[2]):
        last[0], last[1], last[2] = x, y, z
        low[0], low[1], low[2] = x, y, z
    elif last[2] - z > _PRINT_DEPTH_M or math.hypot(x - last[0], y - last[1]) > _PRINT_WAY_M:
        low[0], low[1], low[2] = x, y, z
        tip.event = PRINT
    elif z < low[2]:
        low[0], low[1], low[2] = x, y, z


# --- All tips, step by step -------------------------------------------------------------------

@intrinsic
def _call(typing: Any, function: Any, model: Any, data: Any) -> Any:
    """Call a C function of two pointers that returns nothing; all three are addresses."""
    def code(context: Any, builder: Any, _: Any, values: Any) -> Any:
        word = values[0].type
        pointer = ir.PointerType(ir.FunctionType(ir.VoidType(), [word, word]))
        builder.call(builder.inttoptr(values[0], pointer), values[1:])
        return context.get_dummy_value()

    return types.void(types.intp, types.intp, types.intp), code


@compiled
def sinkage_of(tips: np.ndarray, sinkage: np.ndarray) -> None:
    """Write the depth of the deepest tip of each leg that is in the ground, else 0 [m]."""
    sinkage[:] = 0.0
    for k in range(len(tips)):
        tip = tips[k]
        if tip.in_ground:
            sinkage[tip.leg] = max(sinkage[tip.leg], tip.depth)


class Mujoco(NamedTuple):
    """Arrays of one model and its data, which stay where they are."""

    qpos: np.ndarray
    qvel: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray
    pair_friction: np.ndarray
    pair_solref: np.ndarray
    pair_solreffriction: np.ndarray
    pair_solimp: np.ndarray
    leg_wrench: np.ndarray
    motor_torque: np.ndarray


@compiled
def advance(mj_step: int, model: int, data: int, steps: int, arrays: Mujoco, legs: np.ndarray,
            tips: np.ndarray, soils: np.ndarray, table: np.ndarray, deepest: float,
            ground: Heights, loose: Heights, near: NearTiles, slipped: np.ndarray,
            wrench: np.ndarray, torque: np.ndarray) -> tuple[int, bool]:
    """Make steps of soil and MuJoCo until one leaves something to be done for a tip.

    They end, too, where the rover leaves the place around which `near` has all tiles.

    Args:
        mj_step, model, data: addresses of MuJoCo's function and of its arguments.
        steps: how many at most.
        arrays: of MuJoCo.
        legs, tips, soils: records of `LEG`, `TIP` and one of `SOIL`.
        table, deepest: as for `dig_slope`.
        ground: the untouched one.
        loose: looseness of the soil on it, as for `looseness_factors`.
        near: of the overlay.
        slipped: (legs,) way of loaded tips, added to [m].
        wrench, torque: sums over steps of arrays.leg_wrench and arrays.motor_torque.

    Returns:
        The number of steps made, and whether a tip has an event.
    """
    soil = soils[0]
    mocap_pos, mocap_quat = arrays.mocap_pos, arrays.mocap_quat
    for made in range(steps):
        if (abs(arrays.qpos[0] - near.centre[0]) > near.centre[2]
                or abs(arrays.qpos[1] - near.centre[1]) > near.centre[2]):
            return made, False
        place_tips(arrays.qpos, arrays.qvel, legs, tips)
        stop = diverged = False
        for k in range(len(tips)):
            tip = tips[k]
            sheared = tip.sheared if tip.in_ground else 0.0
            support(tip, soil, table, deepest, ground, loose, near)
            if tip.event != NOTHING:
                stop = True
                diverged = diverged or tip.event == DIVERGED
            plane = mocap_pos[tip.mocap]
            if not tip.in_ground:
                plane[0], plane[1], plane[2] = 0.0, 0.0, PARKED_M
                continue
            slipped[tip.leg] += tip.sheared - sheared
            n, turn = tip.normal, mocap_quat[tip.mocap]
            above = soil.radius_m - tip.elastic
            for i in range(3):
                plane[i] = tip.centre[i] - above * n[i]
            scale = 1.0 / math.sqrt(2.0 * (1.0 + n[2]))
            turn[0], turn[1] = (1.0 + n[2]) * scale, -n[1] * scale
            turn[2], turn[3] = n[0] * scale, 0.0
            arrays.pair_friction[tip.pair, 0] = arrays.pair_friction[tip.pair, 1] = tip.friction
            # Spring and damper stay what they are while the carried mass grows; shear, which is
            # far stiffer, grows with that mass. `rover/physics/soil_contact.py` has the formulas.
            part = onset(tip.elastic)
            impedance = IMPEDANCE * part
            rest = (1.0 - impedance) / (1.0 - IMPEDANCE)
            arrays.pair_solimp[tip.pair, 0] = arrays.pair_solimp[tip.pair, 1] = impedance
            arrays.pair_solref[tip.pair, 0] = tip.held[0] * rest * tip.sprung
            arrays.pair_solref[tip.pair, 1] = tip.held[1] * rest * tip.damped
            arrays.pair_solreffriction[tip.pair, 1] = tip.held[1] * part
        if diverged:
            return made, True
        _call(mj_step, model, data)
        wrench += arrays.leg_wrench
        torque += arrays.motor_torque
        if stop:
            return made + 1, True
    return steps, False
