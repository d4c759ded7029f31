"""Between core classes and ROS 2 messages: the only place where wxyz becomes xyzw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import AccelStamped, TransformStamped, WrenchStamped
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, Imu, JointState
from stereo_msgs.msg import DisparityImage

from lunar_rover_sim import frames
from lunar_rover_sim.errors import GraphError
from lunar_rover_sim.rover.description import JOINT_NAMES

if TYPE_CHECKING:
    from lunar_rover_sim.camera.rig import StereoRig
    from lunar_rover_sim.physics.imu import ImuSample
    from lunar_rover_sim.physics.state import RoverState
    from lunar_rover_sim.stereo.sgm import DisparityMap

NS = 1_000_000_000


def time_msg(stamp_ns: int) -> Time:
    """Return integer ns as a message."""
    return Time(sec=stamp_ns // NS, nanosec=stamp_ns % NS)


def time_ns(stamp: Time) -> int:
    """Return a stamp as integer ns."""
    return stamp.sec * NS + stamp.nanosec


def odometry(state: RoverState, stamp: Time) -> Odometry:
    """Return true pose in `odom` and true twist in `base_link`; covariances are zero: exact."""
    msg = Odometry()
    msg.header.stamp = stamp
    msg.header.frame_id = frames.ODOM_FRAME
    msg.child_frame_id = frames.BASE_FRAME
    _vector(msg.pose.pose.position, state.position_m)
    _quaternion(msg.pose.pose.orientation, state.orientation_wxyz)
    _vector(msg.twist.twist.linear, state.linear_velocity_mps)
    _vector(msg.twist.twist.angular, state.angular_velocity_radps)
    return msg


def pose_of(msg: Odometry) -> NDArray[np.float64]:
    """Return T_world_base (4, 4) of an odometry message; raise GraphError if it is not a pose."""
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    position, quat = np.array([p.x, p.y, p.z]), np.array([q.w, q.x, q.y, q.z])
    norm = float(np.linalg.norm(quat))
    if not np.all(np.isfinite(position)) or not abs(norm - 1.0) < 1e-3:
        raise GraphError(f'odom: position {position.tolist()}, orientation wxyz {quat.tolist()} '
                         'is not a pose; valid is finite with a unit quaternion')
    return frames.se3(frames.matrix_from_wxyz(quat / norm), position)


def joint_state(stamp: Time, position: Sequence[float] | NDArray[np.float64],
                velocity: Sequence[float] | NDArray[np.float64],
                effort: Sequence[float] | NDArray[np.float64] = ()) -> JointState:
    """Return the four legs' angles [rad], velocities [rad/s] and torques [N m]."""
    msg = JointState()
    msg.header.stamp = stamp
    msg.name = list(JOINT_NAMES)
    msg.position = np.asarray(position, float).tolist()
    msg.velocity = np.asarray(velocity, float).tolist()
    msg.effort = np.asarray(effort, float).tolist()
    return msg


def legs_of(msg: JointState, field: str) -> NDArray[np.float64]:
    """Return (4,) values of `field` (position, velocity) in the order of the legs.

    Joints may come in any order and among others; raise GraphError if one is missing.
    """
    values = getattr(msg, field)
    names = list(msg.name)
    try:
        return np.array([values[names.index(joint)] for joint in JOINT_NAMES], dtype=float)
    except (ValueError, IndexError):
        raise GraphError(f'{field} of joints {names} in a JointState message is not complete; '
                         f'valid is one value each for {", ".join(JOINT_NAMES)}') from None


def imu_raw(sample: ImuSample, accel_variance: float, gyro_variance: float, stamp: Time) -> Imu:
    """Return the noisy signal: no orientation (REP-145), white-noise variances per sample."""
    msg = Imu()
    msg.header.stamp = stamp
    msg.header.frame_id = frames.IMU_FRAME
    _vector(msg.linear_acceleration, sample.specific_force)
    _vector(msg.angular_velocity, sample.rate)
    msg.orientation_covariance[0] = -1.0
    for k in (0, 4, 8):
        msg.linear_acceleration_covariance[k] = accel_variance
        msg.angular_velocity_covariance[k] = gyro_variance
    return msg


def imu_truth(state: RoverState, R_base_imu: NDArray[np.float64], stamp: Time) -> Imu:
    """Return the noise-free signal with the true orientation of the IMU in `odom`."""
    msg = Imu()
    msg.header.stamp = stamp
    msg.header.frame_id = frames.IMU_FRAME
    _vector(msg.linear_acceleration, state.specific_force_mps2)
    _vector(msg.angular_velocity, state.imu_rate_radps)
    rotation = frames.matrix_from_wxyz(state.orientation_wxyz) @ R_base_imu
    _quaternion(msg.orientation, frames.wxyz_from_matrix(rotation))
    return msg


def imu_bias(sample: ImuSample, stamp: Time) -> AccelStamped:
    """Return the true bias: accelerometer in `linear`, gyroscope in `angular`."""
    msg = AccelStamped()
    msg.header.stamp = stamp
    msg.header.frame_id = frames.IMU_FRAME
    _vector(msg.accel.linear, sample.accel_bias)
    _vector(msg.accel.angular, sample.gyro_bias)
    return msg


def wrench(force_n: NDArray[np.float64], torque_nm: NDArray[np.float64],
           stamp: Time) -> WrenchStamped:
    """Return the ground reaction on one leg, world axes."""
    msg = WrenchStamped()
    msg.header.stamp = stamp
    msg.header.frame_id = frames.ODOM_FRAME
    _vector(msg.wrench.force, force_n)
    _vector(msg.wrench.torque, torque_nm)
    return msg


def transform(parent: str, child: str, T_parent_child: NDArray[np.float64],
              stamp: Time) -> TransformStamped:
    """Return a (4, 4) transform as a message."""
    msg = TransformStamped()
    msg.header.stamp = stamp
    msg.header.frame_id = parent
    msg.child_frame_id = child
    _vector(msg.transform.translation, T_parent_child[:3, 3])
    _quaternion(msg.transform.rotation, frames.wxyz_from_matrix(T_parent_child[:3, :3]))
    return msg


def camera_info(rig: StereoRig, frame_id: str, projection: NDArray[np.float64],
                stamp: Time) -> CameraInfo:
    """Return intrinsics, distortion and projection of one camera (REP-104)."""
    msg = CameraInfo()
    msg.header.stamp = stamp
    msg.header.frame_id = frame_id
    msg.width, msg.height = rig.width, rig.height
    msg.distortion_model = 'plumb_bob'
    msg.d = [float(d) for d in rig.D]
    msg.k = rig.K.ravel().tolist()
    msg.r = rig.R.ravel().tolist()
    msg.p = projection.ravel().tolist()
    return msg


_ENCODINGS = {('uint8', 2): 'mono8', ('uint16', 2): 'mono16', ('uint8', 3): 'rgb8',
              ('float32', 2): '32FC1'}


def image(pixels: NDArray, frame_id: str, stamp: Time) -> Image:
    """Return (h, w) uint8, uint16, float32 or (h, w, 3) uint8 pixels as a message."""
    msg = Image()
    msg.header.stamp = stamp
    msg.header.frame_id = frame_id
    msg.height, msg.width = pixels.shape[:2]
    msg.encoding = _ENCODINGS[str(pixels.dtype), pixels.ndim]
    msg.step = pixels.strides[0] if pixels.flags.c_contiguous else pixels[0].nbytes
    msg.data = pixels.tobytes()
    return msg


def disparity_image(disparity: DisparityMap, focal_px: float, baseline_m: float, frame_id: str,
                    stamp: Time) -> DisparityImage:
    """Return a disparity map with what a reader needs to turn it into depth: Z = f T / d."""
    msg = DisparityImage()
    msg.header.stamp = stamp
    msg.header.frame_id = frame_id
    msg.image = image(disparity.disparity_px, frame_id, stamp)
    msg.f, msg.t = float(focal_px), float(baseline_m)
    msg.min_disparity = float(disparity.min_disparity_px)
    msg.max_disparity = float(disparity.max_disparity_px)
    msg.delta_d = float(disparity.delta_d_px)
    x, y, width, height = disparity.valid_window
    msg.valid_window.x_offset, msg.valid_window.y_offset = int(x), int(y)
    msg.valid_window.width, msg.valid_window.height = int(width), int(height)
    return msg


def _vector(msg: object, xyz: NDArray[np.float64]) -> None:
    msg.x, msg.y, msg.z = float(xyz[0]), float(xyz[1]), float(xyz[2])  # type: ignore[attr-defined]


def _quaternion(msg: object, wxyz: NDArray[np.float64]) -> None:
    msg.w = float(wxyz[0])  # type: ignore[attr-defined]
    _vector(msg, wxyz[1:])
