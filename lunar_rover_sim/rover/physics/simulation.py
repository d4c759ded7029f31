"""The rover on the world, step by step."""

from __future__ import annotations

import collections
import dataclasses
import logging
import math
import numbers
import re

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.arguments import brief
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import ConfigError, GroundLeftError, one_line, PhysicsError
from lunar_rover_sim.base.frames import (Array, matrix_from_wxyz, rotated, tilt_deg,
                                         wxyz_from_matrix)
from lunar_rover_sim.ground.regolith.looseness import soil_map
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.foot_motion import FootMotion, FootObserver
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.physics.observation import Observer
from lunar_rover_sim.rover.physics.soft_ground import GroundContact, SoftGround
from lunar_rover_sim.rover.physics.soil_contact import set_soil
from lunar_rover_sim.rover.physics.state import RoverState

MAX_SPEED = 100.0  # [m/s] and [rad/s]: nothing on this rover moves faster unless it diverges
MAX_COMMAND_RADPS = 1e6
MAX_START_TILT_DEG = 60.0  # settled at more, the rover lies on its side or leans on a rock
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_FULL = (int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL))


class Simulation(Closing):
    """A rover on a world in MuJoCo; it starts at rest, at time 0.

    A command holds until the next one. The same commands give the same states, bit by bit, on one
    machine. Use the simulation as a context manager, or call `close`.
    """

    def __init__(self, world: World, rover: RoverDescription, config: PhysicsConfig) -> None:
        """Place the rover at its start and let it settle.

        Raises:
            ConfigError: If it cannot stand there, or where the time step is too long for the
                contact.
        """
        catch_warnings()
        self.rover = rover
        self.config = config
        self._gear = rover.motor.gear_ratio
        self._steps = 0
        self._state: RoverState
        self._soft_ground: SoftGround | None = None
        self._ground_contact: GroundContact | None = None
        self._bind(world)
        model, data = self.model, self.data
        place(model, data, world.ground, rover, config.start)
        self._observer.motion = data.qpos[3:7].copy(), np.zeros(3)
        self._settle()
        self._start_world = world
        self._start = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._start_state = self._state
        self._start_motion = self._observer.motion
        self._start_contact = self._ground_contact
        if self._soft_ground is not None:
            self._soft_ground.keep_start()

    def _bind(self, world: World) -> None:
        """Compile the model of the rover on a world, and let everything work on it."""
        rover, config, ground = self.rover, self.config, world.ground
        self._world = world
        model = build_model(world, rover, config)
        data = mujoco.MjData(model)
        self._model: mujoco.MjModel | None = model
        self._data: mujoco.MjData | None = data
        self._base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
        self._qpos, self._qvel = data.qpos, data.qvel
        self._full = [data.warning[kind] for kind in _FULL]
        if config.ground.deforms:
            soil, variation = config.ground.soil(config.gravity_mps2), config.ground.variation
            rows = set_soil(model, rover, soil, config.contact)
            varies = soil_map(world, variation) if variation else None
            if self._soft_ground is None:
                self._soft_ground = SoftGround(model, data, rover, ground, soil, rows, varies)
            else:
                self._soft_ground.enter(model, data, ground, varies)
        self._feet = FootObserver(rover, ground, config.gravity_mps2)
        self._observer = Observer(model, data, rover, config.gravity_mps2)

    def __repr__(self) -> str:
        if self._data is None:
            return 'Simulation(closed)'
        x_m, y_m, _ = self.state.position_m
        return (f'Simulation({self.rover.total_mass_kg:g} kg at ({x_m:.2f}, {y_m:.2f}) m, '
                f'{self.state.stamp_ns * 1e-9:g} s)')

    def close(self) -> None:
        """Release the model. The simulation cannot be used afterwards."""
        self._model = self._data = None

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled MuJoCo model, to be read; raises PhysicsError after `close`."""
        if self._model is None:
            raise PhysicsError('the simulation is closed')
        return self._model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data, to be read; raises PhysicsError after `close`."""
        if self._data is None:
            raise PhysicsError('the simulation is closed')
        return self._data

    @property
    def time_ns(self) -> int:
        """Time since the start [ns]."""
        return self._steps * self.config.step_ns

    @property
    def world(self) -> World:
        """The window of the site on which the rover is now."""
        return self._world

    def enter(self, world: World) -> None:
        """Go on in another window of the site; the motion is bit for bit that without.

        Model and data are new ones then.

        Raises:
            PhysicsError: If the window does not hold the rover, or has other ground there.
        """
        x, y = self._qpos[:2].tolist()
        here, there = (w.ground.height_at_point(x, y) for w in (self._world, world))
        if here != there:
            around = 'the window around (%g, %g) m' % world.ground.middle_m
            raise PhysicsError(f'enter: {around} is not valid; its ground at the rover, x = '
                               f'{x:.2f} m, y = {y:.2f} m, is at {there:g} m; valid is a window '
                               f'of the same site that holds the rover, at {here:g} m')
        self._continue_on(world)

    def _continue_on(self, world: World) -> None:
        model, before, motion = self.model, self.data, self._observer.motion
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, before, state, _STATE)
        self._bind(world)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        # What else is read of the data follows from the state. It changes the warm start.
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        for old, new in zip(before.warning, self.data.warning):
            new.number, new.lastinfo = old.number, old.lastinfo
        self._observer.motion = motion

    def command(self, velocity_radps: ArrayLike) -> None:
        """Set the velocity setpoints of the motors, (legs,) [rad/s] in their order.

        Raises:
            PhysicsError: If they are not finite numbers, one for each leg, or after `close`.
        """
        try:
            velocity = np.asarray(velocity_radps, dtype=float)
        except (TypeError, ValueError):
            velocity = np.empty(0)
        if velocity.shape != self.data.ctrl.shape or not np.isfinite(velocity).all():
            raise PhysicsError(f'command: {brief(velocity_radps)} is not valid; valid is '
                               f'{self.model.nu} finite velocities [rad/s]')
        # The bound is far above what gives full torque, and below 1e10, from where on MuJoCo
        # takes a control for an error and sets it to 0.
        velocity = np.minimum(np.maximum(velocity, -MAX_COMMAND_RADPS), MAX_COMMAND_RADPS)
        self.data.ctrl[:] = velocity * self._gear

    def apply_force(self, force_n: ArrayLike) -> None:
        """Pull at the centre of mass of the chassis with a force (3,) [N], world axes.

        It holds until the next call or `reset`: a cable, as in a measurement of drawbar pull.

        Raises:
            PhysicsError: If it is not three finite numbers.
        """
        force = np.asarray(force_n, dtype=float)
        if force.shape != (3,) or not np.isfinite(force).all():
            raise PhysicsError(f'apply_force: {brief(force_n)} is not valid; valid is three finite'
                               ' numbers [N]')
        self.data.xfrc_applied[self._base, :3] = force

    @property
    def state(self) -> RoverState:
        """The present state."""
        return self._state

    @property
    def ground_contact(self) -> GroundContact | None:
        """Sinkage and slip of each leg at the present state; None on rigid ground."""
        return self._ground_contact

    @property
    def foot_motion(self) -> FootMotion:
        """Sweep and slip of each foot at the present state, computed when asked for."""
        return self._feet.observe(self._state)

    @property
    def overlay(self) -> Overlay | None:
        """What the rover has changed of the ground, to be read; None on rigid ground."""
        return self._soft_ground.overlay if self._soft_ground is not None else None

    def advance(self, n_steps: int) -> RoverState:
        """Make n >= 1 steps of `config.step_s` and return the state at their end.

        Raises:
            PhysicsError: If the motion diverges or the rover leaves the ground.
        """
        if not isinstance(n_steps, numbers.Integral) or n_steps < 1:
            raise PhysicsError(f'advance: {brief(n_steps)} is not valid; valid is a whole number'
                               ' of steps >= 1')
        model, data = self.model, self.data
        step, observer = mujoco.mj_step, self._observer
        step_wrench, step_torque = observer.leg_wrench, observer.motor_torque
        wrench, torque = np.zeros_like(step_wrench), np.zeros_like(step_torque)
        soft_ground = self._soft_ground
        if soft_ground is not None:
            soft_ground.advance(int(n_steps), wrench, torque)
        else:
            for _ in range(n_steps):
                step(model, data)
                wrench += step_wrench
                torque += step_torque
        self._steps += n_steps
        self._check()
        if soft_ground is not None:
            self._ground_contact = soft_ground.observe()
        wrench /= n_steps
        torque /= n_steps
        self._state = observer.observe(self.time_ns, n_steps * self.config.step_ns * 1e-9, wrench,
                                       torque)
        return self._state

    def reset(self) -> RoverState:
        """Go back to the settled start, at time 0, and return its state."""
        catch_warnings()
        if self._world is not self._start_world:
            self._bind(self._start_world)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._start, _STATE)
        if self._soft_ground is not None:
            self._soft_ground.reset()
        self._ground_contact = self._start_contact
        self._steps = 0
        self._state = self._start_state
        self._observer.motion = self._start_motion
        return self._state

    def move(self, position_m: ArrayLike | None = None, orientation_wxyz: ArrayLike | None = None,
             linear_mps: ArrayLike | None = None,
             angular_radps: ArrayLike | None = None) -> RoverState:
        """Put the rover elsewhere or give it another velocity, and return its state.

        Arguments and errors as in `relocate`. The IMU does not feel the jump.

        Raises:
            PhysicsError: Also on ground that deforms: it remembers where each leg stood.
        """
        if self._soft_ground is not None:
            raise PhysicsError('move: the ground deforms; valid is rigid ground')
        relocate(self.model, self.data, self._world.ground, position_m, orientation_wxyz,
                 linear_mps, angular_radps)
        self._observer.after_jump()
        quat = self._qpos[3:7].copy()
        self._state = dataclasses.replace(
            self._state, position_m=self._qpos[:3].copy(), orientation_wxyz=quat,
            linear_velocity_mps=rotated(matrix_from_wxyz(quat).T, self._qvel[:3]),
            angular_velocity_radps=self._qvel[3:6].copy())
        return self._state

    def _settle(self) -> None:
        """Let the rover come to rest with its legs held, then set the clock to 0."""
        steps = max(1, round(self.config.start.settle_s / self.config.step_s))
        if steps > 1:
            self.advance(steps - 1)
        self.advance(1)
        self.data.time = 0.0
        self._steps = 0
        self._state = dataclasses.replace(self._state, stamp_ns=0)
        tilt = float(tilt_deg(self._state.orientation_wxyz))
        if tilt > MAX_START_TILT_DEG:
            start = self.config.start
            raise ConfigError(f'start: the rover does not stand at x_m = {start.x_m:g}, y_m ='
                              f' {start.y_m:g} (tilted {tilt:.0f} deg once settled); choose'
                              ' another place')

    def _is_full(self) -> bool:
        """Return whether MuJoCo had to leave out contacts or constraints."""
        contacts, constraints = self._full
        return bool(contacts.number or constraints.number)

    def _check(self) -> None:
        """Raise PhysicsError if the motion has diverged or the rover has left the ground."""
        if not self._qvel.dot(self._qvel) < MAX_SPEED ** 2 or self._is_full():
            raise PhysicsError(diagnosis(self.model, self.data, self.time_ns * 1e-9))
        x, y, _ = self._qpos[:3].tolist()
        if not is_on(self._world.ground, x, y):
            raise GroundLeftError(f'at {self.time_ns * 1e-9:.3f} s base_link left the ground at'
                                  f' x = {x:.2f} m, y = {y:.2f} m; the ground ends at'
                                  f' {end_of(self._world.ground)}')


logger = logging.getLogger(__name__)

_texts: collections.deque[str] = collections.deque(maxlen=16)


def catch_warnings() -> None:
    """Send MuJoCo's warnings to the log, unless a handler is set already, and forget old ones.

    By default MuJoCo writes them to the terminal and to a file MUJOCO_LOG.TXT.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_take)
    _texts.clear()


def diagnosis(model: mujoco.MjModel, data: mujoco.MjData, time_s: float) -> str:
    """Return one line that names the time and the body at which a simulation diverged.

    They are those of MuJoCo's first warning; without a warning, the body is the fastest one.
    """
    text = _texts[0] if _texts else ''
    found = re.search(r'DOF (\d+).*Time = (\d+\.\d+)', text)
    speed = np.abs(np.nan_to_num(data.qvel, nan=np.inf))
    if found:
        dof, time_s = int(found.group(1)), float(found.group(2))
    else:
        dof = int(np.argmax(speed))
    body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY,
                             int(model.dof_bodyid[min(dof, model.nv - 1)]))
    reason = f'; MuJoCo: {text}' if text else f' (speed {speed.max():.3g})'
    return (f'the simulation diverged at {time_s:.3f} s in body {body}{reason}; use a shorter'
            ' step_s or a softer contact')


def _take(text: str) -> None:
    line = one_line(text)
    _texts.append(line)
    logger.debug('MuJoCo: %s', line)


def is_on(ground: HeightGrid, x: float, y: float) -> bool:
    """Return whether a place in the frame of the site lies on a ground."""
    (middle_x, middle_y), limit = ground.middle_m, ground.half_extent_m
    return abs(x - middle_x) <= limit and abs(y - middle_y) <= limit


def end_of(ground: HeightGrid) -> str:
    """Return where a ground ends, in words."""
    x, y = ground.middle_m
    around = f' around x = {x:g} m, y = {y:g} m' if (x, y) != (0.0, 0.0) else ''
    return f'{ground.half_extent_m:.2f} m{around}'


# A pose that lies deeper in the ground is refused: contact would throw the rover out.
MAX_DEPTH_M = 0.003
MAX_GIVEN_SPEED = 10.0    # [m/s] and [rad/s]


def relocate(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid,
             position_m: ArrayLike | None, orientation_wxyz: ArrayLike | None,
             linear_mps: ArrayLike | None, angular_radps: ArrayLike | None) -> None:
    """Write pose (world frame) and velocity (world axes) of base_link into `data`.

    What is None stays, and so do the legs.

    Raises:
        PhysicsError: If that is not a pose above the ground with the legs free of it, or a
            velocity of MAX_GIVEN_SPEED and more; nothing is changed then.
    """
    qpos, qvel = data.qpos.copy(), data.qvel.copy()
    if position_m is not None:
        qpos[:3] = _finite('position', position_m, 3)
    if orientation_wxyz is not None:
        qpos[3:7] = _finite('orientation', orientation_wxyz, 4)
    norm = float(np.linalg.norm(qpos[3:7]))
    if abs(norm - 1.0) > 1e-3:
        raise PhysicsError(f'orientation: {qpos[3:7].tolist()} is not valid; valid is a unit '
                           'quaternion')
    qpos[3:7] /= norm
    x, y, z = qpos[:3].tolist()
    if not is_on(ground, x, y):
        raise PhysicsError(f'position: x = {x:g} m, y = {y:g} m is not on the ground; it ends at '
                           f'{end_of(ground)}')
    if linear_mps is not None:
        qvel[:3] = _finite('linear velocity', linear_mps, 3)
    if angular_radps is not None:
        qvel[3:6] = _finite('angular velocity', angular_radps, 3) @ matrix_from_wxyz(qpos[3:7])
    if max(np.linalg.norm(qvel[:3]), np.linalg.norm(qvel[3:6])) >= MAX_GIVEN_SPEED:
        raise PhysicsError(f'velocity: {qvel[:6].tolist()} is not valid; valid is less than '
                           f'{MAX_GIVEN_SPEED:g} m/s and rad/s')
    before = data.qpos.copy()
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    depth_m = max(-float(np.min(data.contact.dist, initial=0.0)),
                  ground.height_at_point(x, y) - z)
    if depth_m > MAX_DEPTH_M:
        data.qpos[:] = before
        mujoco.mj_fwdPosition(model, data)
        raise PhysicsError(f'position: x = {x:.3f} m, y = {y:.3f} m, z = {z:.3f} m lies '
                           f'{depth_m:.3f} m in the ground or in a rock; raise it')
    data.qvel[:] = qvel
    mujoco.mj_forward(model, data)


def _finite(name: str, values: ArrayLike, count: int) -> Array:
    array = np.asarray(values, dtype=float)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise PhysicsError(f'{name}: {brief(values)} is not valid; valid is {count} finite '
                           'numbers')
    return array


CLEARANCE_M = 0.001
MARGIN_M = 1.0   # least distance of the start from the border of the ground
RAISE_M = 0.005  # step by which the rover is raised until it touches nothing


def place(model: mujoco.MjModel, data: mujoco.MjData, ground: HeightGrid, rover: RoverDescription,
          start: StartPose) -> None:
    """Put the rover at the start pose, clear of the ground and of rocks; writes `data.qpos`.

    Raises:
        ConfigError: If the start is not on the ground, or if there is no room for the rover.
    """
    limit = ground.half_extent_m - MARGIN_M
    for name, value, middle in (('start.x_m', start.x_m, ground.middle_m[0]),
                                ('start.y_m', start.y_m, ground.middle_m[1])):
        if abs(value - middle) > limit:
            raise ConfigError(f'{name}: {value} is not valid; valid is {middle - limit:g} to '
                              f'{middle + limit:g} [m] on this world')
    rotation = _level_rotation(ground, rover, start)
    data.qpos[:3] = start.x_m, start.y_m, 0.0
    data.qpos[3:7] = wxyz_from_matrix(rotation)
    legs = len(rover.legs.each)
    if len(start.joint_angle_rad) not in (1, legs):
        raise ConfigError(f'start.joint_angle_rad: {len(start.joint_angle_rad)} elements given; '
                          f'valid is one for all legs, or {legs}')
    data.qpos[7:7 + legs] = start.joint_angle_rad
    data.qvel[:] = 0.0
    mujoco.mj_kinematics(model, data)
    # The tips; soft ground has balls on the chassis, too.
    on_legs = model.geom_bodyid > mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
    spheres = np.flatnonzero(on_legs & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE))
    centres = data.geom_xpos[spheres]
    lowest = centres[:, 2] - model.geom_size[spheres, 0]
    # Steep ground touches a sphere beside its lowest point: look at a disc below each.
    offsets = model.geom_size[spheres, 0].max() * _DISC
    under = ground.height_at(centres[:, None, :2] + offsets)
    data.qpos[2] = np.max(under.max(axis=1) - lowest) + CLEARANCE_M
    for _ in range(400):
        mujoco.mj_fwdPosition(model, data)
        if data.ncon == 0:
            return
        data.qpos[2] += RAISE_M
    raise ConfigError(f'start: no room for the rover at x_m = {start.x_m}, y_m = {start.y_m}')


_ANGLES = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
_DISC = np.concatenate([np.zeros((1, 2)), np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], -1)])


def _level_rotation(ground: HeightGrid, rover: RoverDescription, start: StartPose) -> Array:
    """Return R_world_base whose z axis is the normal of the plane through the footholds.

    The plane is that of least squares. Sums of plain numbers round alike on every processor.
    """
    yaw = math.radians(start.yaw_deg)
    cos, sin = math.cos(yaw), math.sin(yaw)
    feet = [position[:2] for position in rover.legs.axle_positions_m()]
    heights = [ground.height_at_point(start.x_m + x * cos - y * sin, start.y_m + x * sin + y * cos)
               for x, y in feet]
    mid_x, mid_y, mid_z = (sum(values) / len(feet) for values in (*zip(*feet), heights))
    xx = xy = yy = xz = yz = 0.0
    for (x, y), z in zip(feet, heights):
        x, y, z = x - mid_x, y - mid_y, z - mid_z
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    area = xx * yy - xy * xy        # > 0: the centre of mass is between the axles
    slope_x, slope_y = (xz * yy - yz * xy) / area, (yz * xx - xz * xy) / area
    # The heading along the plane, and its cross product with what is to the left of it.
    along = math.sqrt(1.0 + slope_x * slope_x)
    x_axis = np.array([cos / along, sin / along, slope_x / along])
    z_axis = np.cross(x_axis, [-sin, cos, slope_y])
    z_axis /= math.sqrt(sum(v * v for v in z_axis.tolist()))
    return np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
