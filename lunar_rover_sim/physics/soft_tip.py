"""One tip in soil: where the surface under it lies, how deep it is, and the plane it stands on."""

from __future__ import annotations

import math

from lunar_rover_sim.frames import Array
from lunar_rover_sim.physics.soil_contact import PARKED_M
from lunar_rover_sim.regolith.footprint import Window
from lunar_rover_sim.regolith.soil import Soil

Centre = tuple[float, float, float]


class SoftTip:
    """The state of a tip; lengths in m, world frame.

    row: of the tip among all tips; leg: its leg
    plane, turn: position and attitude (wxyz) of its plane, friction, solref: of its contact, rows
        of MuJoCo's arrays
    x, y, h: where the surface was looked up, and its height there; nx, ny, nz: its normal
    reserve, bearing: parts of the strength sideways and downwards that slope and looseness leave
    firm_mu: tangent of the friction angle of the soil here
    offset, tilt_x, tilt_y: of the changed surface on the untouched ground
    plastic, sinkage: depth of the plane, and of the tip
    slid, sheared: way slipped since the walls of the print slid, and since the touch down
    ploughed: depth for which `plough` [N] holds
    stamp, low: centres of the ball in its print: when it was pressed in, and its lowest one since
    window: samples of the print whose walls have not slid
    due: the step at which the tip may have come down to the ground
    """

    __slots__ = ('row', 'leg', 'plane', 'turn', 'friction', 'solref', 'due', 'in_ground',
                 'x', 'y', 'h', 'nx', 'ny', 'nz', 'reserve', 'bearing', 'firm_mu', 'offset',
                 'tilt_x', 'tilt_y', 'plastic', 'sinkage', 'yielding', 'mu', 'plough', 'ploughed',
                 'slid', 'sheared', 'stamp', 'low', 'window')

    def __init__(self, row: int, leg: int, plane: Array, turn: Array, friction: Array,
                 solref: Array) -> None:
        self.row, self.leg = row, leg
        self.plane, self.turn, self.friction, self.solref = plane, turn, friction, solref
        self.due = 0
        self.in_ground = self.yielding = False
        self.x = self.y = self.h = self.nx = self.ny = 0.0
        self.nz = self.reserve = self.bearing = self.firm_mu = 1.0
        self.offset = self.tilt_x = self.tilt_y = 0.0
        self.plastic = self.sinkage = self.mu = self.plough = self.slid = 0.0
        self.sheared = 0.0
        self.ploughed = -1.0
        self.stamp: Centre | None = None
        self.low: Centre | None = None
        self.window: Window | None = None

    def saved(self) -> list[object]:
        """Return what `restore` takes back."""
        return [getattr(self, name) for name in _SAVED]

    def restore(self, values: list[object]) -> None:
        """Take back the state that `saved` returned."""
        for name, value in zip(_SAVED, values):
            setattr(self, name, value)

    def weaken(self, soil: Soil, slope: float, factors: tuple[float, float]) -> None:
        """Set what a slope (its tangent) and looseness (bearing, friction) leave of the strength.

        A slope carries its own soil with a part of the strength sideways, and all of it at the
        friction angle (infinite slope): what is left for ploughing goes to 0 with it.
        """
        bearing, friction = factors
        self.firm_mu = friction * soil.friction
        self.reserve = bearing * max(0.0, 1.0 - slope / self.firm_mu)
        self.bearing = bearing * soil.bearing_on_slope(slope)

    def place(self) -> None:
        """Put the plane at the plastic depth."""
        z, plane = self.plastic, self.plane
        # A third of the time of one assignment of all three.
        plane[0] = self.x - z * self.nx
        plane[1] = self.y - z * self.ny
        plane[2] = self.h - z * self.nz

    def turn_plane(self) -> None:
        """Lay the plane across the normal."""
        scale = 1.0 / math.sqrt(2.0 * (1.0 + self.nz))
        self.turn[:] = (1.0 + self.nz) * scale, -self.ny * scale, self.nx * scale, 0.0

    def park(self) -> None:
        """Take the plane away from a tip in the air."""
        self.plane[:] = 0.0, 0.0, PARKED_M

    def lean(self, axle: Centre, centre: Centre) -> float:
        """Return the tangent of the angle between the rod and the normal, at most 2."""
        rx, ry, rz = axle[0] - centre[0], axle[1] - centre[1], axle[2] - centre[2]
        up = rx * self.nx + ry * self.ny + rz * self.nz
        across2 = rx * rx + ry * ry + rz * rz - up * up
        across = math.sqrt(across2) if across2 > 0.0 else 0.0
        return across / up if across < 2.0 * up else 2.0

    def slip_mps(self, radius_m: float, centre: Centre, motion: list[float],
                 com: Centre) -> float:
        """Return the speed of the tip's lowest point along the surface [m/s].

        motion: of the leg, as MuJoCo's cvel, about the centre of mass `com` of the rover
        """
        wx, wy, wz, vx, vy, vz = motion
        r, nx, ny, nz = radius_m, self.nx, self.ny, self.nz
        px = centre[0] - r * nx - com[0]
        py = centre[1] - r * ny - com[1]
        pz = centre[2] - r * nz - com[2]
        vx += wy * pz - wz * py
        vy += wz * px - wx * pz
        vz += wx * py - wy * px
        across = vx * nx + vy * ny + vz * nz
        along2 = vx * vx + vy * vy + vz * vz - across * across
        return math.sqrt(along2) if along2 > 0.0 else 0.0


_SAVED = tuple(name for name in SoftTip.__slots__
               if name not in ('row', 'leg', 'plane', 'turn', 'friction', 'solref'))
