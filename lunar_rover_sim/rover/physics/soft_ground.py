"""Soft ground under one simulation: the compiled law, the prints that it leaves, what is observed.

`ground/regolith/law.py` moves the planes on which the tips stand, before each step of MuJoCo.
Prints are pressed into the overlay, and their walls slide, between steps: no force jumps by that,
since a tip in the ground meets a change in proportion to the way that it moves on.
"""

from __future__ import annotations

from collections.abc import Mapping
import ctypes
import dataclasses
import functools
import logging
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lunar_rover_sim.base.compiled import read_only
from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz
from lunar_rover_sim.ground.regolith import law
from lunar_rover_sim.ground.regolith.looseness import BEARING_RATIO, FRICTION_RATIO, SoilMap
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.regolith.resistive_force import DEEPEST, dig_table
from lunar_rover_sim.ground.regolith.soil import Soil
from lunar_rover_sim.ground.regolith.tracks import hull, press, WallSlides, Window
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.soil_contact import SoilRows

logger = logging.getLogger(__name__)

# Share of a spoke below ground from which a leg counts as dug in. The belly of the default rover
# lies on flat ground at 0.72 to 0.76.
DUG_IN_SPOKES = 0.7
DEEPEST_SPOKES = 10.0   # a tip that is deeper, in lengths of a spoke, has diverged
SLIDE_M = 0.02          # way slipped after which the walls of a rut slide
GATHER_M = 1.5          # way after which the tracks around the rover are gathered again
_AROUND_TIP_M = 0.2     # around a tip, within which it looks at the ground and changes it
_FARTHEST_M = 1e6
# What the law changes of MuJoCo's model, and what it keeps of its own.
_PAIRS = 'pair_friction', 'pair_solref', 'pair_solreffriction', 'pair_solimp'
_OWN_ARRAYS = '_tips', '_slipped', '_slid_at'
_NO_MAP = law.Heights(read_only(np.zeros((1, 1)), np.float32), 1.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class GroundContact:
    """What the ground does at each leg, in the order of the rover's legs.

    Attributes:
        sinkage_m: (legs,) depth of the deepest tip below the surface that it met, 0 in the air.
        slip_mps: (legs,) mean speed at which loaded tips slid, since the previous state.
        dug_in: whether at least two legs are in the ground by seven tenths of a spoke.
    """

    sinkage_m: Array
    slip_mps: Array
    dug_in: bool


class SoftGround:
    """The soil under the tips of one simulation; `advance` steps both."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rover: RoverDescription,
                 ground: HeightGrid, soil: Soil, rows: SoilRows,
                 varies: SoilMap | None = None) -> None:
        self.overlay = Overlay()
        self.soil = soil
        self._rover, self._rows = rover, rows
        self._step_s = float(model.opt.timestep)
        first_leg = int(model.geom_bodyid[rows.first_tip])
        legs = len(np.unique(model.geom_bodyid[rows.first_tip:rows.first_tip + 2 * rows.tips:2]))
        self._legs = _leg_records(model, first_leg, legs)
        self._tips = _tip_records(model, rows, first_leg)
        self._bodies = slice(first_leg, first_leg + legs)
        self._soil = soil_record(soil, rover, self._step_s)
        self._slipped = np.zeros(legs)
        self._walls = WallSlides(ground, soil.repose_deg, self._step_s, legs)
        self._windows: list[Window | None] = [None] * rows.tips
        self._slid_at = np.zeros(rows.tips)     # way slipped when the walls of the rut slid
        self._count = self._observed = 0
        self._was_dug_in = False
        self._deep_m = DUG_IN_SPOKES * rover.legs.spoke_length_m
        axles = np.array(rover.legs.axle_positions_m())
        self._reach_m = float(np.linalg.norm(axles, axis=1).max()) + (
            rover.legs.spoke_length_m + _AROUND_TIP_M)
        self._start: tuple[Overlay, np.ndarray] | None = None
        self._bind(model, data, ground, varies)

    def _bind(self, model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid,
              varies: SoilMap | None) -> None:
        """Work on a model of the rover in a window."""
        self._ground = self._walls.ground = ground
        bodies = self._bodies
        # MuJoCo's arrays stay where they are; asking for them takes longer than a step of the law.
        self._arrays = law.Mujoco(
            data.qpos, data.qvel, data.mocap_pos, data.mocap_quat, model.pair_friction,
            model.pair_solref, model.pair_solreffriction, model.pair_solimp,
            data.cfrc_ext[bodies], data.qfrc_actuator[6:6 + bodies.stop - bodies.start])
        self._given = (self._legs, self._tips, self._soil, dig_table(self.soil.shape), DEEPEST,
                       law.Heights.of(ground), _NO_MAP if varies is None else varies.varied)
        self._addresses = _mj_step(), model._address, data._address

    def enter(self, model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid,
              varies: SoilMap | None) -> None:
        """Go on in another window: what tips, tracks and walls are stays.

        Args:
            model: Of the same rover, with the same soil.
            data: Its state; the caller has written it, with the planes.
        """
        before = self._arrays
        self._bind(model, data, ground, varies)
        for name in _PAIRS:
            getattr(self._arrays, name)[:] = getattr(before, name)

    def state(self) -> dict[str, Any]:
        """Return all that the soil goes on from, as copies."""
        return {
            'overlay': self.overlay.state(),
            'walls': self._walls.state(),
            'pairs': {name: getattr(self._arrays, name).copy() for name in _PAIRS},
            'arrays': {name: getattr(self, name).copy() for name in _OWN_ARRAYS},
            'values': {**attributes(self, '_count', '_observed', '_was_dug_in'),
                       '_windows': list(self._windows)}}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, with the same rover and soil."""
        self.overlay.resume(state['overlay'])
        self._walls.resume(state['walls'])
        for name, values in state['pairs'].items():
            getattr(self._arrays, name)[:] = values
        for name, values in state['arrays'].items():
            getattr(self, name)[:] = values     # compiled code holds these arrays
        restore_attributes(self, state['values'])

    def advance(self, steps: int, wrench: Array, torque: Array) -> None:
        """Make steps of soil and MuJoCo.

        Args:
            steps: Their number.
            wrench: (legs, 6), to which `Observer.leg_wrench` of every step is added.
            torque: (legs,), to which `Observer.motor_torque` of every step is added.

        Raises:
            PhysicsError: If a tip has diverged.
        """
        overlay, walls = self.overlay, self._walls
        end = self._count + steps
        while self._count < end:
            if self._count >= walls.next_step:
                walls.slide_due(overlay, self._count)
            self._gather()
            made, event = law.advance(
                *self._addresses, int(min(end, walls.next_step)) - self._count, self._arrays,
                *self._given, overlay.near, self._slipped, wrench, torque)
            self._count += made
            if event:
                self._leave_prints()

    def _gather(self) -> None:
        """Have the tracks around the rover at hand, where it has gone on."""
        x, y = self._arrays.qpos[:2].tolist()
        at_x, at_y, way = self.overlay.near.centre.tolist()
        if not math.isfinite(way) or max(abs(x - at_x), abs(y - at_y)) > way:
            # A place that has diverged is left to the law.
            within = max(abs(x), abs(y)) < _FARTHEST_M
            self.overlay.gather(x if within else 0.0, y if within else 0.0, self._reach_m,
                                GATHER_M if within else math.inf)

    def observe(self) -> GroundContact:
        """Return sinkage [m] and mean slip since the last call [m/s], per leg."""
        sinkage = np.empty(len(self._slipped))
        law.sinkage_of(self._tips, sinkage)
        slip = self._slipped / (max(1, self._count - self._observed) * self._step_s)
        self._slipped[:], self._observed = 0.0, self._count
        deep = sum(s >= self._deep_m for s in sinkage.tolist()) >= 2
        if deep and not self._was_dug_in:
            logger.warning('the rover has dug itself in: tips are %s mm deep',
                           ', '.join(f'{1e3 * s:.0f}' for s in sinkage))
        self._was_dug_in = deep
        return GroundContact(sinkage, slip, deep)

    def keep_start(self) -> None:
        """Keep the present ground as the one to which `reset` goes back."""
        self._walls.slide_all(self.overlay)
        self._start = self.overlay.copy(), self._tips.copy()
        self._begin()

    def reset(self) -> None:
        """Go back to the ground at `keep_start`; the caller restores poses, planes included."""
        if self._start is None:
            return
        overlay, tips = self._start
        self.overlay.restore(overlay)
        self._walls.forget()
        self._tips[:] = tips
        self._was_dug_in = False
        self._begin()

    def _begin(self) -> None:
        self._count = self._observed = 0
        self._slipped[:] = 0.0
        self._windows = [None] * len(self._tips)
        self._slid_at[:] = self._tips['sheared']

    def _leave_prints(self) -> None:
        """Press in what the tips have to leave; raise PhysicsError where one has diverged."""
        for k in np.flatnonzero(self._tips['event']):
            tip = self._tips[k]
            if tip['event'] == law.DIVERGED:
                spoke = self._rover.legs.spokes
                raise PhysicsError(
                    f'at {self._count * self._step_s:.3f} s tip {k % spoke} of leg'
                    f' {self._rover.legs.names[k // spoke]} has diverged: {tip["depth"]:.3g} m'
                    f' deep, {tip["force"]:.3g} N')
            start, end = tip['pressed'].tolist(), tip['low'].tolist()
            if start != end and not math.isnan(start[2]):
                window = press(self.overlay, self._ground, start, end,
                               self._rover.legs.tip_radius_m, self.soil.compacted)
                tip['pressed'] = tip['low']
                known = self._windows[k]
                self._windows[k] = window if known is None else hull(known, window)
            left = tip['event'] == law.LEFT
            if left or tip['sheared'] - self._slid_at[k] > SLIDE_M:
                self._slid_at[k] = 0.0 if left else tip['sheared']
                window_of_print = self._windows[k]
                if window_of_print is not None:
                    self._walls.add(self.overlay, int(tip['leg']), window_of_print, self._count)
                    self._windows[k] = None
            if left:
                tip['pressed'] = np.nan


@functools.cache
def _mj_step() -> int:
    """Return the address of `mj_step` in MuJoCo's library, which is loaded already."""
    folder = Path(mujoco.__file__).parent
    library = ctypes.CDLL(str(next(path for path in sorted(folder.glob('libmujoco*')))))
    return ctypes.cast(library.mj_step, ctypes.c_void_p).value or 0


def _leg_records(model: mujoco.MjModel, first: int, count: int) -> np.ndarray:
    """Return the `law.LEG` records of a compiled model; the bodies of legs follow each other."""
    legs = np.zeros(count, law.LEG)
    for k in range(count):
        body = first + k
        legs['axle'][k] = model.body_pos[body]
        legs['attitude'][k] = matrix_from_wxyz(model.body_quat[body])
        legs['axis'][k] = model.jnt_axis[model.body_jntadr[body]]
    return legs


def _tip_records(model: mujoco.MjModel, rows: SoilRows, first_leg: int) -> np.ndarray:
    """Return the `law.TIP` records of a compiled model, in the air."""
    tips = np.zeros(rows.tips, law.TIP)
    geoms = rows.first_tip + 2 * np.arange(rows.tips)
    tips['leg'] = model.geom_bodyid[geoms] - first_leg
    tips['offset'] = model.geom_pos[geoms]
    tips['mocap'], tips['pair'] = rows.mocap, rows.pairs
    tips['held'] = rows.solref
    tips['normal'] = 0.0, 0.0, 1.0
    tips['pressed'] = np.nan
    return tips


def soil_record(soil: Soil, rover: RoverDescription, step_s: float) -> np.ndarray:
    """Return (1,) records `law.SOIL` of a soil under the tips of a rover, for a time step [s]."""
    record = np.zeros(1, law.SOIL)
    values = dict(
        radius_m=rover.legs.tip_radius_m, rod_m=rover.legs.spoke_radius_m, step_s=step_s,
        elastic_npm=soil.elastic_npm, damping_nspm=soil.damping_nspm, zeta_npm3=soil.zeta_npm3,
        friction=soil.friction, cohesion_pa=soil.cohesion_pa,
        cohesive_bearing_pa=soil.cohesive_bearing_pa, compacted=soil.compacted,
        shear_m=soil.shear_m, side_ratio=soil.shape.side_ratio, weak_slopes=soil.weak_slopes,
        bearing_ratio=BEARING_RATIO, friction_ratio=FRICTION_RATIO,
        deepest_m=DEEPEST_SPOKES * rover.legs.spoke_length_m)
    for name, value in values.items():
        record[name] = value
    return record
