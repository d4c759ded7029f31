"""A stand-in for the interface of the wheel pyorbslam3 0.1.1, with which wheel.py is tested.

It tracks nothing: the camera is as far along x as there were frames, along y as the sum of the
last pixels, and along z as the stamp of the last sample of the IMU. See test_wheel.py. These are
metres; it answers in the unit of length in which its settings give the distance of the cameras,
and there gravity must be that of the Earth. With an IMU it answers the fifth frame with the pose
of a new frame, as where a map is given up.
"""

from __future__ import annotations

import enum
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation


class Sensor(enum.Enum):
    """As in the wheel."""

    MONOCULAR, STEREO, RGBD, IMU_MONOCULAR, IMU_STEREO, IMU_RGBD = range(6)


class TrackingState(enum.Enum):
    """As in the wheel."""

    NOT_INITIALIZED, OK, RECENTLY_LOST = 1, 2, 3


# Of every pose: half a turn, of which the trace says nothing, and a little more.
TURN = Rotation.from_rotvec([0.0, 3.1, 0.02])


BASELINE_M = 0.1        # of synthetic_bag.py


class Slam:
    """Knows no pose at its first frame."""

    def __init__(self, vocabulary: str, settings: str, sensor: Sensor) -> None:
        if not Path(settings).read_text().startswith('%YAML'):
            raise RuntimeError('Failed to open settings file at ' + settings)
        print('reads', vocabulary)
        self._sensor, self._poses, self._is_shut_down = sensor, [], False
        self._frames = 0
        distance = re.search(r'Stereo.T_c1_c2:.*?data: \[[^,]*,[^,]*,[^,]*,([^,]*),',
                             Path(settings).read_text(), re.DOTALL)
        self._unit = float(distance[1]) / BASELINE_M if distance else 1.0

    def track_monocular(self, image, stamp_s: float, imu=None):
        """Return the pose of one image."""
        assert self._sensor is Sensor.MONOCULAR
        return self._next(stamp_s, imu, image)

    def track_stereo(self, left, right, stamp_s: float, imu=None):
        """Return the pose of a pair."""
        assert self._sensor in (Sensor.STEREO, Sensor.IMU_STEREO)
        return self._next(stamp_s, imu, left, right)

    def _next(self, stamp_s: float, imu, *images):
        assert all(image.dtype == np.uint8 and image.ndim == 2 for image in images)
        assert (imu is not None) == (self._sensor is Sensor.IMU_STEREO)
        self._frames += 1
        if imu is not None and len(imu):
            # A drive that sways; in metres it would be 1.1 to 2.2.
            assert 5.0 < np.linalg.norm(imu[:, 4:].mean(axis=0)) < 15.0 or self._unit == 1.0
            # The wheel refuses others.
            assert imu.shape[1] == 7 and (np.diff(imu[:, 0]) > 0.0).all() and imu[-1, 0] <= stamp_s
        if self._frames == 1:
            return SimpleNamespace(state=TrackingState.NOT_INITIALIZED, pose_wc=None)
        T = np.eye(4)
        T[:3, :3] = TURN.as_matrix()
        T[:3, 3] = (self._frames, sum(int(image[-1, -1]) for image in images),
                    0.0 if imu is None or not len(imu) else imu[-1, 0])
        T[:3, 3] *= self._unit
        self._poses.append((stamp_s, T))
        is_given_up = imu is not None and self._frames == 5
        return SimpleNamespace(state=TrackingState.OK, pose_wc=np.eye(4) if is_given_up else T)

    def imu_initialized(self) -> bool:
        """Say whether the map is turned to gravity: from the third frame on."""
        assert self._sensor is Sensor.IMU_STEREO
        return self._frames > 2

    def shutdown(self) -> None:
        """As in the wheel, before anything is saved."""
        self._is_shut_down = True

    def save_trajectory_euroc(self, path: str) -> None:
        """Write all poses: stamps in ns, as ORB-SLAM3 has them."""
        assert self._is_shut_down and self._poses
        Path(path).write_text(''.join(
            f'{1e9 * stamp_s:.6f} {" ".join(map(str, [*T[:3, 3], *TURN.as_quat()]))}\n'
            for stamp_s, T in self._poses))

    save_keyframe_trajectory_euroc = save_trajectory_euroc
