"""The rover on the world, step by step."""

from __future__ import annotations

import dataclasses
from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.errors import ConfigError, PhysicsError
from lunar_rover_sim.frames import Array, matrix_from_wxyz, wxyz_from_rpy
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.divergence import catch_warnings, diagnosis
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.placement import place
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import LEG_NAMES, RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.world.model import World

MAX_SPEED = 100.0  # [m/s] and [rad/s]: nothing on this rover moves faster unless it diverges
MAX_COMMAND_RADPS = 1e6
MAX_START_TILT_DEG = 60.0  # settled beyond this, the rover lies on its side or against a rock
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
# (a @ _CROSS).reshape(3, 3) @ b is the cross product of a and b.
_CROSS = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
                   [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
                   [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
_FULL = (int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL))


class Simulation:
    """MuJoCo with this rover on this world; starts settled, at time 0.

    Commands hold until the next one. The same commands give the same states, bit by bit, on one
    machine. Use it as a context manager, or call `close`.
    """

    def __init__(self, world: World, rover: RoverDescription, config: PhysicsConfig) -> None:
        catch_warnings()
        self.rover = rover
        self.config = config
        self._half_extent_m = world.ground.half_extent_m
        self._model: mujoco.MjModel | None = build_model(world, rover, config)
        self._data: mujoco.MjData | None = mujoco.MjData(self._model)
        self._gear = rover.motor.gear_ratio
        self._torque_per_ampere = rover.motor.gear_ratio * rover.motor.motor_constant
        model, data = self._model, self._data
        legs = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, leg) for leg in LEG_NAMES]
        base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
        if legs != list(range(legs[0], legs[0] + 4)):
            raise PhysicsError('the legs are not neighbours in the model')
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        self._leg_wrench = data.cfrc_ext[legs[0]:legs[0] + 4]
        self._motor = data.qfrc_actuator[6:10]
        self._com = data.subtree_com[base]
        self._axles = data.xpos[legs[0]:legs[0] + 4]
        self._full = [data.warning[kind] for kind in _FULL]
        self._imu_position = np.array(rover.imu.position_m)
        self._R_base_imu = matrix_from_wxyz(wxyz_from_rpy(*np.radians(rover.imu.rpy_deg)))
        self._gravity = np.array([0.0, 0.0, -config.gravity_mps2])
        self._steps = 0
        place(model, data, world.ground, rover, config.start)
        self._last_quat = self._qpos[3:7].copy()
        self._last_imu_velocity = np.zeros(3)
        self._settle()
        self._start = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._start_state = self._state
        self._start_motion = self._last_quat, self._last_imu_velocity

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Release the model; the simulation cannot be used after."""
        self._model = self._data = None

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled MuJoCo model, for looking at; raises PhysicsError after close."""
        if self._model is None:
            raise PhysicsError('the simulation is closed')
        return self._model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data, for looking at; raises PhysicsError after close."""
        if self._data is None:
            raise PhysicsError('the simulation is closed')
        return self._data

    @property
    def time_ns(self) -> int:
        """Time since the start [ns]."""
        return self._steps * self.config.step_ns

    def command(self, velocity_radps: ArrayLike, angle_rad: ArrayLike | None = None) -> None:
        """Set the motors' velocity setpoints (4,) [rad/s].

        The motors are velocity-controlled: `angle_rad`, the reference angle (4,), is the business
        of the gait controller and is not used. Raises PhysicsError on values that are not finite.
        """
        velocity = np.asarray(velocity_radps, dtype=float)
        if velocity.shape != (4,) or not np.isfinite(velocity).all():
            raise PhysicsError(f'command: {velocity_radps!r} is not valid; valid is four finite'
                               ' velocities [rad/s]')
        # Far beyond what asks for full torque, and short of what MuJoCo takes for nonsense and 0.
        velocity = np.minimum(np.maximum(velocity, -MAX_COMMAND_RADPS), MAX_COMMAND_RADPS)
        self._ctrl[:] = velocity * self._gear

    def state(self) -> RoverState:
        """Return the present state."""
        return self._state

    def advance(self, n_steps: int) -> RoverState:
        """Make n >= 1 steps and return the state at their end.

        Raises PhysicsError if the motion diverges or the rover has left the ground.
        """
        if n_steps < 1:
            raise PhysicsError(f'advance: {n_steps} steps asked for; valid is >= 1')
        model, data = self.model, self.data
        step, step_wrench, step_torque = mujoco.mj_step, self._leg_wrench, self._motor
        wrench, torque = np.zeros((4, 6)), np.zeros(4)
        for _ in range(n_steps):
            step(model, data)
            wrench += step_wrench
            torque += step_torque
        self._steps += n_steps
        self._check()
        wrench /= n_steps
        torque /= n_steps
        self._state = self._observe(wrench, torque, n_steps * self.config.step_ns * 1e-9)
        return self._state

    def reset(self) -> RoverState:
        """Go back to the settled start, at time 0."""
        catch_warnings()
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._start, _STATE)
        self._steps = 0
        self._state = self._start_state
        self._last_quat, self._last_imu_velocity = self._start_motion
        return self._state

    def _settle(self) -> None:
        """Let the rover come to rest with its motors braked, then set the clock to 0."""
        steps = max(1, round(self.config.start.settle_s / self.config.step_s))
        if steps > 1:
            self.advance(steps - 1)
        self.advance(1)
        self.data.time = 0.0
        self._steps = 0
        self._state = dataclasses.replace(self._state, time_ns=0)
        _, x, y, _ = self._state.orientation_wxyz
        tilt_deg = float(np.degrees(np.arccos(1.0 - 2.0 * (x * x + y * y))))
        if tilt_deg > MAX_START_TILT_DEG:
            start = self.config.start
            raise ConfigError(f'start: the rover does not stand at x_m = {start.x_m:g}, y_m ='
                              f' {start.y_m:g} (tilted {tilt_deg:.0f} deg once settled); choose'
                              ' another place')

    def _observe(self, wrench: Array, torque: Array, interval_s: float) -> RoverState:
        """Return the state now; IMU signals from the motion since the state before.

        The rate is the constant rate that turns the one attitude into the other. The specific
        force is the mean acceleration of the IMU less gravity, in the axes halfway between.
        """
        # ndarray.dot and MuJoCo's functions take a third of the time of @ and np.cross here.
        qpos, qvel = self._qpos, self._qvel
        quat, rate, middle = qpos[3:7].copy(), np.empty(3), self._last_quat.copy()
        swing, matrix, matrix_middle = np.empty(3), np.empty(9), np.empty(9)
        mujoco.mju_subQuat(rate, quat, middle)
        rate /= interval_s
        mujoco.mju_quatIntegrate(middle, rate, 0.5 * interval_s)
        mujoco.mju_quat2Mat(matrix, quat)
        mujoco.mju_quat2Mat(matrix_middle, middle)
        R_world_base, R_world_middle = matrix.reshape(3, 3), matrix_middle.reshape(3, 3)
        mujoco.mju_cross(swing, qvel[3:6], self._imu_position)
        velocity = qvel[:3]
        imu_velocity = R_world_base.dot(swing)
        imu_velocity += velocity
        force = imu_velocity - self._last_imu_velocity
        force /= interval_s
        force -= self._gravity
        self._last_quat, self._last_imu_velocity = quat, imu_velocity
        pull = wrench[:, 3:].copy()
        lever = (self._com - self._axles).dot(_CROSS).reshape(4, 3, 3)
        turn = np.matmul(lever, pull[:, :, None])[:, :, 0]
        turn += wrench[:, :3]
        return RoverState(
            time_ns=self.time_ns,
            position_m=qpos[:3].copy(),
            orientation_wxyz=quat,
            linear_velocity_mps=velocity.dot(R_world_base),
            angular_velocity_radps=qvel[3:6].copy(),
            joint_angle_rad=qpos[7:11].copy(),
            joint_velocity_radps=qvel[6:10].copy(),
            motor_torque_nm=torque,
            motor_current_a=torque / self._torque_per_ampere,
            contact_force_n=pull,
            contact_torque_nm=turn,
            specific_force_mps2=force.dot(R_world_middle).dot(self._R_base_imu),
            imu_rate_radps=rate.dot(self._R_base_imu))

    def _is_full(self) -> bool:
        """Return whether MuJoCo had to leave out contacts or constraints."""
        contacts, constraints = self._full
        return bool(contacts.number or constraints.number)

    def _check(self) -> None:
        """Raise PhysicsError if the state is no longer that of a rover on the ground."""
        if not self._qvel.dot(self._qvel) < MAX_SPEED ** 2 or self._is_full():
            raise PhysicsError(diagnosis(self.model, self.data, self.time_ns * 1e-9))
        x, y, _ = self._qpos[:3].tolist()
        limit = self._half_extent_m
        if not (abs(x) <= limit and abs(y) <= limit):
            raise PhysicsError(f'at {self.time_ns * 1e-9:.3f} s base_link left the ground at'
                               f' x = {x:.2f} m, y = {y:.2f} m; the ground ends at'
                               f' {limit:.2f} m')
