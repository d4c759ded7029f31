"""The rover on the world, step by step."""

from __future__ import annotations

import dataclasses
import logging
from types import TracebackType

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.errors import PhysicsError
from lunar_rover_sim.frames import Array, wxyz_from_rpy
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.placement import place
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import LEG_NAMES, RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.world.model import World

logger = logging.getLogger(__name__)

MAX_SPEED = 100.0  # [m/s] and [rad/s]: nothing on this rover moves faster unless it diverges
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_CONTACTFULL = int(mujoco.mjtWarning.mjWARN_CONTACTFULL)


class Simulation:
    """MuJoCo with this rover on this world; starts settled, at time 0.

    Commands hold until the next one. The same commands give the same states, bit by bit, on one
    machine. Use it as a context manager, or call `close`.
    """

    def __init__(self, world: World, rover: RoverDescription, config: PhysicsConfig) -> None:
        self.rover = rover
        self.config = config
        self._half_extent_m = world.ground.half_extent_m
        self._model: mujoco.MjModel | None = build_model(world, rover, config)
        self._data: mujoco.MjData | None = mujoco.MjData(self._model)
        self._gear = rover.motor.gear_ratio
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
        self._imu_position = np.array(rover.imu.position_m)
        self._q_base_imu = wxyz_from_rpy(*np.radians(rover.imu.rpy_deg))
        self._gravity = np.array([0.0, 0.0, -config.gravity_mps2])
        self._steps = 0
        place(model, data, world.ground, rover, config.start)
        self._settle()
        self._start = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._start_state = self._state

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
            raise PhysicsError(f'command: {velocity_radps} is not valid; valid are four finite'
                               ' velocities [rad/s]')
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
        before = _Motion(self._qpos, self._qvel, self._imu_position)
        wrench, torque = np.zeros((4, 6)), np.zeros(4)
        for _ in range(n_steps):
            mujoco.mj_step(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            wrench += self._leg_wrench
            torque += self._motor
        self._steps += n_steps
        self._check()
        self._state = self._observe(before, wrench / n_steps, torque / n_steps,
                                    n_steps * self.config.step_ns * 1e-9)
        return self._state

    def reset(self) -> RoverState:
        """Go back to the settled start, at time 0."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._start, _STATE)
        self._steps = 0
        self._state = self._start_state
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

    def _observe(self, before: _Motion, wrench: Array, torque: Array,
                 interval_s: float) -> RoverState:
        qpos, qvel = self._qpos, self._qvel
        now = _Motion(qpos, qvel, self._imu_position)
        rate, middle = np.empty(3), before.quat.copy()
        mujoco.mju_subQuat(rate, now.quat, before.quat)
        rate /= interval_s
        mujoco.mju_quatIntegrate(middle, rate, 0.5 * interval_s)
        force = (now.imu_velocity - before.imu_velocity) / interval_s - self._gravity
        force = _rotate_back(self._q_base_imu, _rotate_back(middle, force))
        pull = wrench[:, 3:]
        lever = self._com - self._axles
        contact_torque = wrench[:, :3] + np.stack([
            lever[:, 1] * pull[:, 2] - lever[:, 2] * pull[:, 1],
            lever[:, 2] * pull[:, 0] - lever[:, 0] * pull[:, 2],
            lever[:, 0] * pull[:, 1] - lever[:, 1] * pull[:, 0]], axis=1)
        return RoverState(
            time_ns=self.time_ns,
            position_m=qpos[:3].copy(),
            orientation_wxyz=now.quat,
            linear_velocity_mps=_rotate_back(now.quat, qvel[:3]),
            angular_velocity_radps=qvel[3:6].copy(),
            joint_angle_rad=qpos[7:11].copy(),
            joint_velocity_radps=qvel[6:10].copy(),
            motor_torque_nm=torque,
            motor_current_a=self.rover.motor.current_a(torque),
            contact_force_n=pull.copy(),
            contact_torque_nm=contact_torque,
            specific_force_mps2=force,
            imu_rate_radps=_rotate_back(self._q_base_imu, rate))

    def _check(self) -> None:
        """Raise PhysicsError if the state is no longer that of a rover on the ground."""
        speed = np.abs(self._qvel).max()
        if not speed < MAX_SPEED or self.data.warning[_CONTACTFULL].number:
            raise PhysicsError(self._diagnosis())
        x, y = self._qpos[0], self._qpos[1]
        if max(abs(x), abs(y)) > self._half_extent_m:
            raise PhysicsError(f'at {self.time_ns * 1e-9:.3f} s base_link left the ground at'
                               f' x = {x:.2f} m, y = {y:.2f} m; the ground ends at'
                               f' {self._half_extent_m:.2f} m')

    def _diagnosis(self) -> str:
        values = np.abs(np.nan_to_num(self._qvel, nan=np.inf))
        body = self.model.dof_bodyid[int(np.argmax(values))]
        name = mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_BODY, body)
        warnings = [mujoco.mju_warningText(i, self.data.warning[i].lastinfo)
                    for i in range(mujoco.mjtWarning.mjNWARNING) if self.data.warning[i].number]
        return (f'the simulation diverged at {self.time_ns * 1e-9:.3f} s in body {name} (speed'
                f' {values.max():.3g}); use a shorter step_s or a softer contact'
                + ''.join(f'; {text}' for text in warnings))


class _Motion:
    """Attitude and the velocity of the IMU in world axes, copied from MuJoCo's state."""

    __slots__ = ('quat', 'imu_velocity')

    def __init__(self, qpos: Array, qvel: Array, imu_position: Array) -> None:
        self.quat = qpos[3:7].copy()
        swing, velocity = np.empty(3), np.empty(3)
        mujoco.mju_cross(swing, qvel[3:6], imu_position)
        mujoco.mju_rotVecQuat(velocity, swing, self.quat)
        self.imu_velocity = velocity + qvel[:3]


def _rotate_back(quat: Array, vector: Array) -> Array:
    """Return R(quat)^T vector."""
    inverse, result = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(inverse, quat)
    mujoco.mju_rotVecQuat(result, vector, inverse)
    return result
