"""The rover on the world, step by step."""

from __future__ import annotations

import collections
from collections.abc import Mapping
import dataclasses
import logging
import numbers
from pathlib import Path
import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import brief, ConfigError, GroundLeftError, one_line, PhysicsError
from lunar_rover_sim.base.files.state_file import attributes, load_state, save_state
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rotated, tilt_deg
from lunar_rover_sim.base.process import return_freed
from lunar_rover_sim.ground.regolith.looseness import soil_map
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import Windows
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.foot_motion import FootMotion, FootObserver
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.physics.observation import Observer
from lunar_rover_sim.rover.physics.placing import check_start, finite, is_on, place, relocate
from lunar_rover_sim.rover.physics.soft_ground import GroundContact, SoftGround
from lunar_rover_sim.rover.physics.soil_contact import set_soil
from lunar_rover_sim.rover.physics.state import RoverState

MAX_SPEED = 100.0  # [m/s] and [rad/s]: nothing on this rover moves faster unless it diverges
MAX_COMMAND_RADPS = 1e6
_FOLLOW_S = 0.5     # after which it looks whether the rover is in another window
MAX_START_TILT_DEG = 60.0  # settled at more, the rover lies on its side or leans on a rock
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_FULL = (int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL))


class Simulation(Closing):
    """A rover on a site in MuJoCo; it starts at rest, at time 0.

    The window of the site goes on with the rover; `world` is the present one. The motion is bit
    for bit that in one window large enough for all of it.

    A command holds until the next one. The same commands give the same states, bit by bit, on one
    machine. Use the simulation as a context manager, or call `close`.
    """

    def __init__(self, world: World, rover: RoverDescription, config: PhysicsConfig,
                 site: Windows | None = None) -> None:
        """Place the rover at its start, anywhere on the site, and let it settle.

        Args:
            world: A window of the site. One that was made by hand is all of its site.
            site: By default the one that the world says it is a window of.

        Raises:
            ConfigError: If it cannot stand there, or where the time step is too long for the
                contact.
            WorldError: If the window around the start cannot be made.
        """
        catch_warnings()
        self.rover = rover
        self.config = config
        self._gear = rover.motor.gear_ratio
        self._steps = 0
        self._state: RoverState
        self._soft_ground: SoftGround | None = None
        self._ground_contact: GroundContact | None = None
        self._follower = Follower(world, site)
        check_start(config.start, self._follower)
        self._bind(self._follower.at(config.start.x_m, config.start.y_m))
        model, data = self.model, self.data
        place(model, data, self._world.ground, rover, config.start)
        self._observer.motion = data.qpos[3:7].copy(), np.zeros(3)
        self._settle()
        self._start_site, self._start_middle_m = self._follower.site, self._world.ground.middle_m
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
            rows = set_soil(model, rover, config.ground, soil)
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
        self._follower.close()

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

        The simulation does so by itself. This is for windows that were made by hand. Model and
        data are new ones then.

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
        self._follower.enter(world)
        self._continue_on(world)

    def _continue_on(self, world: World) -> None:
        model, before, motion = self.model, self.data, self._observer.motion
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, before, state, _STATE)
        self._bind(world)
        self._set(state)
        for old, new in zip(before.warning, self.data.warning):
            new.number, new.lastinfo = old.number, old.lastinfo
        self._observer.motion = motion
        del model, before, old
        return_freed()

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
            PhysicsError: If the motion diverges or the rover leaves the site.
            WorldError: If the next window cannot be made.
        """
        if not isinstance(n_steps, numbers.Integral) or n_steps < 1:
            raise PhysicsError(f'advance: {brief(n_steps)} is not valid; valid is a whole number'
                               ' of steps >= 1')
        wrench = np.zeros_like(self._observer.leg_wrench)
        torque = np.zeros_like(self._observer.motor_torque)
        most = max(1, round(_FOLLOW_S / self.config.step_s))
        for made in range(0, int(n_steps), most):
            if made:
                self._enter_at(*self._qpos[:2].tolist())
            self._step(min(most, int(n_steps) - made), wrench, torque)
        if self._soft_ground is not None:
            self._ground_contact = self._soft_ground.observe()
        wrench /= n_steps
        torque /= n_steps
        self._state = self._observer.observe(
            self.time_ns, n_steps * self.config.step_ns * 1e-9, wrench, torque)
        self._enter_at(*self._qpos[:2].tolist())
        return self._state

    def _step(self, n_steps: int, wrench: Array, torque: Array) -> None:
        """Make steps, and add the wrenches (legs, 6) and torques (legs,) at each of them."""
        model, data, step = self.model, self.data, mujoco.mj_step
        step_wrench, step_torque = self._observer.leg_wrench, self._observer.motor_torque
        if self._soft_ground is not None:
            self._soft_ground.advance(n_steps, wrench, torque)
        else:
            for _ in range(n_steps):
                step(model, data)
                wrench += step_wrench
                torque += step_torque
        self._steps += n_steps
        self._check()

    def _enter_at(self, x_m: float, y_m: float) -> None:
        """Enter the window of the site for a rover at a place."""
        world = self._follower.at(x_m, y_m)
        if world is not self._world:
            self._continue_on(world)

    def reset(self) -> RoverState:
        """Go back to the settled start, at time 0, and return its state."""
        catch_warnings()
        if (self._follower.site is not self._start_site
                or self._world.ground.middle_m != self._start_middle_m):
            self._follower.close()
            self._follower = Follower(self._start_site.window(self._start_middle_m),
                                      self._start_site)
            self._bind(self._follower.world)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._start, _STATE)
        if self._soft_ground is not None:
            self._soft_ground.reset()
        self._ground_contact = self._start_contact
        self._steps = 0
        self._state = self._start_state
        self._observer.motion = self._start_motion
        return self._state

    def save(self, path: str | Path) -> None:
        """Write all that the motion goes on from to a file, for `restore`.

        Raises:
            ConfigError: If the file cannot be written.
        """
        save_state(Path(path), self.checkpoint())

    def restore(self, path: str | Path) -> RoverState:
        """Go on from what `save` has written, and return the state; the motion is bit for bit that
        of the simulation that was saved.

        The simulation must have the same rover, parameters and site. `reset` goes back to the
        start of its own.

        Raises:
            ConfigError: If the file cannot be read, or another version has written it.
            PhysicsError: If it was saved with another rover, other parameters or other ground.
            WorldError: If the window in which the rover was cannot be made.
        """
        return self.resume(load_state(Path(path)))

    def checkpoint(self) -> dict[str, Any]:
        """Return what `save` writes."""
        values = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, values, _STATE)
        soil = self._soft_ground
        return {
            'of': self._conditions(), 'middle_m': self._world.ground.middle_m,
            'ground_m': self._world.ground.height_at_point(*self._qpos[:2].tolist()),
            'mujoco': values, 'motion': self._observer.motion,
            'soil': None if soil is None else soil.state(),
            **attributes(self, '_steps', '_state', '_ground_contact')}

    def resume(self, state: Mapping[str, Any]) -> RoverState:
        """Go on from what `checkpoint` has returned; errors as of `restore`."""
        for name, value in self._conditions().items():
            if name not in state['of'] or state['of'][name] != value:
                raise PhysicsError(f'restore: the state is of another {name}; valid is '
                                   f'{brief(value)}')
        world = self._follower.go_to(state['middle_m'])
        if world is not self._world:
            self._bind(world)
        self._set(state['mujoco'])
        height = world.ground.height_at_point(*self._qpos[:2].tolist())
        if height != state['ground_m']:
            raise PhysicsError(f'restore: the state is of another site: its ground at the rover is'
                               f' at {state["ground_m"]:g} m; valid is {height:g} m')
        if self._soft_ground is not None:
            self._soft_ground.resume(state['soil'])
        self._observer.motion = state['motion']
        self._steps, self._state = state['_steps'], state['_state']
        self._ground_contact = state['_ground_contact']
        return self._state

    def _conditions(self) -> dict[str, Any]:
        """Return what two simulations have in common of which one goes on as the other."""
        return {'rover': self.rover, **{field.name: getattr(self.config, field.name)
                                        for field in dataclasses.fields(PhysicsConfig)}}

    def _set(self, values: Array) -> None:
        """Set the state of MuJoCo."""
        mujoco.mj_setState(self.model, self.data, values, _STATE)
        # What else is read of the data follows from the state. It changes the warm start.
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, values, _STATE)

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
        if position_m is not None:
            x, y, _ = finite('position', position_m, 3).tolist()
            if self._follower.holds(x, y):
                self._enter_at(x, y)
        try:
            relocate(self.model, self.data, self._world.ground, position_m, orientation_wxyz,
                     linear_mps, angular_radps, self._follower.end)
        except PhysicsError:
            self._enter_at(*self._qpos[:2].tolist())
            raise
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
                                  f' x = {x:.2f} m, y = {y:.2f} m; {self._follower.end}')


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
