"""Estimators: wheels, the reference odometry, the graph, ORB-SLAM3 or another program.

Wheels and graph read a bag themselves (`run_on_bag`), the others an exported sequence.

ORB-SLAM3 (Campos et al., IEEE T-RO 37 (6), 2021) is the user's own stock build, run on an exported
sequence. It writes stamps in ns or in seconds, and poses relative to the first keyframe: of the
left camera, or of the IMU if it uses one.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from pathlib import Path
import re
import shlex
import time

import numpy as np

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_regular, program_path
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.base.seconds import from_seconds
from lunar_rover_sim.judge.evaluation.trajectory import Stamps, Trajectory
from lunar_rover_sim.judge.slam import euroc_reader
from lunar_rover_sim.judge.slam.program import WHEEL_PROGRAM
from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry
from lunar_rover_sim.products.sequences.euroc import TIMES_FILE, TIMES_IMU_FILE
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS, settings
from lunar_rover_sim.products.sequences.sensors import SensorSuite
from lunar_rover_sim.run.child_process import Echo, executable, run_program

SYSTEMS = ('reference', 'graph', 'orbslam3', 'command', 'wheels')
ANCHORED = 'anchored'    # the graph on a map from orbit, where somebody gives it one
_SLACK_S = 120.0         # for loading a vocabulary, and for the end
_SLOWEST = 10.0          # wall time over sequence time
_STAMP_NS = 2000         # how far a written stamp may be off
_TUM_STAMPS = 'rgb.txt'
_MAX_BYTES = 1 << 30     # of a trajectory
_WHEEL_SENSORS = ('mono', 'stereo', 'stereo-inertial')
_MOST_LINE = 1000        # of a vocabulary
_FIELDS = ('sequence', 'settings', 'times', 'sensor', 'out')   # of a command


@dataclasses.dataclass(frozen=True)
class Estimate:
    """What an estimator returned for a sequence.

    Attributes:
        trajectory: None if nothing was tracked.
        reason: Why nothing was tracked, or what else went wrong; empty if all is well.
        frame: Frame of the rover whose poses are estimated.
        frames_ns: (n,) stamps of the images of the sequence [ns].
        wall_s: How long the estimator ran [s].
        words: What it counted, for the user; empty for nothing.
        live: What it told at the time of each frame; of the graph on a site.
    """

    trajectory: Trajectory | None
    reason: str
    frame: str
    frames_ns: Stamps
    wall_s: float
    words: str = ''
    live: Trajectory | None = None


@dataclasses.dataclass(frozen=True)
class Estimator:
    """A SLAM system with one sensor, and its options.

    Attributes:
        system: One of SYSTEMS, or ANCHORED.
        sensor: `mono`, `stereo`, `stereo-inertial` or `rgbd`.
        program, vocabulary: Files of ORB-SLAM3; a Python as the program is one that has the wheel
            `pyorbslam3`, and runs `WHEEL_PROGRAM`.
        command: Command line of the system `command`, with the fields {sequence}, {settings},
            {times}, {sensor} and {out}, the TUM file to write.
        frame: Frame of the rover whose poses are estimated; empty for the default, see `poses_of`.
        features: Keypoints per image of ORB-SLAM3.
        timeout_s: Longest run [s]; 0 for ten times the sequence and two minutes.

    Raises:
        SlamError: If an option is not valid.
        ProcessError: If the program cannot be run.
    """

    system: str = 'reference'
    sensor: str = 'stereo'
    program: Path | None = None
    vocabulary: Path | None = None
    command: str = ''
    frame: str = ''
    features: int = 2000
    timeout_s: float = 0.0

    def __post_init__(self) -> None:
        for name, valid in (('system', (*SYSTEMS, ANCHORED)), ('sensor', SENSORS)):
            value = getattr(self, name)
            if value not in valid:
                raise SlamError(f'{name}: {value!r} is not valid; {nearest(value, valid)}')
        if self.system in ('graph', ANCHORED, 'wheels') and self.sensor != 'stereo':
            name = 'wheels' if self.system == 'wheels' else 'the graph'
            raise SlamError(f'sensor: {self.sensor!r} is not valid for {name}; valid is stereo')
        if self.system == 'reference' and self.sensor not in ('mono', 'stereo'):
            raise SlamError(f'sensor: {self.sensor!r} is not valid for the reference; valid '
                            'are mono, stereo')
        if self.system == 'orbslam3':
            lacking = [f'--{name}' for name, path in (
                ('executable', self.program), ('vocabulary', self.vocabulary)) if path is None]
            if self.program is None or self.vocabulary is None:
                raise SlamError(f'orbslam3: needs {" and ".join(lacking)}')
            executable(self.program)
            if is_python(self.program) and self.sensor not in _WHEEL_SENSORS:
                raise SlamError(f'sensor: {self.sensor!r} is not valid for the wheel of ORB-SLAM3;'
                                f' valid are {", ".join(_WHEEL_SENSORS)}')
            check_vocabulary(self.vocabulary)
        if self.system == 'command':
            if not self.command.strip():
                raise SlamError('--run: missing; it is the command line of the program')
            self._words(dict.fromkeys(_FIELDS, ''))
        if not 0.0 <= self.timeout_s < math.inf:
            raise SlamError(f'timeout: {self.timeout_s:g} is not valid; valid is >= 0 [s]')

    @property
    def format(self) -> str:
        """Format of the sequence that the system reads."""
        program = self.program.name if self.program is not None else ''
        return 'tum' if self.sensor == 'rgbd' or program.endswith('_tum') else 'euroc'

    @property
    def poses_of(self) -> str:
        """Frame of the rover whose poses are estimated."""
        if self.system == 'wheels':
            return 'base'
        return self.frame or ('imu' if self.sensor == 'stereo-inertial' else 'left')

    def estimate(self, sequence: Path, suite: SensorSuite, folder: Path,
                 echo: Echo | None = None, advance: Callable[[], None] = lambda: None,
                 stop: Callable[[], bool] = lambda: False) -> Estimate:
        """Run on an exported sequence. A lost track is a result.

        Args:
            sequence: Its folder.
            suite: The sensors that it was made with.
            folder: Must exist; gets settings, log and results.
            echo: Called with each line of the log.
            advance: Called after each frame of the reference.
            stop: Once it returns True, a program is ended early.

        Raises:
            SlamError: If a program fails without a result or writes an invalid one.
            ProcessError: If it cannot be started.
        """
        sequence, folder = sequence.absolute(), folder.absolute()
        frames_ns = self._frames_ns(sequence)
        span_s = float(frames_ns[-1] - frames_ns[0]) * 1e-9 if len(frames_ns) else 0.0
        timeout_s = self.timeout_s or _SLACK_S + _SLOWEST * span_s
        if self.system == 'reference':
            return self._reference(sequence, frames_ns, timeout_s, advance)
        path = folder / 'settings.yaml'
        atomic_write(path, settings(suite, self.sensor, features=self.features), SlamError)
        command, results = self._command(sequence, path, folder)
        ended = run_program(command, folder / 'log.txt', timeout_s, folder=folder, echo=echo,
                            stop=stop)
        found = next((folder / name for name in results if (folder / name).is_file()
                      and (folder / name).stat().st_size), None)
        last = f'; its last line: {ended.last_line}' if ended.last_line else ''
        if found is None:
            if ended.words:
                raise SlamError(f'{command[0]}: {ended.words} and wrote no trajectory{last}')
            return Estimate(None, 'lost: it wrote no pose', self.poses_of, frames_ns, ended.wall_s)
        trajectory = read_estimate(found, frames_ns)
        reason = f'{Path(command[0]).name} {ended.words}' if ended.words else ''
        if found.name.lower().startswith(('kf_', 'keyframe')):
            reason = join(reason, 'keyframes only')
        return Estimate(trajectory, join(reason, _lost(trajectory, frames_ns)), self.poses_of,
                        frames_ns, ended.wall_s)

    @property
    def _times_file(self) -> str:
        """The stamps of the pairs; a program with an IMU reads on to the sample after each."""
        return TIMES_IMU_FILE if self.sensor == 'stereo-inertial' else TIMES_FILE

    def _frames_ns(self, sequence: Path) -> Stamps:
        """Return the stamps of the images that the system is given."""
        if self.format == 'euroc':
            return np.array(euroc_reader.stamps_ns(sequence, self._times_file), dtype=np.int64)
        try:
            lines = read_text(sequence / _TUM_STAMPS, _MAX_BYTES, SlamError).splitlines()
            return np.array([from_seconds(line.split()[0]) for line in lines
                             if not line.startswith('#')], dtype=np.int64)
        except (ValueError, OverflowError, IndexError) as error:
            raise SlamError(f'{sequence}: {_TUM_STAMPS} cannot be read: {error}') from None

    def _reference(self, sequence: Path, frames_ns: Stamps, timeout_s: float,
                   advance: Callable[[], None]) -> Estimate:
        start, start_cpu = time.monotonic(), time.thread_time()
        camera = euroc_reader.read_camera(sequence, self.sensor == 'stereo')
        odometry = VisualOdometry(camera)
        reason = ''
        for frame in euroc_reader.read_frames(sequence, camera):
            odometry.add(*frame)
            advance()
            # Processor time of this thread: the result does not depend on what else runs.
            if time.thread_time() - start_cpu > timeout_s:
                reason = f'was ended after {timeout_s:.0f} s'
                break
        wall_s = time.monotonic() - start
        try:
            trajectory = odometry.trajectory()
        except SlamError:
            return Estimate(None, join(reason, 'lost: it located no frame'), 'left', frames_ns,
                            wall_s)
        return Estimate(trajectory, join(reason, _lost(trajectory, frames_ns)), 'left',
                        frames_ns, wall_s)

    def _command(self, sequence: Path, path: Path,
                 folder: Path) -> tuple[list[str], tuple[str, ...]]:
        """Return the command line and the files in which to look for its result."""
        out = 'estimate_raw.txt'
        if self.system == 'command':
            return self._words(dict(zip(_FIELDS, map(str, (
                sequence, path, sequence / self._times_file, self.sensor, folder / out))))), (out,)
        assert self.program is not None and self.vocabulary is not None
        program = executable(self.program)
        wheel = [str(program_path(WHEEL_PROGRAM)), '--sensor', self.sensor]
        command = [str(program), *(wheel if is_python(program) else ()),
                   str(self.vocabulary.absolute()), str(path), str(sequence)]
        if self.format == 'euroc':
            command += [str(sequence / self._times_file), 'run']
        elif self.sensor == 'rgbd':
            command.append(str(sequence / 'associations.txt'))
        return command, ('f_run.txt', 'CameraTrajectory.txt', 'kf_run.txt',
                         'KeyFrameTrajectory.txt')

    def _words(self, values: dict[str, str]) -> list[str]:
        """Return the command line with its fields filled in."""
        try:
            words = [word.format(**values) for word in shlex.split(self.command)]
        except (KeyError, IndexError, ValueError) as error:
            raise SlamError(f'--run: {self.command!r} is not valid: {error}; valid '
                            f'fields are {", ".join(_FIELDS)}') from None
        return [str(executable(words[0])), *words[1:]]


def check_vocabulary(path: Path) -> None:
    """Raise SlamError unless a file begins as a vocabulary in the text format of DBoW2 does.

    That is `branching levels score weights`, then `parent is_leaf`, 32 bytes and a weight.
    """
    valid = 'valid is a text vocabulary of DBoW2, such as ORBvoc.txt'
    try:
        check_regular(path, SlamError)
        with path.open('rb') as file:
            head, node = (file.readline(_MOST_LINE).split() for _ in range(2))
    except OSError as error:
        raise SlamError(f'{path}: cannot be read: {error.strerror}') from None
    if head[:1] and head[0].startswith((b'\x1f\x8b', b'BZh', b'PK')):
        raise SlamError(f'{path}: is compressed; unpack it: {valid}')
    numbers = [int(word) if word.isdigit() else -1 for word in head]
    if (len(numbers) != 4 or not 2 <= numbers[0] <= 20 or not 1 <= numbers[1] <= 10
            or not 0 <= numbers[2] <= 5 or not 0 <= numbers[3] <= 3 or len(node) != 35
            or not all(word.isdigit() and int(word) < 256 for word in node[2:34])):
        raise SlamError(f'{path}: is not a vocabulary; {valid}')


def is_python(program: Path) -> bool:
    """Return whether a program is a Python, by its name."""
    return re.fullmatch(r'python(\d+(\.\d+)*)?', program.name, re.ASCII) is not None


def stock_program(path: Path | None, sensor: str) -> Path | None:
    """Return the example program of ORB-SLAM3 for a sensor, if `path` is the folder of them.

    Another path is returned as it is.

    Raises:
        SlamError: If the folder lacks the program.
    """
    if path is None or not path.is_dir():
        return path
    name = 'rgbd_tum' if sensor == 'rgbd' else f'{sensor.replace("-", "_")}_euroc'
    found = sorted(p for p in (path / name, *path.glob(f'*/{name}')) if p.is_file())
    if not found:
        raise SlamError(f'{path}: there is no {name} in it')
    return found[0]


def read_estimate(path: Path, frames_ns: Stamps) -> Trajectory:
    """Read `stamp x y z qx qy qz qw` lines, stamps in ns or seconds, whichever fits the frames.

    A stamp within 2 us of a frame's is taken to be that frame's: programs keep stamps as floating
    point. A line that repeats the previous one is left out: for a frame that it could not locate,
    ORB-SLAM3 writes the last pose and stamp again.

    Args:
        path: The file.
        frames_ns: (n,) stamps of the images [ns].

    Raises:
        SlamError: If it cannot be read, with its name.
    """
    rows = []
    text = read_text(path, _MAX_BYTES, SlamError)
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition('#')[0].split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise SlamError(f'{path}: line {number} is not a row of numbers') from None
        if len(rows[-1]) != 8:
            raise SlamError(f'{path}: line {number} has {len(words)} columns; valid is 8')
        if rows[-2:-1] == rows[-1:]:
            rows.pop()
    if not rows:
        raise SlamError(f'{path}: holds no poses')
    values = np.array(rows)
    if not np.isfinite(values).all():
        raise SlamError(f'{path}: a number is not finite')
    best: tuple[float, Stamps] | None = None
    for unit_ns in (1.0, 1e9):
        stamps = values[:, 0] * unit_ns
        if np.abs(stamps).max() > 9e18:
            continue
        index = np.abs(np.searchsorted(0.5 * (frames_ns[1:] + frames_ns[:-1]), stamps))
        near = frames_ns[index]
        off = np.abs(stamps - near)
        snapped = np.where(off <= _STAMP_NS, near, np.rint(stamps).astype(np.int64))
        if best is None or float(np.median(off)) < best[0]:
            best = float(np.median(off)), snapped
    if best is None:
        raise SlamError(f'{path}: its stamps are neither ns nor seconds')
    return Trajectory(best[1], values[:, 1:4], values[:, [7, 4, 5, 6]], str(path))


def _lost(trajectory: Trajectory, frames_ns: Stamps) -> str:
    """Return when the track ended, if that was more than a second early; else ''."""
    gap_s = float(frames_ns[-1] - trajectory.stamps_ns[-1]) * 1e-9
    return f'lost at {trajectory.stamps_ns[-1] * 1e-9:.1f} s' if gap_s > 1.0 else ''


def join(*reasons: str) -> str:
    """Return the reasons that are not empty, as one."""
    return '; '.join(filter(None, reasons))
