"""Loading trajectories from files and from topics of bags."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import Rows
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_files import is_kitti, read_trajectory
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.recorded_run import RecordedRun, rover_frame

# A trajectory, or where it is: FILE, BAG or BAG:TOPIC.
Source = Union[Trajectory, str, Path]

_Pose = tuple[int, Any, Any]


def _stamped_poses(message: Any) -> Iterator[_Pose]:
    for stamped in message.poses:
        yield header_ns(stamped), stamped.pose.position, stamped.pose.orientation


def _one_pose(path: str) -> Callable[[Any], Iterator[_Pose]]:
    def poses(message: Any) -> Iterator[_Pose]:
        pose = message
        for name in path.split('.'):
            pose = getattr(pose, name)
        yield header_ns(message), pose.position, pose.orientation
    return poses


def _transform(message: Any) -> Iterator[_Pose]:
    yield header_ns(message), message.transform.translation, message.transform.rotation


POSES_OF: dict[str, Callable[[Any], Iterator[_Pose]]] = {
    'nav_msgs/msg/Odometry': _one_pose('pose.pose'),
    'nav_msgs/msg/Path': _stamped_poses,
    'geometry_msgs/msg/PoseStamped': _one_pose('pose'),
    'geometry_msgs/msg/PoseWithCovarianceStamped': _one_pose('pose.pose'),
    'geometry_msgs/msg/TransformStamped': _transform,
}


def trajectory_of_topic(bag: Bag, topic: str = '') -> Trajectory:
    """Return the poses of a topic, by default the true ones.

    Of a Path the last message counts, since it holds all. Covariances are those of a
    PoseWithCovarianceStamped, unless all are 0.

    Raises:
        BagError: If there is no such topic.
        EvaluationError: If its type has no pose.
    """
    name = bag.resolve(topic or bag.truth)
    msgtype = bag.types[name]
    if msgtype not in POSES_OF:
        raise EvaluationError(f'{bag.path}: topic {name} is a {msgtype}; valid are '
                              + ', '.join(sorted(POSES_OF)))
    poses = Rows()
    has_covariance = msgtype == 'geometry_msgs/msg/PoseWithCovarianceStamped'
    for _, _, message in bag.messages([name]):
        if msgtype == 'nav_msgs/msg/Path':
            poses = Rows()
        covariance = message.pose.covariance if has_covariance else ()
        for ns, position, orientation in POSES_OF[msgtype](message):
            poses.add(ns, (*xyz(position), *wxyz(orientation), *covariance))
    if not len(poses):
        raise EvaluationError(f'{bag.path}: topic {name} holds no poses')
    stamps_ns, rows = poses.arrays()
    covariances = rows[:, 7:].reshape(-1, 6, 6) if has_covariance and rows[:, 7:].any() else None
    return Trajectory(stamps_ns, rows[:, :3], rows[:, 3:7], f'{bag.path}:{name}', covariances)


def is_bag(path: Path) -> bool:
    """Return whether a path is a bag rather than a trajectory file."""
    return path.is_dir() or path.suffix in ('.mcap', '.db3')


def load(source: Source, times: str | Path | None = None) -> Trajectory:
    """Return a Trajectory as it is, or load `FILE`, `BAG` or `BAG:TOPIC`.

    Args:
        times: File with the stamps of a KITTI file.

    Raises:
        EvaluationError: If the file cannot be read, with the reason.
        BagError: If the bag cannot be read.
    """
    if isinstance(source, Trajectory):
        return source
    path, topic = _existing(source)
    if not is_bag(path):
        return read_trajectory(path, times)
    with open_bag(path) as bag:
        return trajectory_of_topic(bag, topic)


def is_unstamped(source: Source) -> bool:
    """Return whether a source is a file without stamps; EvaluationError if there is none."""
    if isinstance(source, Trajectory):
        return False
    path, _ = _existing(source)
    return not is_bag(path) and is_kitti(path)


def _existing(source: str | Path) -> tuple[Path, str]:
    path, topic = split(source)
    if not path.exists():
        raise EvaluationError(f'{path}: there is no such file or bag')
    return path, topic


def split(source: str | Path) -> tuple[Path, str]:
    """Return path and topic of `PATH` or `PATH:TOPIC`; '' for no topic."""
    text = str(source)
    path, colon, topic = text.rpartition(':')
    if colon and path and not Path(text).exists():
        return Path(path), topic
    return Path(text), ''


def bag_of(source: Source) -> Path | None:
    """Return the bag that a source names; None for a file or a Trajectory."""
    if isinstance(source, Trajectory):
        return None
    path, _ = split(source)
    return path if path.exists() and is_bag(path) else None


def frame_on_rover(source: Source, frame: str) -> Array:
    """Return T_base_frame (4, 4): of the recorded rover if `source` is a bag, else the packaged.

    Args:
        frame: One of base, imu, left, right (the cameras), lidar.

    Raises:
        ConfigError: If it is none of them.
        BagError: If the bag does not say where the frame is.
    """
    path = bag_of(source)
    if path is not None:
        with open_bag(path) as bag:
            return RecordedRun(bag).frame(frame)
    return rover_frame(load_rover(None), frame)


def image_stamps_ns(source: Source) -> NDArray[np.int64] | None:
    """Return the stamps [ns] of the left images of a bag, of which a tracker gets each one.

    Without images they are those of the camera's CameraInfo, one of which is published with each.
    None for a file, and for a bag with neither.
    """
    path = bag_of(source)
    if path is None:
        return None
    with open_bag(path) as bag:
        for topic in topics.OF_PAIRS:
            if bag.has(topic.name):
                return np.array([m.time_ns for m in bag.raw([topic.name])], dtype=np.int64)
    return None
