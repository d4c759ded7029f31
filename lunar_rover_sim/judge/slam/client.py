"""The other end of the pipes: what a SLAM program in Python needs, and the built-in odometry.

    python -m lunar_rover_sim.judge.slam.client

is a program that `run --slam` and slam_node can start.
"""

from __future__ import annotations

from collections.abc import Callable
import os
import sys
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.evaluation.trajectory import wxyz
from lunar_rover_sim.judge.slam import protocol
from lunar_rover_sim.judge.slam.euroc_reader import Camera
from lunar_rover_sim.judge.slam.protocol import FrameSet, ImuSamples
from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry

Track = Callable[[FrameSet, 'list[ImuSamples]'], 'Array | None']


def serve(begin: Callable[[dict[str, Any]], Track]) -> None:
    """Answer every frame until the end.

    What is printed meanwhile goes to the standard error: the standard output is the pipe. Raises
    SlamError for a message that is none.

    Args:
        begin: Gets the settings and returns the tracker. That gets a frame and the samples of the
            IMU since the one before, and returns T_map_camera (4, 4), or None where it knows no
            pose.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    track: Track | None = None
    imu: list[ImuSamples] = []
    located = False

    def send(message: bytes) -> None:
        answers.write(message)
        answers.flush()

    while (message := protocol.read_message(sys.stdin.buffer)) is not None:
        if message.kind == protocol.SETTINGS:
            track = begin(protocol.settings_of(message.body))
            send(protocol.packed(protocol.READY))
        elif message.kind == protocol.IMU:
            imu.append(protocol.imu_of(message.body))
        elif message.kind == protocol.FRAMES and track is not None:
            frames = protocol.frames_of(message.body)
            T_map_camera = track(frames, imu)
            imu = []
            located |= T_map_camera is not None
            send(protocol.pack_pose(answer(frames.stamp_ns, T_map_camera, located)))
        elif message.kind == protocol.END:
            return
        else:
            raise SlamError(f'message of kind {message.kind} is not expected here')


def answer(stamp_ns: int, T_map_camera: Array | None, located: bool) -> protocol.TrackedPose:
    """Return the pose as the answer to a frame; located: whether there was one so far."""
    if T_map_camera is None:
        return protocol.TrackedPose(stamp_ns, protocol.LOST if located else protocol.INITIALISING)
    rotation = wxyz(Rotation.from_matrix(T_map_camera[None, :3, :3]))[0]
    position = T_map_camera[:3, 3]
    return protocol.TrackedPose(stamp_ns, protocol.TRACKING, tuple(map(float, position)),
                                tuple(map(float, rotation)))


def reference(settings: dict[str, Any]) -> Track:
    """Return a tracker that is the built-in odometry; it knows mono and stereo.

    Where it is lost for good, another one begins at the last pose; of a single camera it would
    have another scale, and none begins.
    """
    stereo = settings['sensor'] != 'mono'
    camera = Camera((settings['fx'], settings['fy']), (settings['cx'], settings['cy']),
                    settings['baseline_m'] if stereo else 0.0, tuple(settings['distortion'][:4]))
    odometry, T_map_first = VisualOdometry(camera), np.eye(4)

    def track(frames: FrameSet, imu: list[ImuSamples]) -> Array | None:
        nonlocal odometry, T_map_first
        if stereo and odometry.lost_ns is not None:
            T_map_first = T_map_first @ odometry.T_map_camera
            odometry = VisualOdometry(camera)
        images = [camera.rectified(np.ascontiguousarray(image)) for image in frames.images]
        located = odometry.add(frames.stamp_ns, *images[:2 if stereo else 1])
        return T_map_first @ odometry.T_map_camera if located else None

    return track


if __name__ == '__main__':
    serve(reference)
