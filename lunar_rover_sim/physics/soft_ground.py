"""Tips on soil: they sink, hold, slip, dig themselves in, and leave tracks.

Each tip in the ground stands on a plane of its own. MuJoCo presses the tip against it: the elastic
part. The plane lies the plastic depth z below the surface. Before each step

- the soil yields where the elastic force k e exceeds F(z), what the soil bears at that depth
  (`regolith/ball.py`): z grows until k e = F(z). Nothing yields below, so the rover stands still.
- a tip that slips goes the way on which the soil bears its load, down or up (`DigTable`).
- friction is Coulomb's, and what the sunken tip and rod plough, over the normal force. It is
  mobilised as the tip slips, by 1 - exp(-way / K) (Janosi and Hanamoto 1961).

While the soil yields, it dissipates; the damping of the contact is for the time in which it holds.
The surface below a tip is the untouched ground with the changes of the overlay where the tip
touched down, and with those that lie ahead as it slips on. Soil that bore a print before holds
until its former depth is reached again.

Plain floats on loaded tips only: 12 tips, of which 2 to 4 are loaded.
"""

from __future__ import annotations

import dataclasses
import logging
import math

import mujoco
import numpy as np

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.soil_contact import PARKED_M, SoilRows
from lunar_rover_sim.regolith.ball import (bearing_n, bearing_slope_npm, contact_area_m2, DigTable,
                                           silhouette_m3)
from lunar_rover_sim.regolith.footprint import press, Window
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.regolith.repose import relax
from lunar_rover_sim.regolith.soil import Soil
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.grid import HeightGrid

logger = logging.getLogger(__name__)

ANCHOR_M = 0.002         # the surface is looked up again when a tip in it has moved so far
NEAR_M = 0.002           # a tip this low is about to touch down
CREEP_MPS = 1e-4         # slower than this is creep of the solver, not slip
LIFT_OFF_M = 0.0015      # a tip this far above its plane has left its print
FASTEST_MPS = 2.0        # of a tip: how soon one that is in the air can touch the ground
PLOUGH_STEP_M = 2e-5     # what a tip ploughs is computed again after so much depth
STAMP_DEPTH_M, STAMP_WAY_M = 0.004, 0.004   # a print is pressed in after so much motion,
STAMP_HELD_M = 0.0002    # and after so much once the soil holds
SLIDE_M = 0.02           # distance after which the walls of a rut slide
SLIDE_S = 0.1            # time in which they do, for all prints of a leg at once
WIDEST = 40              # samples of such prints, along one side
GREATEST_FRICTION = 10.0
LEAST_MOBILISED = 0.05   # part of the friction of a tip that has not slipped yet
DUG_IN_SPOKES = 0.75     # part of a spoke below ground from which on a leg is dug in


@dataclasses.dataclass(frozen=True)
class GroundContact:
    """What the ground does at each leg, in the order of LEG_NAMES.

    sinkage_m: (4,) depth of the deepest tip below the surface that it met, 0 in the air
    slip_mps: (4,) mean speed at which loaded tips slid, since the previous state
    dug_in: whether at least two legs are in the ground by three quarters of a spoke
    """

    sinkage_m: Array
    slip_mps: Array
    dug_in: bool


class _Tip:
    """One tip and the soil under it; lengths in m, world frame."""

    __slots__ = ('row', 'leg', 'plane', 'turn', 'friction', 'solref', 'due', 'in_ground',
                 'x', 'y', 'h', 'nx', 'ny', 'nz', 'reserve', 'offset', 'tilt_x', 'tilt_y',
                 'plastic', 'sinkage', 'yielding', 'mu', 'plough', 'ploughed', 'slid', 'sheared',
                 'stamp', 'low', 'window')

    def __init__(self, row: int, leg: int, plane: Array, turn: Array, friction: Array,
                 solref: Array) -> None:
        self.row, self.leg = row, leg
        self.plane, self.turn, self.friction, self.solref = plane, turn, friction, solref
        self.due = 0
        self.in_ground = self.yielding = False
        # Where the surface was looked up, its height and normal, and what its slope leaves of the
        # strength sideways.
        self.x = self.y = self.h = self.nx = self.ny = 0.0
        self.nz = self.reserve = 1.0
        self.offset = self.tilt_x = self.tilt_y = 0.0   # of the surface on the untouched ground
        self.plastic = self.sinkage = self.mu = self.plough = self.slid = 0.0
        self.sheared = 0.0                              # way slipped since the touch down
        self.ploughed = -1.0                            # depth for which `plough` holds
        # Centres of the ball in its print: when it was pressed in, and its lowest one since.
        self.stamp: tuple[float, float, float] | None = None
        self.low: tuple[float, float, float] | None = None
        self.window: Window | None = None


_SAVED = tuple(name for name in _Tip.__slots__
               if name not in ('row', 'leg', 'plane', 'turn', 'friction', 'solref'))


class SoftGround:
    """The soil under the tips of one simulation; call `before_step` before each step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rover: RoverDescription,
                 ground: HeightGrid, soil: Soil, rows: SoilRows) -> None:
        self.overlay = Overlay()
        self.soil = soil
        self._model, self._data, self._ground, self._rows = model, data, ground, rows
        self._radius = rover.legs.tip_radius_m
        self._rod = rover.legs.spoke_radius_m
        self._spoke_m = rover.legs.spoke_length_m
        self._step_s = float(model.opt.timestep)
        self._steps_per_m = 1.0 / (FASTEST_MPS * self._step_s)
        self._k, self._zeta = soil.elastic_npm, soil.zeta_npm3
        self._cohesive = soil.cohesive_bearing_pa
        self._side = soil.zeta_npm3 * soil.shape.side_ratio
        self._dig = DigTable(soil.shape)
        self._centres = data.geom_xpos[rows.first_tip:rows.first_tip + 2 * rows.tips:2]
        first_leg = int(model.geom_bodyid[rows.first_tip])
        self._axles = data.xpos[first_leg:first_leg + 4]
        self._motion = data.cvel[first_leg:first_leg + 4]
        self._com = data.subtree_com[int(model.body_rootid[first_leg])]
        self._solref = [row.tolist() for row in rows.solref_held], \
            [row.tolist() for row in rows.solref_yielding]
        self._tips = [_Tip(k, k // rover.legs.spokes, data.mocap_pos[rows.mocap[k]],
                           data.mocap_quat[rows.mocap[k]], model.pair_friction[rows.pairs[k]],
                           model.pair_solref[rows.pairs[k]]) for k in range(rows.tips)]
        self._count = self._observed = 0
        self._slid = [0.0] * 4
        self._was_dug_in = False
        # Windows of prints whose walls are to slide, per leg, and the step at which they do.
        self._waiting: list[Window | None] = [None] * 4
        self._settle_at = [0] * 4
        self._next_settling = math.inf
        self._start: tuple[Overlay, list[list[object]]] | None = None

    def before_step(self) -> None:
        """Move the planes to where the soil is, for the poses at the start of the next step."""
        mujoco.mj_kinematics(self._model, self._data)
        centres = self._centres.tolist()
        motion: list[list[float]] | None = None
        count = self._count
        if count >= self._next_settling:
            self._settle_due()
        self._count = count + 1
        radius = self._radius
        for tip in self._tips:
            if tip.due > count:
                continue
            x, y, z = centre = centres[tip.row]
            if not tip.in_ground:
                above = z - radius - self._surface(x, y)
                if above > NEAR_M:
                    # On a slope of up to 60 deg the way to the ground is half of its height.
                    tip.due = count + int(0.5 * (above - NEAR_M) * self._steps_per_m)
                    continue
                self._touch(tip, x, y)
                dx = dy = 0.0
            else:
                dx, dy = x - tip.x, y - tip.y
                if dx * dx + dy * dy > ANCHOR_M * ANCHOR_M:
                    self._follow(tip, x, y)
                    dx = dy = 0.0
            depth = radius - (dx * tip.nx + dy * tip.ny + (z - tip.h) * tip.nz)
            if depth > tip.plastic or tip.in_ground:
                if motion is None:
                    motion = self._motion.tolist()
                    com = self._com.tolist()
                self._support(tip, centre, depth, motion[tip.leg], com)

    def observe(self) -> GroundContact:
        """Return sinkage and slip per leg; slip since the last call."""
        sinkage = [0.0] * 4
        for tip in self._tips:
            if tip.in_ground and tip.sinkage > sinkage[tip.leg]:
                sinkage[tip.leg] = tip.sinkage
        interval_s = max(1, self._count - self._observed) * self._step_s
        slip = [way / interval_s for way in self._slid]
        self._slid, self._observed = [0.0] * 4, self._count
        deep = sum(s >= DUG_IN_SPOKES * self._spoke_m for s in sinkage) >= 2
        if deep and not self._was_dug_in:
            logger.warning('the rover has dug itself in: tips are %s mm deep',
                           ', '.join(f'{1e3 * s:.0f}' for s in sinkage))
        self._was_dug_in = deep
        return GroundContact(np.array(sinkage), np.array(slip), deep)

    def keep_start(self) -> None:
        """Keep the present ground as the one to which `reset` goes back."""
        for leg in range(4):
            self._settle(leg)
        self._start = self.overlay.copy(), [[getattr(tip, name) for name in _SAVED]
                                            for tip in self._tips]
        self._count = self._observed = 0
        for tip in self._tips:
            tip.due = 0
        self._slid = [0.0] * 4
        self._refresh()

    def reset(self) -> None:
        """Go back to the ground at `keep_start`; the caller restores poses, planes included."""
        if self._start is None:
            return
        overlay, tips = self._start
        self.overlay.restore(overlay)
        self._waiting = [None] * 4
        for tip, values in zip(self._tips, tips):
            for name, value in zip(_SAVED, values):
                setattr(tip, name, value)
            tip.due = 0
            tip.friction[:2] = tip.mu or self.soil.friction
            tip.solref[:] = self._solref[tip.yielding][tip.row]
        self._count = self._observed = 0
        self._slid = [0.0] * 4
        self._was_dug_in = False
        self._refresh()

    def _refresh(self) -> None:
        """Compute the motion of the legs now: otherwise it is that of the last step made."""
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            compute(self._model, self._data)

    # One tip

    def _surface(self, x: float, y: float) -> float:
        """Return the height of the changed ground [m]; NaN beyond the world."""
        return self._ground.height_at_point(x, y) + self.overlay.at(x, y)[0]

    def _touch(self, tip: _Tip, x: float, y: float) -> None:
        """Take the changed ground below a tip in the air for a plane."""
        change, compaction = self.overlay.at(x, y)
        former = self._former_depth(change, compaction)
        tip.offset, tip.plastic = change + former, former
        reach, at = self._radius, self.overlay.at
        tip.tilt_x = (at(x + reach, y)[0] - at(x - reach, y)[0]) / (2.0 * reach)
        tip.tilt_y = (at(x, y + reach)[0] - at(x, y - reach)[0]) / (2.0 * reach)
        self._lie(tip, x, y)

    def _follow(self, tip: _Tip, x: float, y: float) -> None:
        """Let a tip that moves on in the ground meet the surface ahead of it."""
        dx, dy = x - tip.x, y - tip.y
        way = math.sqrt(dx * dx + dy * dy)
        depth = min(max(tip.sinkage, 0.0), self._radius)
        inner = math.sqrt(depth * (2.0 * self._radius - depth)) + 1.5 * CELL_M
        change, compaction = self.overlay.at(x + dx / way * inner, y + dy / way * inner)
        former = self._former_depth(change, compaction)
        part = min(1.0, way / (2.0 * inner))
        tip.offset += part * (change + former - tip.offset)
        tip.plastic += part * max(0.0, former - tip.plastic)
        tip.tilt_x *= 1.0 - part
        tip.tilt_y *= 1.0 - part
        self._lie(tip, x, y)
        self._place(tip)

    def _lie(self, tip: _Tip, x: float, y: float) -> None:
        """Lay the surface of a tip through a position, along the ground around it."""
        height, reach = self._ground.height_at_point, self._radius
        slope_x = tip.tilt_x + (height(x + reach, y) - height(x - reach, y)) / (2.0 * reach)
        slope_y = tip.tilt_y + (height(x, y + reach) - height(x, y - reach)) / (2.0 * reach)
        slope2 = slope_x * slope_x + slope_y * slope_y
        tip.x, tip.y, tip.h = x, y, height(x, y) + tip.offset
        tip.nz = 1.0 / math.sqrt(1.0 + slope2)
        tip.nx, tip.ny = -slope_x * tip.nz, -slope_y * tip.nz
        tip.ploughed = -1.0
        tip.reserve = max(0.0, 1.0 - math.sqrt(slope2) / self.soil.friction)

    def _former_depth(self, change: float, compaction: float) -> float:
        """Return the depth of an earlier print whose soil still bears its load [m]."""
        if compaction <= 0.0 or change >= 0.0:
            return 0.0
        return min(-change, compaction / max(self.soil.compacted, 1e-3))

    def _place(self, tip: _Tip) -> None:
        """Put the plane of a tip at its plastic depth."""
        z = tip.plastic
        tip.plane[:] = tip.x - z * tip.nx, tip.y - z * tip.ny, tip.h - z * tip.nz
        scale = 1.0 / math.sqrt(2.0 * (1.0 + tip.nz))
        tip.turn[:] = (1.0 + tip.nz) * scale, -tip.ny * scale, tip.nx * scale, 0.0

    def _support(self, tip: _Tip, centre: tuple[float, float, float], depth: float,
                 motion: list[float], com: list[float]) -> None:
        """Let the soil under a tip yield, and place its plane."""
        plastic = tip.plastic
        pressed = depth - plastic
        if pressed < -LIFT_OFF_M:
            self._leave(tip)
            return
        if not tip.in_ground:
            tip.in_ground, tip.slid, tip.sheared = True, 0.0, 0.0
            tip.stamp = tip.low = tip.window = None
            self._place(tip)
        tip.sinkage = depth
        if pressed <= 0.0:
            self._set_yielding(tip, False)
            return
        radius, k = self._radius, self._k
        lean = self._lean(tip, centre) if depth > 2.0 * radius else 0.0
        force, bears = k * pressed, self._bears(plastic, lean)
        yielding = force > bears
        if yielding:
            for _ in range(3):
                slope = self._zeta_slope(plastic, lean)
                plastic = min(plastic + (k * (depth - plastic) - bears) / (k + slope), depth)
                bears = self._bears(plastic, lean)
            force = k * (depth - plastic)
        self._set_yielding(tip, yielding)
        speed = self._slip_mps(tip, centre, motion, com)
        if speed > CREEP_MPS:
            way = speed * self._step_s
            self._slid[tip.leg] += way
            tip.slid += way
            tip.sheared += way
            dig = self._dig.slope(force / bears if bears > 0.0 else 1.0, plastic / radius)
            plastic = min(max(plastic + dig * way, 0.0), depth)
            force = k * (depth - plastic)
        if plastic != tip.plastic:
            tip.plastic = plastic
            self._place(tip)
        self._set_friction(tip, depth, force)
        self._leave_print(tip, centre, depth - plastic, yielding or speed > CREEP_MPS)

    def _leave_print(self, tip: _Tip, centre: tuple[float, float, float], pressed: float,
                     moving: bool) -> None:
        """Note where the ball presses, and press its way into the overlay from time to time."""
        x = centre[0] + pressed * tip.nx
        y = centre[1] + pressed * tip.ny
        z = centre[2] + pressed * tip.nz
        last = tip.stamp
        if last is None:
            tip.stamp = tip.low = x, y, z
            return
        deeper = last[2] - z
        if deeper > (STAMP_DEPTH_M if moving else STAMP_HELD_M) or \
                (x - last[0]) ** 2 + (y - last[1]) ** 2 > STAMP_WAY_M ** 2:
            self._stamp(tip, (x, y, z))
        elif deeper > 0.0 and (tip.low is None or z < tip.low[2]):
            tip.low = x, y, z

    def _bears(self, depth: float, lean: float) -> float:
        """Return what the soil bears at a plastic depth [N]."""
        bears = bearing_n(depth, self._radius, self._zeta)
        if self._cohesive:
            bears += self._cohesive * contact_area_m2(depth, self._radius)
        below = depth - 2.0 * self._radius
        if below > 0.0:
            bears += self._zeta * self._rod * lean * below * below
        return bears

    def _zeta_slope(self, depth: float, lean: float) -> float:
        """Return the derivative of what the soil bears [N/m]."""
        slope = bearing_slope_npm(depth, self._radius, self._zeta)
        if self._cohesive:
            slope += self._cohesive * 2.0 * math.pi * max(self._radius - depth, 0.0)
        below = depth - 2.0 * self._radius
        if below > 0.0:
            slope += 2.0 * self._zeta * self._rod * lean * below
        return slope

    def _lean(self, tip: _Tip, centre: tuple[float, float, float]) -> float:
        """Return the tangent of the angle between the rod and the normal, at most 2."""
        ax, ay, az = self._axles[tip.leg].tolist()
        rx, ry, rz = ax - centre[0], ay - centre[1], az - centre[2]
        up = rx * tip.nx + ry * tip.ny + rz * tip.nz
        across = math.sqrt(max(rx * rx + ry * ry + rz * rz - up * up, 0.0))
        return min(across / up, 2.0) if up > 0.0 else 2.0

    def _slip_mps(self, tip: _Tip, centre: tuple[float, float, float], motion: list[float],
                  com: list[float]) -> float:
        """Return the speed of the tip's lowest point along the surface [m/s]."""
        wx, wy, wz, vx, vy, vz = motion
        r, nx, ny, nz = self._radius, tip.nx, tip.ny, tip.nz
        px = centre[0] - r * nx - com[0]
        py = centre[1] - r * ny - com[1]
        pz = centre[2] - r * nz - com[2]
        vx += wy * pz - wz * py
        vy += wz * px - wx * pz
        vz += wx * py - wy * px
        across = vx * nx + vy * ny + vz * nz
        return math.sqrt(max(vx * vx + vy * vy + vz * vz - across * across, 0.0))

    def _set_yielding(self, tip: _Tip, yielding: bool) -> None:
        if yielding != tip.yielding:
            tip.yielding = yielding
            tip.solref[:] = self._solref[yielding][tip.row]

    def _set_friction(self, tip: _Tip, depth: float, force: float) -> None:
        """Set Coulomb friction, ploughing of tip and rod, and cohesion, over the normal force.

        A slope carries its own soil with a part of the strength, and all of it at the friction
        angle (infinite slope): what is left for ploughing goes to 0 with it.
        """
        if abs(depth - tip.ploughed) > PLOUGH_STEP_M:
            tip.ploughed = depth
            plough = self._side * silhouette_m3(depth, self._radius)
            below = depth - 2.0 * self._radius
            if below > 0.0:
                plough += self._side * self._rod * below * below
            plough *= tip.reserve
            if self.soil.cohesion_pa:
                plough += self.soil.cohesion_pa * contact_area_m2(depth, self._radius)
            tip.plough = plough
        mu = min(self.soil.friction + tip.plough / max(force, 1e-6), GREATEST_FRICTION)
        mu *= max(1.0 - math.exp(-tip.sheared / self.soil.shear_m), LEAST_MOBILISED)
        if abs(mu - tip.mu) > 0.005 * tip.mu:
            tip.mu = mu
            tip.friction[:2] = mu

    def _stamp(self, tip: _Tip, low: tuple[float, float, float]) -> None:
        """Press the way of a tip since the last time into the overlay."""
        ix, iy, nx, ny = press(self.overlay, self._ground, tip.stamp or low, low, self._radius,
                               self.soil.compacted)
        tip.stamp, tip.low = low, None
        tip.window = (ix, iy, nx, ny) if tip.window is None else _hull(tip.window,
                                                                       (ix, iy, nx, ny))
        if tip.slid > SLIDE_M:
            tip.slid = 0.0
            self._settle_later(tip)

    def _settle_later(self, tip: _Tip) -> None:
        """Let the walls of a print slide soon, with those of the same leg."""
        if tip.window is None:
            return
        waiting = self._waiting[tip.leg]
        if waiting is not None:
            both = _hull(waiting, tip.window)
            if max(both[2:]) <= WIDEST:
                self._waiting[tip.leg], tip.window = both, None
                return
            self._settle(tip.leg)
        self._waiting[tip.leg], tip.window = tip.window, None
        self._settle_at[tip.leg] = self._count + round(SLIDE_S / self._step_s)
        self._next_settling = min(self._next_settling, self._settle_at[tip.leg])

    def _settle_due(self) -> None:
        """Let walls slide whose time has come."""
        for leg in range(4):
            if self._waiting[leg] is not None and self._settle_at[leg] <= self._count:
                self._settle(leg)
        self._next_settling = min((self._settle_at[leg] for leg in range(4)
                                   if self._waiting[leg] is not None), default=math.inf)

    def _settle(self, leg: int) -> None:
        window = self._waiting[leg]
        if window is not None:
            relax(self.overlay, self._ground, *window, self.soil.repose_deg)
            self._waiting[leg] = None

    def _leave(self, tip: _Tip) -> None:
        """Take a tip out of the ground."""
        if tip.low is not None:
            self._stamp(tip, tip.low)
        self._settle_later(tip)
        tip.in_ground, tip.sinkage, tip.stamp = False, 0.0, None
        self._set_yielding(tip, False)
        tip.plane[:] = 0.0, 0.0, PARKED_M


def _hull(one: Window, other: Window) -> Window:
    """Return the window around two."""
    ix, iy = min(one[0], other[0]), min(one[1], other[1])
    return (ix, iy, max(one[0] + one[2], other[0] + other[2]) - ix,
            max(one[1] + one[3], other[1] + other[3]) - iy)
