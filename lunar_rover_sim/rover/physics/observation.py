"""Observations of the rover: pose and motion, motors, and the signals of its IMU."""

from __future__ import annotations

import mujoco
import numpy as np

from lunar_rover_sim.base.errors import PhysicsError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rotated, wxyz_from_rpy
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mjcf import BASE_BODY
from lunar_rover_sim.rover.physics.state import RoverState

_NEXT, _LAST = [1, 2, 0], [2, 0, 1]     # axes: a x b is a[next] b[last] - a[last] b[next]


class Observer:
    """Reads states from MuJoCo's data; the IMU measures the motion since the state before.

    Attributes:
        leg_wrench: (legs, 6) of the present step, torque and force on each leg in world axes,
            about the centre of mass of the rover.
        motor_torque: (legs,) of the present step.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rover: RoverDescription,
                 gravity_mps2: float) -> None:
        legs = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, leg)
                for leg in rover.legs.names]
        count = len(legs)
        if legs != list(range(legs[0], legs[0] + count)):
            raise PhysicsError('the bodies of the legs do not follow each other in the model')
        base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_BODY)
        self.leg_wrench: Array = data.cfrc_ext[legs[0]:legs[0] + count]
        self.motor_torque: Array = data.qfrc_actuator[6:6 + count]
        self._qpos, self._qvel = data.qpos[:7], data.qvel[:6]
        self._angle, self._speed = data.qpos[7:7 + count], data.qvel[6:6 + count]
        self._com = data.subtree_com[base]
        self._axles = data.xpos[legs[0]:legs[0] + count]
        self._torque_per_ampere = rover.motor.gear_ratio * rover.motor.motor_constant
        self._imu_position = np.array(rover.imu.position_m)
        self._R_base_imu = matrix_from_wxyz(
            wxyz_from_rpy(*np.radians(rover.imu.rpy_deg))).ravel()
        self._gravity = np.array([0.0, 0.0, -gravity_mps2])
        self._last_quat = self._qpos[3:7].copy()
        self._last_imu_velocity = np.zeros(3)

    @property
    def motion(self) -> tuple[Array, Array]:
        """Attitude wxyz (4,) and velocity of the IMU (3,) [m/s], world, of the state before."""
        return self._last_quat, self._last_imu_velocity

    @motion.setter
    def motion(self, motion: tuple[Array, Array]) -> None:
        self._last_quat, self._last_imu_velocity = motion

    def after_jump(self) -> None:
        """Take the present motion as that of the state before, so that the IMU feels no jump."""
        quat = self._qpos[3:7].copy()
        swing = np.cross(self._qvel[3:6], self._imu_position)
        self.motion = quat, rotated(matrix_from_wxyz(quat), swing) + self._qvel[:3]

    def observe(self, stamp_ns: int, interval_s: float, wrench: Array,
                torque: Array) -> RoverState:
        """Return the state now, with the IMU signals of the motion since the previous state.

        The rate is the constant rate that turns the previous attitude into the present one. The
        specific force is the mean acceleration of the IMU minus gravity, in the axes halfway
        between both attitudes.

        Args:
            stamp_ns: Of the state [ns].
            interval_s: Time since the previous state [s].
            wrench: (legs, 6) mean of `leg_wrench` over it.
            torque: (legs,) mean of `motor_torque` over it [N m].
        """
        # MuJoCo's functions round alike on every processor, as products by BLAS do not.
        qpos, qvel = self._qpos, self._qvel
        quat, rate, middle = qpos[3:7].copy(), np.empty(3), self._last_quat.copy()
        swing, R_world_base, R_world_middle = np.empty(3), np.empty(9), np.empty(9)
        imu_velocity, linear, force_middle, force_imu, rate_imu = np.empty((5, 3))
        mujoco.mju_subQuat(rate, quat, middle)
        rate /= interval_s
        mujoco.mju_quatIntegrate(middle, rate, 0.5 * interval_s)
        mujoco.mju_quat2Mat(R_world_base, quat)
        mujoco.mju_quat2Mat(R_world_middle, middle)
        mujoco.mju_cross(swing, qvel[3:6], self._imu_position)
        mujoco.mju_mulMatVec3(imu_velocity, R_world_base, swing)
        imu_velocity += qvel[:3]
        force = imu_velocity - self._last_imu_velocity
        force /= interval_s
        force -= self._gravity
        self.motion = quat, imu_velocity
        mujoco.mju_mulMatTVec3(linear, R_world_base, qvel[:3])
        mujoco.mju_mulMatTVec3(force_middle, R_world_middle, force)
        mujoco.mju_mulMatTVec3(force_imu, self._R_base_imu, force_middle)
        mujoco.mju_mulMatTVec3(rate_imu, self._R_base_imu, rate)
        pull, lever = wrench[:, 3:].copy(), self._com - self._axles
        turn = lever[:, _NEXT] * pull[:, _LAST] - lever[:, _LAST] * pull[:, _NEXT]
        turn += wrench[:, :3]
        return RoverState(
            stamp_ns=stamp_ns,
            position_m=qpos[:3].copy(),
            orientation_wxyz=quat,
            linear_velocity_mps=linear,
            angular_velocity_radps=qvel[3:6].copy(),
            joint_angle_rad=self._angle.copy(),
            joint_velocity_radps=self._speed.copy(),
            motor_torque_nm=torque,
            motor_current_a=torque / self._torque_per_ampere,
            contact_force_n=pull,
            contact_torque_nm=turn,
            specific_force_mps2=force_imu,
            imu_rate_radps=rate_imu)
