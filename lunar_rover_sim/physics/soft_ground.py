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

import math

import mujoco

from lunar_rover_sim.physics.ground_contact import ContactObserver, GroundContact
from lunar_rover_sim.physics.soft_tip import Centre, SoftTip
from lunar_rover_sim.physics.soil_contact import SoilRows
from lunar_rover_sim.physics.wall_slides import WallSlides
from lunar_rover_sim.regolith.ball import dig_table
from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.footprint import hull, press
from lunar_rover_sim.regolith.looseness import SoilMap
from lunar_rover_sim.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.regolith.soil import Soil
from lunar_rover_sim.regolith.spoke import SpokeInSoil
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.grid import HeightGrid

ANCHOR_M = 0.002         # the surface is looked up again when a tip in it has moved so far
NEAR_M = 0.002           # a tip this low is about to touch down
CREEP_MPS = 1e-4         # slower than this is creep of the solver, not slip
LIFT_OFF_M = 0.0015      # a tip this far above its plane has left its print
FASTEST_MPS = 2.0        # of a tip: how soon one that is in the air can touch the ground
PLOUGH_STEP_M = 2e-5     # what a tip ploughs is computed again after so much depth
STAMP_DEPTH_M, STAMP_WAY_M = 0.004, 0.004   # a print is pressed in after so much motion,
STAMP_HELD_M = 0.0002    # and after so much once the soil holds
SLIDE_M = 0.02           # distance after which the walls of a rut slide
GREATEST_FRICTION = 10.0
LEAST_MOBILISED = 0.05   # part of the friction of a tip that has not slipped yet

Legs = tuple[list[Centre], list[list[float]], Centre]   # axles, motions, centre of mass


class SoftGround:
    """The soil under the tips of one simulation; call `before_step` before each step."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rover: RoverDescription,
                 ground: HeightGrid, soil: Soil, rows: SoilRows,
                 varies: SoilMap | None = None) -> None:
        self.overlay = Overlay()
        self.soil, self._map = soil, varies
        self._model, self._data, self._ground, self._rows = model, data, ground, rows
        self._radius = rover.legs.tip_radius_m
        self._spoke = SpokeInSoil(soil, self._radius, rover.legs.spoke_radius_m)
        self._step_s = float(model.opt.timestep)
        self._steps_per_m = 1.0 / (FASTEST_MPS * self._step_s)
        self._k = soil.elastic_npm
        self._dig = dig_table(soil.shape)
        self._centres = data.geom_xpos[rows.first_tip:rows.first_tip + 2 * rows.tips:2]
        first_leg = int(model.geom_bodyid[rows.first_tip])
        self._axles = data.xpos[first_leg:first_leg + 4]
        self._motion = data.cvel[first_leg:first_leg + 4]
        self._com = data.subtree_com[int(model.body_rootid[first_leg])]
        self._solref = [row.tolist() for row in rows.solref_held], \
            [row.tolist() for row in rows.solref_yielding]
        self._tips = [SoftTip(k, k // rover.legs.spokes, data.mocap_pos[rows.mocap[k]],
                              data.mocap_quat[rows.mocap[k]], model.pair_friction[rows.pairs[k]],
                              model.pair_solref[rows.pairs[k]]) for k in range(rows.tips)]
        self._count = 0
        self._observer = ContactObserver(rover.legs.spoke_length_m, self._step_s)
        self._fine = FineGround(ground)
        self._walls = WallSlides(self._fine, soil.repose_deg, self._step_s)
        self._start: tuple[Overlay, list[list[object]]] | None = None

    def before_step(self) -> None:
        """Move the planes to where the soil is, for the poses at the start of the next step."""
        mujoco.mj_kinematics(self._model, self._data)
        centres = self._centres.tolist()
        if not math.isfinite(centres[0][0]):
            return      # the motion has diverged, of all links at once: the caller will say so
        legs: Legs | None = None
        count = self._count
        if count >= self._walls.next_step:
            self._walls.slide_due(self.overlay, count)
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
                if legs is None:
                    legs = self._axles.tolist(), self._motion.tolist(), self._com.tolist()
                self._support(tip, centre, depth, legs)

    def observe(self) -> GroundContact:
        """Return sinkage and slip per leg; slip since the last call."""
        return self._observer.observe(self._tips, self._count)

    def keep_start(self) -> None:
        """Keep the present ground as the one to which `reset` goes back."""
        self._walls.slide_all(self.overlay)
        self._start = self.overlay.copy(), [tip.saved() for tip in self._tips]
        for tip in self._tips:
            tip.due = 0
        self._begin()

    def reset(self) -> None:
        """Go back to the ground at `keep_start`; the caller restores poses, planes included."""
        if self._start is None:
            return
        overlay, tips = self._start
        self.overlay.restore(overlay)
        self._walls.forget()
        for tip, values in zip(self._tips, tips):
            tip.restore(values)
            tip.due = 0
            tip.friction[:2] = tip.mu or self.soil.friction
            tip.solref[:] = self._solref[tip.yielding][tip.row]
        self._observer.surface_again()
        self._begin()

    def _begin(self) -> None:
        """Count from 0, and compute the motion of the legs: it is that of the last step made."""
        self._count = 0
        self._observer.restart()
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            compute(self._model, self._data)

    # One tip

    def _surface(self, x: float, y: float) -> float:
        """Return the height of the changed ground [m]; NaN beyond the world."""
        return self._ground.height_at_point(x, y) + self.overlay.height_at_point(x, y)

    def _touch(self, tip: SoftTip, x: float, y: float) -> None:
        """Take the changed ground below a tip in the air for a plane."""
        change, compaction = self.overlay.at(x, y)
        former = self.soil.former_depth_m(change, compaction)
        tip.offset = change + former
        reach, height = self._radius, self.overlay.height_at_point
        tip.tilt_x = (height(x + reach, y) - height(x - reach, y)) / (2.0 * reach)
        tip.tilt_y = (height(x, y + reach) - height(x, y - reach)) / (2.0 * reach)
        self._lie(tip, x, y)
        tip.plastic = former * tip.nz     # the plane goes through the changed ground at (x, y)

    def _follow(self, tip: SoftTip, x: float, y: float) -> None:
        """Let a tip that moves on in the ground meet the surface ahead of it."""
        dx, dy = x - tip.x, y - tip.y
        way = math.sqrt(dx * dx + dy * dy)
        depth = min(max(tip.sinkage, 0.0), self._radius)
        inner = math.sqrt(depth * (2.0 * self._radius - depth)) + 1.5 * CELL_M
        change, compaction = self.overlay.at(x + dx / way * inner, y + dy / way * inner)
        former = self.soil.former_depth_m(change, compaction)
        part = min(1.0, way / (2.0 * inner))
        tip.offset += part * (change + former - tip.offset)
        tip.tilt_x *= 1.0 - part
        tip.tilt_y *= 1.0 - part
        self._lie(tip, x, y)
        tip.plastic += part * max(0.0, former * tip.nz - tip.plastic)
        tip.place()

    def _lie(self, tip: SoftTip, x: float, y: float) -> None:
        """Lay the surface of a tip through a position, along the ground around it."""
        height, reach = self._ground.height_at_point, self._radius
        slope_x = tip.tilt_x + (height(x + reach, y) - height(x - reach, y)) / (2.0 * reach)
        slope_y = tip.tilt_y + (height(x, y + reach) - height(x, y - reach)) / (2.0 * reach)
        slope2 = slope_x * slope_x + slope_y * slope_y
        tip.x, tip.y, tip.h = x, y, height(x, y) + tip.offset
        tip.nz = 1.0 / math.sqrt(1.0 + slope2)
        tip.nx, tip.ny = -slope_x * tip.nz, -slope_y * tip.nz
        tip.turn_plane()
        tip.ploughed = -1.0
        tip.weaken(self.soil, math.sqrt(slope2),
                   (1.0, 1.0) if self._map is None else self._map.factors(x, y))

    def _support(self, tip: SoftTip, centre: Centre, depth: float, legs: Legs) -> None:
        """Let the soil under a tip yield, and place its plane."""
        plastic = tip.plastic
        pressed = depth - plastic
        if pressed < -LIFT_OFF_M:
            self._leave(tip)
            return
        if not tip.in_ground:
            tip.in_ground, tip.slid, tip.sheared = True, 0.0, 0.0
            tip.stamp = tip.low = tip.window = None
            tip.place()
        tip.sinkage = depth
        if pressed <= 0.0:
            if tip.yielding:
                self._set_yielding(tip, False)
            return
        axles, motion, com = legs
        radius, k, spoke, part = self._radius, self._k, self._spoke, tip.bearing
        lean = tip.lean(axles[tip.leg], centre) if depth > 2.0 * radius else 0.0
        force, bears = k * pressed, part * spoke.bears_n(plastic, lean)
        yielding = force > bears
        if yielding:
            plastic, bears = spoke.yielded(depth, plastic, k, part, lean)
            force = k * (depth - plastic)
        if yielding != tip.yielding:
            self._set_yielding(tip, yielding)
        speed = tip.slip_mps(radius, centre, motion[tip.leg], com)
        slips = speed > CREEP_MPS
        if slips:
            way = speed * self._step_s
            self._observer.add_slip(tip.leg, way)
            tip.slid += way
            tip.sheared += way
            load = force / bears if bears > 0.0 else 1.0
            plastic += way * self._dig.slope(load, plastic / radius)
            plastic = min(max(plastic, 0.0), depth)
            force = k * (depth - plastic)
        if plastic != tip.plastic:
            tip.plastic = plastic
            tip.place()
        self._set_friction(tip, depth, force)
        self._leave_print(tip, centre, depth - plastic, yielding or slips)

    def _leave_print(self, tip: SoftTip, centre: Centre, pressed: float, moving: bool) -> None:
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
                math.hypot(x - last[0], y - last[1]) > STAMP_WAY_M:
            self._stamp(tip, (x, y, z))
        elif deeper > 0.0 and (tip.low is None or z < tip.low[2]):
            tip.low = x, y, z

    def _set_friction(self, tip: SoftTip, depth: float, force: float) -> None:
        """Set Coulomb friction, ploughing of tip and rod, and cohesion, over the normal force."""
        if abs(depth - tip.ploughed) > PLOUGH_STEP_M:
            tip.ploughed = depth
            tip.plough = self._spoke.ploughs_n(depth, tip.reserve)
        mu = tip.firm_mu + tip.plough / (force if force > 1e-6 else 1e-6)
        mobilised = 1.0 - math.exp(-tip.sheared / self.soil.shear_m)
        mu = min(mu, GREATEST_FRICTION) * max(mobilised, LEAST_MOBILISED)
        if abs(mu - tip.mu) > 0.005 * tip.mu:
            tip.mu = mu
            tip.friction[0] = tip.friction[1] = mu

    def _stamp(self, tip: SoftTip, low: Centre) -> None:
        """Press the way of a tip since the last time into the overlay."""
        window = press(self.overlay, self._fine, tip.stamp or low, low, self._radius,
                       self.soil.compacted)
        tip.stamp, tip.low = low, None
        tip.window = window if tip.window is None else hull(tip.window, window)
        if tip.slid > SLIDE_M:
            tip.slid = 0.0
            self._let_walls_slide(tip)

    def _leave(self, tip: SoftTip) -> None:
        """Take a tip out of the ground."""
        if tip.low is not None:
            self._stamp(tip, tip.low)
        self._let_walls_slide(tip)
        tip.in_ground, tip.sinkage, tip.stamp = False, 0.0, None
        if tip.yielding:
            self._set_yielding(tip, False)
        tip.park()

    def _let_walls_slide(self, tip: SoftTip) -> None:
        if tip.window is not None:
            self._walls.add(self.overlay, tip.leg, tip.window, self._count)
            tip.window = None

    def _set_yielding(self, tip: SoftTip, yielding: bool) -> None:
        tip.yielding = yielding
        tip.solref[:] = self._solref[yielding][tip.row]
