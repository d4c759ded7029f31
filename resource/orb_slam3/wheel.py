#!/usr/bin/env python3
"""ORB-SLAM3 from the wheel `pyorbslam3`: behind the pipes of slam_node, and on sequences.

    python wheel.py VOCABULARY SETTINGS mono|stereo|stereo-inertial
    python wheel.py --sensor SENSOR VOCABULARY SETTINGS SEQUENCE TIMES NAME

The first speaks the protocol of docs/reference/slam_protocol.md. The second does what ORB-SLAM3's
example programs mono_euroc, stereo_euroc and stereo_inertial_euroc do with these arguments: frames
of a sequence in the format of EuRoC, none faster than in real time, and the trajectories in
f_NAME.txt and kf_NAME.txt. Under one of these names it knows the sensor without --sensor.

ORB-SLAM3 has the gravity of the Earth compiled in. Where the settings of stereo-inertial hold
another one, `IMU.Gravity` [m/s^2], it computes in a unit of length of which there are 9.81 in that
one: lengths and accelerations are multiplied on their way in, positions divided on their way out.

It runs in any Python that has pyorbslam3 and, for sequences, Pillow or OpenCV; nothing else of
lunar_rover_sim is needed there. This file is Apache-2.0. pyorbslam3 and the ORB-SLAM3 in it are
GPL-3.0: both together may be passed on under the GPL-3.0 only.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import re
import struct
import sys
import tempfile
import time

import numpy as np

SENSORS = {'mono': 'MONOCULAR', 'stereo': 'STEREO', 'stereo-inertial': 'IMU_STEREO'}
PROGRAMS = {'mono_euroc': 'mono', 'stereo_euroc': 'stereo',
            'stereo_inertial_euroc': 'stereo-inertial'}
VERSION = 1
MOST_BYTES = 1 << 28
FRAMES, IMU, END, READY, POSE = 2, 3, 4, 5, 6       # kinds of messages
INITIALISING, TRACKING, LOST = 0, 1, 2
COMPILED_MPS2 = 9.81        # GRAVITY_VALUE in ImuTypes.h
SAMPLE = np.dtype([('stamp_ns', '<i8'), ('values', '<f8', 6)])


class Failure(Exception):
    """What ends the program, in one line."""


class Tracker:
    """ORB-SLAM3 with one sensor, as the frames come."""

    def __init__(self, vocabulary: str, settings: str, sensor: str) -> None:
        try:
            import pyorbslam3
        except ImportError as error:
            raise Failure(f'pyorbslam3 cannot be imported by {sys.executable}: {error}; '
                          'install it with pip, and the libraries that it names') from None
        self._sensor = sensor
        self._ok = pyorbslam3.TrackingState.OK
        self._per_m = 1.0
        with tempfile.TemporaryDirectory(prefix='wheel_') as folder:
            if sensor == 'stereo-inertial':
                text = Path(settings).read_text(encoding='utf-8')
                self._per_m = units_per_m(text)
                if self._per_m != 1.0:
                    settings = os.path.join(folder, 'settings.yaml')
                    Path(settings).write_text(in_units(text, self._per_m), encoding='utf-8')
            self._slam = pyorbslam3.Slam(vocabulary, settings,
                                         getattr(pyorbslam3.Sensor, SENSORS[sensor]))
        self._imu_scale = np.array([1.0] * 4 + [self._per_m] * 3)   # of stamp, turn and force
        self._is_turned = False         # the map, to gravity
        self.has_tracked = False
        self.has_started = False        # there has been a pose that stays

    def track(self, stamp_ns: int, images: list, imu: np.ndarray) -> np.ndarray | None:
        """Return T_map_camera (4, 4) of the left camera, or None where it is not tracked.

        With an IMU there is none before the map has been turned to gravity, after 2 s or more.
        images: (h, w) of 8 bits; imu: (n, 7) stamp [s], angular velocity, specific force, after
        the frame before and up to this one
        """
        stamp_s = 1e-9 * stamp_ns
        more = {'imu': imu * self._imu_scale} if self._sensor == 'stereo-inertial' else {}
        call = self._slam.track_monocular if self._sensor == 'mono' else self._slam.track_stereo
        result = call(*images, stamp_s, **more)
        if result.state != self._ok:
            self._is_turned = False
            return None
        self.has_tracked = True
        T = np.array(result.pose_wc, dtype=float)
        if self._sensor == 'stereo-inertial':
            # The map is turned beside the tracking: the pose meanwhile may be of either frame.
            # The frame at which a map is given up has that of a new frame, the identity.
            is_unset = np.array_equal(T, np.eye(4))
            was_turned = self._is_turned
            self._is_turned = not is_unset and self._slam.imu_initialized()
            if not (was_turned and self._is_turned):
                return None
        self.has_started = True
        T[:3, 3] /= self._per_m
        return T

    def shutdown(self) -> None:
        """End its threads."""
        self._slam.shutdown()

    def save(self, name: str) -> None:
        """Write f_NAME.txt, the poses of frames, and kf_NAME.txt, those of keyframes."""
        for path, write in ((f'f_{name}.txt', self._slam.save_trajectory_euroc),
                            (f'kf_{name}.txt', self._slam.save_keyframe_trajectory_euroc)):
            write(path)
            if self._per_m != 1.0:
                rows = [line.split() for line in Path(path).read_text().splitlines()]
                for row in rows:
                    row[1:4] = [f'{float(word) / self._per_m:.9f}' for word in row[1:4]]
                Path(path).write_text(''.join(' '.join(row) + '\n' for row in rows))


def units_per_m(settings: str) -> float:
    """Return how many units of length a metre has, for the gravity that settings hold."""
    found = re.search(r'^IMU\.Gravity:\s*(\S+)', settings, re.MULTILINE)
    gravity = float(found[1]) if found else COMPILED_MPS2
    if not gravity > 0.0:
        raise Failure(f'IMU.Gravity: {gravity:g} is not valid; valid is > 0 [m/s^2]')
    return COMPILED_MPS2 / gravity


def in_units(settings: str, per_m: float) -> str:
    """Return settings of version 1.0 with lengths and accelerations in that unit."""
    def scaled(name: str, pattern: str, columns: tuple[int, ...], text: str) -> str:
        found = re.search(rf'^{re.escape(name)}:{pattern}', text, re.MULTILINE)
        if not found:
            raise Failure(f'the settings hold no {name}: with IMU.Gravity they need those of '
                          'version 1.0')
        words = found[1].split(',')
        for k in columns:
            words[k] = f' {float(words[k]) * per_m:#.12g}'      # real numbers have a point
        return text[:found.start(1)] + ','.join(words) + text[found.end(1):]

    for name in ('Stereo.T_c1_c2', 'IMU.T_b_c1'):
        settings = scaled(name, r'[^[]*\[([^]]*)\]', (3, 7, 11), settings)
    for name in ('IMU.NoiseAcc', 'IMU.AccWalk'):
        settings = scaled(name, r'([^\n]*)', (0,), settings)
    return settings


def quaternion_xyzw(R: np.ndarray) -> list[float]:
    """Return the quaternion of a rotation matrix.

    It is the eigenvector of the largest eigenvalue (Bar-Itzhack, Journal of Guidance, Control, and
    Dynamics 23, 2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = R
    K = np.array([[a - e - i, b + d, c + g, h - f], [b + d, e - a - i, f + h, c - g],
                  [c + g, f + h, i - a - e, d - b], [h - f, c - g, d - b, a + e + i]])
    x, y, z, w = np.linalg.eigh(K)[1][:, -1]
    return [float(v) for v in (x, y, z, w)]


# Behind pipes

def read(pipe, size: int, at_start: bool = False) -> bytes:
    """Return so many bytes; none at the end of the input, which is no error at a start."""
    data = pipe.read(size)
    if len(data) != size and not (at_start and not data):
        raise Failure('the input ends within a message')
    return data


def serve(vocabulary: str, settings: str, sensor: str) -> None:
    """Answer every frame until the end."""
    # What ORB-SLAM3 prints must not get between the answers.
    answers = os.dup(1)
    os.dup2(2, 1)

    def send(kind: int, body: bytes = b'') -> None:
        message = struct.pack('<4sHHI', b'LRSP', VERSION, kind, len(body)) + body
        while message:
            message = message[os.write(answers, message):]

    tracker = Tracker(vocabulary, settings, sensor)
    send(READY)
    imu = np.zeros((0, 7))
    while header := read(sys.stdin.buffer, 12, at_start=True):
        magic, version, kind, length = struct.unpack('<4sHHI', header)
        if magic != b'LRSP' or version != VERSION or length > MOST_BYTES:
            raise Failure('the input is not of this version of the protocol')
        body = read(sys.stdin.buffer, length)
        if kind == END:
            break
        if kind == IMU:
            imu = samples_of(body)
        if kind == FRAMES:
            stamp_ns, images = frames_of(body, sensor)
            pose = tracker.track(stamp_ns, images, imu)
            imu = np.zeros((0, 7))
            state = TRACKING if pose is not None else LOST if tracker.has_started else INITIALISING
            T = np.eye(4) if pose is None else pose
            send(POSE, struct.pack('<qI7d', stamp_ns, state, *T[:3, 3],
                                   *quaternion_xyzw(T[:3, :3])))
    tracker.shutdown()


def samples_of(body: bytes) -> np.ndarray:
    """Return (n, 7) samples of an IMU message: stamps [s], angular velocities, specific forces."""
    if len(body) < 4 or len(body) != 4 + SAMPLE.itemsize * struct.unpack_from('<I', body)[0]:
        raise Failure('the samples of the IMU do not have their number')
    rows = np.frombuffer(body, SAMPLE, offset=4)
    return np.column_stack([1e-9 * rows['stamp_ns'], rows['values']])


def frames_of(body: bytes, sensor: str) -> tuple[int, list]:
    """Return stamp [ns] and images (h, w) of a message of frames."""
    if len(body) < 20:
        raise Failure('a message is too short')
    stamp_ns, width, height, count = struct.unpack_from('<qIII', body)
    if count != (1 if sensor == 'mono' else 2) or len(body) != 20 + count * width * height:
        raise Failure(f'the images do not fit the sensor {sensor}')
    return stamp_ns, list(np.frombuffer(body, np.uint8, offset=20).reshape(count, height, width))


# On a sequence

def run(words: list[str], sensor: str) -> None:
    """Track a sequence and write the trajectories, as the example programs of ORB-SLAM3 do."""
    vocabulary, settings, sequence, times, name = words
    folder = Path(sequence) / 'mav0'
    stamps = Path(times).read_text().split()    # ns, as they name the files
    stamps_ns = [int(stamp) for stamp in stamps]
    imu = (np.loadtxt(folder / 'imu0/data.csv', delimiter=',', ndmin=2)
           if sensor == 'stereo-inertial' else np.zeros((0, 7)))
    imu[:, 0] *= 1e-9       # ns to s
    imu_s = imu[:, 0]
    read_image = image_reader()
    tracker = Tracker(vocabulary, settings, sensor)
    before_s = -np.inf
    for k, stamp_ns in enumerate(stamps_ns):
        images = [read_image(str(folder / camera / 'data' / f'{stamps[k]}.png'))
                  for camera in ('cam0', 'cam1')[:1 if sensor == 'mono' else 2]]
        chosen = (imu_s > before_s) & (imu_s <= 1e-9 * stamp_ns) if k else imu_s < 0.0
        start_s = time.monotonic()
        tracker.track(stamp_ns, images, imu[chosen])
        # Mapping goes on beside it: frames do not come faster than in reality.
        if k + 1 < len(stamps_ns):
            period_s = 1e-9 * (stamps_ns[k + 1] - stamp_ns)
            time.sleep(max(0.0, period_s - (time.monotonic() - start_s)))
        before_s = 1e-9 * stamp_ns
    tracker.shutdown()
    if not tracker.has_tracked:
        print('no frame was tracked')       # and there is no trajectory to be written
        return
    tracker.save(name)


def image_reader():
    """Return a function that reads a grey image (h, w)."""
    try:
        from PIL import Image
        return lambda path: np.ascontiguousarray(Image.open(path).convert('L'))
    except ImportError:
        pass
    try:
        import cv2
        return lambda path: cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    except ImportError:
        raise Failure(f'{sys.executable} has no Pillow to read images with') from None


def main() -> int:
    """Run as the words say."""
    parser = argparse.ArgumentParser(
        usage='%(prog)s VOCABULARY SETTINGS SENSOR\n'
              '       %(prog)s [--sensor SENSOR] VOCABULARY SETTINGS SEQUENCE TIMES NAME',
        description='ORB-SLAM3 from the wheel pyorbslam3, behind pipes or on a sequence.')
    parser.add_argument('--sensor', choices=SENSORS, default=PROGRAMS.get(Path(sys.argv[0]).name))
    parser.add_argument('words', nargs='+')
    args = parser.parse_args()
    try:
        if len(args.words) == 3 and args.words[2] in SENSORS:
            serve(*args.words)
        elif len(args.words) == 5 and args.sensor:
            run(args.words, args.sensor)
        else:
            parser.error(f'{" ".join(args.words)} is not valid; sensors are {", ".join(SENSORS)}')
    except (Failure, OSError, ValueError, RuntimeError) as error:
        print(f'{sys.argv[0]}: {error}', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
