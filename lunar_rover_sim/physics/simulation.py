"""The rover on the world, step by step."""

from __future__ import annotations

import dataclasses
import numbers
from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError, PhysicsError
from lunar_rover_sim.frames import matrix_from_wxyz, tilt_deg
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.divergence import catch_warnings, diagnosis
from lunar_rover_sim.physics.foot_motion import FootMotion, FootObserver
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.observation import Observer
from lunar_rover_sim.physics.placement import place
from lunar_rover_sim.physics.relocation import relocate
from lunar_rover_sim.physics.soft_ground import GroundContact, SoftGround
from lunar_rover_sim.physics.soil_contact import set_soil
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.regolith.looseness import soil_map
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.world.model import World

MAX_SPEED = 100.0  # [m/s] and [rad/s]: nothing on this rover moves faster unless it diverges
MAX_COMMAND_RADPS = 1e6
MAX_START_TILT_DEG = 60.0  # settled at more, the rover lies on its side or leans on a rock
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_FULL = (int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL))


class Simulation:
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
        self._ground = world.ground
        self._half_extent_m = world.ground.half_extent_m
        self._model: mujoco.MjModel | None = build_model(world, rover, config)
        self._data: mujoco.MjData | None = mujoco.MjData(self._model)
        self._gear = rover.motor.gear_ratio
        model, data = self._model, self._data
        self._base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
        self._qpos, self._qvel = data.qpos, data.qvel
        self._full = [data.warning[kind] for kind in _FULL]
        self._steps = 0
        self._state: RoverState
        self._soft_ground: SoftGround | None = None
        if config.ground.deforms:
            soil = config.ground.soil(config.gravity_mps2)
            rows = set_soil(model, rover, soil, config.contact)
            varies = config.ground.variation
            self._soft_ground = SoftGround(model, data, rover, world.ground, soil, rows,
                                           soil_map(world, varies) if varies else None)
        self._ground_contact: GroundContact | None = None
        self._feet = FootObserver(rover, world.ground, config.gravity_mps2)
        place(model, data, world.ground, rover, config.start)
        self._observer = Observer(model, data, rover, config.gravity_mps2)
        self._settle()
        self._start = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._start_state = self._state
        self._start_motion = self._observer.motion
        self._start_contact = self._ground_contact
        if self._soft_ground is not None:
            self._soft_ground.keep_start()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

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
        relocate(self.model, self.data, self._ground, position_m, orientation_wxyz, linear_mps,
                 angular_radps)
        self._observer.after_jump()
        quat = self._qpos[3:7].copy()
        self._state = dataclasses.replace(
            self._state, position_m=self._qpos[:3].copy(), orientation_wxyz=quat,
            linear_velocity_mps=self._qvel[:3] @ matrix_from_wxyz(quat),
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
        limit = self._half_extent_m
        if not (abs(x) <= limit and abs(y) <= limit):
            raise PhysicsError(f'at {self.time_ns * 1e-9:.3f} s base_link left the ground at'
                               f' x = {x:.2f} m, y = {y:.2f} m; the ground ends at'
                               f' {limit:.2f} m')
