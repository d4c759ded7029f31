"""Trajectories of topics of bags, and of files: TUM, EuRoC, KITTI.

- TUM: `stamp x y z qx qy qz qw`, stamps in seconds. For EuRoC input ORB-SLAM3 writes ns there;
  the size of the numbers shows which they are.
- TUM with covariance: 21 more columns, the upper triangle, row by row, of the (6, 6) matrix of
  x, y, z [m] and of the turn about the fixed axes [rad], as geometry_msgs/PoseWithCovariance.
- EuRoC: CSV, `stamp [ns], x, y, z, qw, qx, qy, qz` and more columns, which are not read.
- KITTI: the upper three rows of T_fixed_moving, 12 numbers, no stamps; those come from a file with
  one stamp a line (seconds, or integer ns). Without it they are numbered at 10 Hz.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import dataclasses
from operator import attrgetter
from pathlib import Path
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns, wxyz, xyz
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.series import Rows
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import brief, EvaluationError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_regular
from lunar_rover_sim.base.frames import Array, wxyz_from_matrix
from lunar_rover_sim.base.seconds import from_seconds, in_seconds
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.recorded_run import RecordedRun, rover_frame

# A trajectory, or where it is: FILE, BAG or BAG:TOPIC.
Source = Union[Trajectory, str, Path]

_PATH, _WITH_COVARIANCE = 'nav_msgs/msg/Path', 'geometry_msgs/msg/PoseWithCovarianceStamped'
_POSE = attrgetter('pose.position', 'pose.orientation')
_INNER_POSE = attrgetter('pose.pose.position', 'pose.pose.orientation')
# Position and orientation in a message; in each of the poses of a Path.
POSE_IN: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    'nav_msgs/msg/Odometry': _INNER_POSE, _PATH: _POSE, 'geometry_msgs/msg/PoseStamped': _POSE,
    _WITH_COVARIANCE: _INNER_POSE,
    'geometry_msgs/msg/TransformStamped': attrgetter('transform.translation',
                                                     'transform.rotation')}


def poses_of(msgtype: str, message: Any) -> Iterator[tuple[int, Any, Any]]:
    """Yield stamp [ns], position and orientation of the poses in a message."""
    for stamped in message.poses if msgtype == _PATH else [message]:
        yield header_ns(stamped), *POSE_IN[msgtype](stamped)


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
    if msgtype not in POSE_IN:
        raise EvaluationError(f'{bag.path}: topic {name} is a {msgtype}; valid are '
                              + ', '.join(sorted(POSE_IN)))
    poses = Rows()
    has_covariance = msgtype == _WITH_COVARIANCE
    for _, _, message in bag.messages([name]):
        if msgtype == _PATH:
            poses = Rows()
        covariance = message.pose.covariance if has_covariance else ()
        for ns, position, orientation in poses_of(msgtype, message):
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


# Stamps above this are ns: as seconds they would lie 30,000 years ahead.
_NS_FROM = 1e12
_KITTI_PERIOD_NS = 100_000_000
_MAX_BYTES = 1 << 30
_COLUMNS = 8        # of TUM and EuRoC
_COVARIANCE_COLUMNS = _COLUMNS + 21
_LARGEST = 1e12     # of a coordinate [m]: beyond the planets


def read_tum(path: Path | str) -> Trajectory:
    """Read a TUM file, also with covariances; raise EvaluationError that names file and line."""
    path = Path(path)
    line, words = next(_rows(path, 1, None), (0, []))
    count = len(words)
    if count not in (0, _COLUMNS, _COVARIANCE_COLUMNS):
        raise EvaluationError(f'{path}: line {line} has {count} columns; valid are {_COLUMNS} '
                              f'(TUM), {_COVARIANCE_COLUMNS} (TUM with covariance), 12 (KITTI), '
                              'or a .csv file (EuRoC)')
    rows = list(_rows(path, count, count))
    trajectory = _from_rows(path, rows, (4, 5, 6, 7))
    if count == _COLUMNS:
        return trajectory
    upper = np.array([[_number(path, line, word) for word in words[_COLUMNS:]]
                      for line, words in rows])
    covariances = np.zeros((len(rows), 6, 6))
    i, j = np.triu_indices(6)
    covariances[:, i, j] = covariances[:, j, i] = upper
    return dataclasses.replace(trajectory, covariances=covariances)


def read_euroc(path: Path | str) -> Trajectory:
    """Read an EuRoC `data.csv` of poses; raise EvaluationError that names file and line."""
    path = Path(path)
    return _from_rows(path, list(_rows(path, _COLUMNS, None)), (5, 6, 7, 4), always_ns=True)


def read_kitti(path: Path | str, times: Path | str | None = None) -> Trajectory:
    """Read a KITTI file; `times` holds one stamp a line.

    Raises:
        EvaluationError: If the file cannot be read, with file and line, or the counts differ.
    """
    path = Path(path)
    rows = list(_rows(path, 12, 12))
    if times is None:
        stamps = np.arange(len(rows), dtype=np.int64) * _KITTI_PERIOD_NS
    else:
        words = [words[0] for _, words in _rows(Path(times), 1, None)]
        if len(words) != len(rows):
            raise EvaluationError(f'{path}: {len(rows)} poses, but {len(words)} stamps in {times}')
        stamps = np.array(_stamps(Path(times), words), dtype=np.int64)
    values = np.array([[_number(path, line, word) for word in words] for line, words in rows])
    matrices = values.reshape(-1, 3, 4)
    if len(matrices):
        rotations = matrices[:, :, :3]
        skew = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3))
        bad = ~(skew.max(axis=(1, 2)) < 1e-3) | ~(np.linalg.det(rotations) > 0.0)
        if bad.any():
            raise EvaluationError(f'{path}: line {rows[int(np.argmax(bad))][0]}: the first three '
                                  'columns are no rotation')
    quats = np.array([wxyz_from_matrix(m[:, :3]) for m in matrices]).reshape(-1, 4)
    return Trajectory(stamps, matrices[:, :, 3].reshape(-1, 3), quats, str(path))


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write a TUM file, stamps exact to the ns; raise EvaluationError if that fails."""
    _write_rows(path, trajectory, np.zeros((len(trajectory), 0)))


def write_tum_covariance(path: Path | str, trajectory: Trajectory) -> None:
    """Write a TUM file with covariances; raise EvaluationError if that fails or there are none."""
    if trajectory.covariances is None:
        raise EvaluationError(f'{trajectory.name}: has no covariances')
    i, j = np.triu_indices(6)
    _write_rows(path, trajectory, trajectory.covariances[:, i, j])


def _write_rows(path: Path | str, trajectory: Trajectory, more: Array) -> None:
    q = trajectory.orientations_wxyz
    rows = np.hstack([trajectory.positions_m, q[:, 1:], q[:, :1], more])
    lines = (f'{in_seconds(ns)} {" ".join(map(repr, row))}\n'
             for ns, row in zip(trajectory.stamps_ns.tolist(), rows.tolist()))
    atomic_write(path, ''.join(lines), EvaluationError)


def read_trajectory(path: Path | str, times: Path | str | None = None) -> Trajectory:
    """Read a trajectory file of any format; its suffix and its first line show which."""
    path = Path(path)
    if is_kitti(path):
        return read_kitti(path, times)
    return read_euroc(path) if path.suffix.lower() == '.csv' else read_tum(path)


def is_kitti(path: Path) -> bool:
    """Return whether a file has the rows of KITTI, which have no stamps."""
    first = next(_rows(path, 1, None), (0, []))
    return len(first[1]) == 12 and path.suffix.lower() != '.csv'


def _rows(path: Path, least: int, most: int | None) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of all lines that are not empty or comments."""
    try:
        check_regular(path, EvaluationError)
        if path.stat().st_size > _MAX_BYTES:
            raise EvaluationError(f'{path}: larger than {_MAX_BYTES >> 20} MiB; not a trajectory')
        text = path.read_text(encoding='utf-8')
    except OSError as error:
        raise EvaluationError(f'{path}: cannot be read: {error.strerror}') from None
    except UnicodeDecodeError:
        raise EvaluationError(f'{path}: is not a text file') from None
    for number, line in enumerate(text.splitlines(), 1):
        line = line.partition('#')[0].strip()
        if not line:
            continue
        words = line.replace(',', ' ').split()
        if len(words) < least or (most is not None and len(words) > most):
            valid = f'{least}' if most == least else f'at least {least}'
            raise EvaluationError(f'{path}: line {number} has {len(words)} columns; valid is '
                                  f'{valid}')
        yield number, words


def _from_rows(path: Path, rows: Sequence[tuple[int, list[str]]], xyzw: tuple[int, ...],
               always_ns: bool = False) -> Trajectory:
    """Return the trajectory of rows `stamp x y z` + quaternion at the columns `xyzw`."""
    if not rows:
        raise EvaluationError(f'{path}: holds no poses')
    stamps = _stamps(path, [words[0] for _, words in rows], always_ns)
    columns = (1, 2, 3, xyzw[3], *xyzw[:3])
    values = np.array([[_number(path, line, words[c]) for c in columns] for line, words in rows])
    _check_order(path, stamps, [line for line, _ in rows])
    return Trajectory(np.array(stamps, dtype=np.int64), values[:, :3], values[:, 3:], str(path))


def _check_order(path: Path, stamps: Sequence[int], lines: Sequence[int]) -> None:
    for k in range(1, len(stamps)):
        if stamps[k] <= stamps[k - 1]:
            raise EvaluationError(f'{path}: line {lines[k]}: stamp {stamps[k]} ns does not follow '
                                  f'{stamps[k - 1]} ns; stamps must increase')


def _stamps(path: Path, words: Sequence[str], always_ns: bool = False) -> list[int]:
    """Return ns; decimals are read as text, so that seconds keep their ns."""
    try:
        largest = max((abs(_float(word)) for word in words), default=0.0)
        ns = always_ns or largest > _NS_FROM
        to_ns: Callable[[str], int] = _integer if ns else from_seconds
        stamps = [to_ns(word) for word in words]
    except (ValueError, OverflowError):
        raise EvaluationError(f'{path}: a stamp is not a finite number') from None
    for stamp in stamps:
        if abs(stamp) >= 1 << 63:
            raise EvaluationError(f'{path}: stamp {brief(stamp)} ns is not valid; valid are 64 '
                                  'bits')
    return stamps


def _integer(word: str) -> int:
    return int(word) if word.lstrip('+-').isdigit() else round(float(word))


def _float(word: str) -> float:
    if '_' in word or not word.isascii():   # Python reads 1_0 as 10, and digits of all scripts
        raise ValueError(word)
    return float(word)


def _number(path: Path, line: int, word: str) -> float:
    try:
        value = _float(word)
    except ValueError:
        raise EvaluationError(f'{path}: line {line}: {word!r} is not a number') from None
    if not abs(value) <= _LARGEST:
        raise EvaluationError(f'{path}: line {line}: {word} is not valid; valid is finite and '
                              f'up to {_LARGEST:g}')
    return value
