"""The state of the rover after a physics step, and whether it has tipped over."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3, tilt_deg


@dataclasses.dataclass(frozen=True)
class RoverState:
    """Pose, motion and forces at one stamp.

    Kinematic values hold at the stamp. Forces, torques, currents and the IMU signals are means
    over the interval from the previous state to the stamp: their sums over time are exact
    impulses, and contact spikes do not alias.

    Attributes:
        stamp_ns: Simulated time since the start [ns].
        position_m: (3,) origin of base_link, world frame.
        orientation_wxyz: (4,) base_link in the world frame.
        linear_velocity_mps: (3,) of the origin of base_link, base axes.
        angular_velocity_radps: (3,) base axes.
        joint_angle_rad: (legs,) unwrapped, order of the rover's legs.
        joint_velocity_radps: (legs,).
        motor_torque_nm: (legs,) electromagnetic torque at the leg, before friction of the gear.
        motor_current_a: (legs,) winding current.
        contact_force_n: (legs, 3) ground reaction on each leg, world axes.
        contact_torque_nm: (legs, 3) its torque about the axle, world axes.
        specific_force_mps2: (3,) at the IMU, IMU axes; +g upwards at rest.
        imu_rate_radps: (3,) IMU axes.
    """

    stamp_ns: int
    position_m: Array
    orientation_wxyz: Array
    linear_velocity_mps: Array
    angular_velocity_radps: Array
    joint_angle_rad: Array
    joint_velocity_radps: Array
    motor_torque_nm: Array
    motor_current_a: Array
    contact_force_n: Array
    contact_torque_nm: Array
    specific_force_mps2: Array
    imu_rate_radps: Array

    @property
    def T_world_base(self) -> Array:
        """The pose of base_link in the world frame, (4, 4)."""
        return se3(matrix_from_wxyz(self.orientation_wxyz), self.position_m)


# A rover on its side on a slope of 20 deg is tilted by 70 deg; no slope on which it walks is that
# steep. It counts as upright again below 45 deg: one that rocks on its side has tipped over once.
TIPPED_DEG, _UPRIGHT_DEG = 70.0, 45.0


class TipOver:
    """Notices when the base tilts so far that the rover does not come back by itself.

    Attributes:
        tilt_deg: Angle between the z axes of base and world at the newest pose [deg].
        lies: Whether the rover has tipped over and not come back.
    """

    def __init__(self) -> None:
        self.tilt_deg = 0.0
        self.lies = False

    def has_begun(self, orientation_wxyz: Array) -> bool:
        """Return whether the rover tips over with this pose, base in the world frame, (4,)."""
        self.tilt_deg = float(tilt_deg(orientation_wxyz))
        lay = self.lies
        self.lies = self.tilt_deg > (_UPRIGHT_DEG if lay else TIPPED_DEG)
        return self.lies and not lay
