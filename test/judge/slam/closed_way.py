"""A drive around a circle over a textured plane, with all that the graph takes, and as a bag."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.frames import se3
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.slam.euroc_reader import Camera
from lunar_rover_sim.judge.slam.graph.measured import Aids, Inertial, Stars, Sun, Wheels

WIDTH, HEIGHT, FOCAL_PX, BASELINE_M = 320, 240, 230.0, synthetic.MOUNT.baseline_m
CAMERA = Camera((FOCAL_PX, FOCAL_PX), ((WIDTH - 1) / 2, (HEIGHT - 1) / 2), BASELINE_M)
T_BASE_LEFT = synthetic.T_base_camera(+1.0)
PERIOD_NS, IMU_NS = 1_000_000_000, 100_000_000
STEP_M, RADIUS_M = 0.1, 1.0
SUN = frames.sun_direction(30.0, 10.0)
# Of the wheels for each root of a metre: along, across, of the heading.
ROLLING = 0.03, 0.02, 0.1
_CELLS, _CELL_M = 1024, 0.01


@dataclasses.dataclass
class Step:
    """What comes at one stamp; T_world_base is the truth."""

    stamp_ns: int
    left: np.ndarray | None
    right: np.ndarray | None
    aids: Aids
    T_world_base: np.ndarray

    @property
    def given(self) -> tuple:
        """What the graph is given."""
        return self.stamp_ns, self.left, self.right, self.aids


def _texture() -> np.ndarray:
    rng = np.random.default_rng(0)
    total = sum(weight * cv2.GaussianBlur(rng.standard_normal((_CELLS, _CELLS)), (0, 0), sigma)
                for sigma, weight in ((1.0, 1.0), (3.0, 3.0), (9.0, 13.0)))
    return np.clip(120.0 + 70.0 * total, 0, 255).astype(np.uint8)


_TEXTURE = _texture()


def view(T_world_camera: np.ndarray) -> np.ndarray:
    """Return the (h, w) image of the plane z = 0."""
    (fx, fy), (cx, cy) = CAMERA.focal_px, CAMERA.centre_px
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones((HEIGHT, WIDTH))], axis=-1)
    rays = rays @ T_world_camera[:3, :3].T
    origin = T_world_camera[:3, 3]
    down = np.minimum(rays[..., 2], -1e-6)
    xy = origin[:2] - origin[2] / down[..., None] * rays[..., :2]
    cell = np.clip(xy / _CELL_M + _CELLS / 2, -30000, 30000).astype(np.float32)
    image = cv2.remap(_TEXTURE, cell[..., 0], cell[..., 1], cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REFLECT)
    image[rays[..., 2] > -0.05] = 0
    return image


def pose_at(way_m: float) -> np.ndarray:
    """Return T_world_base on the circle, nodding as it walks."""
    angle = way_m / RADIUS_M
    nod = Rotation.from_euler('YX', [2.0 * np.sin(17.0 * way_m), 1.5 * np.sin(11.0 * way_m)],
                              degrees=True)
    R = Rotation.from_euler('Z', angle + np.pi / 2) * nod
    return se3(R.as_matrix(), [RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), 0.15])


def drive(laps: float = 1.15, seed: int = 0, heading: bool = False) -> list[Step]:
    """Return a step a second, at 0.1 m a second; the rover stands for the first one.

    heading: whether there are a sun sensor and a star tracker.
    """
    rng = np.random.default_rng(seed)
    count = round(laps * 2.0 * np.pi * RADIUS_M / STEP_M)
    rolled, covariance = np.zeros(3), np.zeros((3, 3))
    steps, before_s, before = [], 0.0, pose_at(0.0)[:3, :3]
    for k in range(1, count + 1):
        imu_ns = np.arange((k - 1) * PERIOD_NS + IMU_NS, k * PERIOD_NS + 1, IMU_NS)
        rates, forces = [], []
        for ns in imu_ns:
            now, now_s = pose_at(_way_m(ns * 1e-9))[:3, :3], ns * 1e-9
            turn = Rotation.from_matrix(before.T @ now).as_rotvec()
            rates.append(turn / (now_s - before_s) + 5e-4 * rng.standard_normal(3))
            forces.append(now.T @ [0.0, 0.0, synthetic.GRAVITY] + 0.02 * rng.standard_normal(3))
            before_s, before = now_s, now
        T = pose_at(_way_m(k * 1.0))
        if k > 1:
            rolled, covariance = _roll(rolled, covariance, rng)
        sun = stars = None
        if heading:
            sun = Sun(k * PERIOD_NS, T[:3, :3].T @ SUN + 1e-3 * rng.standard_normal(3), SUN)
            error = Rotation.from_rotvec(2e-4 * rng.standard_normal(3)).as_matrix()
            if k % 5 == 0:
                stars = Stars(k * PERIOD_NS, T[:3, :3] @ error, 4e-8 * np.eye(3))
        noise = [2.0 * rng.standard_normal((HEIGHT, WIDTH)) for _ in range(2)]
        left, right = (np.clip(view(T @ synthetic.T_base_camera(side)) + n, 0, 255)
                       .astype(np.uint8) for side, n in zip((+1.0, -1.0), noise))
        steps.append(Step(k * PERIOD_NS, left, right, Aids(
            Inertial(imu_ns, np.array(rates), np.array(forces)),
            Wheels(rolled.copy(), covariance.copy()), sun, stars), T))
    return steps


def _way_m(time_s: float) -> float:
    return STEP_M * max(0.0, time_s - 1.0)


def _roll(pose: np.ndarray, P: np.ndarray, rng) -> tuple[np.ndarray, np.ndarray]:
    """Return pose and covariance after a step whose errors are those of ROLLING."""
    sigma = np.array(ROLLING) * np.sqrt(STEP_M)
    ahead, aside, turn = np.array([STEP_M, 0.0, STEP_M / RADIUS_M]) \
        + sigma * rng.standard_normal(3)
    middle = pose[2] + 0.5 * turn
    c, s = np.cos(middle), np.sin(middle)
    F = np.array([[1.0, 0.0, -s * ahead], [0.0, 1.0, c * ahead], [0.0, 0.0, 1.0]])
    G = np.array([[c, -s, -0.5 * s * ahead], [s, c, 0.5 * c * ahead], [0.0, 0.0, 1.0]])
    return (pose + [c * ahead - s * aside, s * ahead + c * aside, turn],
            F @ P @ F.T + G @ np.diag(sigma**2) @ G.T)


def truth(steps: list[Step]) -> Trajectory:
    """Return the true poses of the left camera."""
    T = np.array([step.T_world_base @ T_BASE_LEFT for step in steps])
    return Trajectory(np.array([step.stamp_ns for step in steps]), T[:, :3, 3],
                      wxyz(Rotation.from_matrix(T[:, :3, :3])), 'truth')


def write(path: Path, steps: list[Step]) -> Path:
    """Write a drive as a bag."""
    latched = {topics.TF_STATIC.name, topics.SCENARIO.name, topics.SUN.name}
    items = [item for item in synthetic.latched_items() if item.topic in latched]
    for step in steps:
        imu = step.aids.inertial
        for ns, rate, force in zip(imu.stamps_ns.tolist(), imu.rates_radps, imu.forces_mps2):
            items.append(synthetic.item(topics.IMU_RAW, synthetic.imu(ns, rate, force)))
        ns = step.stamp_ns
        items.append(synthetic.item(topics.ODOM, synthetic.odometry(
            ns, frames.ODOM_FRAME, step.T_world_base)))
        items += [synthetic.item(topics.WHEEL_ODOM, _wheels(ns, step.aids.wheels))]
        if step.aids.sun is not None:
            items.append(synthetic.item(topics.SUN_SENSOR, synthetic.msg(
                'geometry_msgs/Vector3Stamped', header=synthetic.header(ns, frames.BASE_FRAME),
                vector=synthetic.vector(step.aids.sun.in_base))))
        for topic, info, image, baseline in (
                (topics.LEFT_IMAGE, topics.LEFT_INFO, step.left, 0.0),
                (topics.RIGHT_IMAGE, topics.RIGHT_INFO, step.right, BASELINE_M)):
            items.append(synthetic.item(info, _camera_info(ns, baseline)))
            if image is not None:
                items.append(synthetic.picture(topic, ns, 'mono8', image))
    return synthetic.write(path, items)


def _wheels(ns: int, wheels: Wheels):
    x, y, yaw = wheels.pose
    T = se3(Rotation.from_euler('Z', yaw).as_matrix(), [x, y, 0.0])
    message = synthetic.odometry(ns, frames.WHEEL_ODOM_FRAME, T)
    covariance = 1e6 * np.eye(6)
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = wheels.covariance
    message.pose.covariance = covariance.ravel()
    return message


def _camera_info(ns: int, baseline_m: float):
    message = synthetic.camera_info(ns, frames.LEFT_OPTICAL_FRAME, baseline_m)
    (fx, fy), (cx, cy) = CAMERA.focal_px, CAMERA.centre_px
    message.k = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
    message.p = np.array([fx, 0, cx, -fx * baseline_m, 0, fy, cy, 0, 0, 0, 1.0, 0])
    message.width, message.height = WIDTH, HEIGHT
    return message
