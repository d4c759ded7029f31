"""Frames to a SLAM program and its poses back, over two pipes: messages of a small protocol.

Every message is a header of 12 bytes and a body, all little-endian:

    char[4] magic "LRSP", uint16 version (1), uint16 kind, uint32 length of the body [bytes]

To the program: SETTINGS once, then IMU (where the sensor has one) and FRAMES, at last END.
From the program: READY once it takes frames, then one POSE for every FRAMES, in their order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import json
import struct
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import SlamError

MAGIC, VERSION = b'LRSP', 1
SETTINGS, FRAMES, IMU, END, READY, POSE = range(1, 7)
INITIALISING, TRACKING, LOST = range(3)
STATES = ('initialising', 'tracking', 'lost')

_HEADER = struct.Struct('<4sHHI')
_FRAMES = struct.Struct('<qIII')     # stamp [ns], width, height [px], number of images
_COUNT = struct.Struct('<I')
_IMU = np.dtype([('stamp_ns', '<i8'), ('rates_radps', '<f8', 3), ('forces_mps2', '<f8', 3)])
_POSE = struct.Struct('<qI7d')       # stamp [ns], state, position, quaternion xyzw
_MAX_BYTES = 1 << 28                 # of a body
_MAX_SIDE = 1 << 14                  # of an image [px]


class Message(NamedTuple):
    """A kind and the bytes of a body."""

    kind: int
    body: bytes


@dataclasses.dataclass(frozen=True)
class FrameSet:
    """Images (h, w) of 8 bits with one stamp: left, and of a stereo sensor right."""

    stamp_ns: int
    images: tuple[NDArray[np.uint8], ...]


@dataclasses.dataclass(frozen=True)
class ImuSamples:
    """stamps_ns (n,), rates_radps (n, 3), forces_mps2 (n, 3): specific force, IMU axes."""

    stamps_ns: NDArray[np.int64]
    rates_radps: NDArray[np.float64]
    forces_mps2: NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class TrackedPose:
    """The answer to a frame.

    Attributes:
        state: INITIALISING, TRACKING or LOST; only with TRACKING the pose means anything.
        position_m, wxyz: (3,), (4,) of the left camera in the map of the program.
        covariance: (6, 6) of x, y, z [m] and of the turn about the map's axes [rad]; None from
            a program, which has no message for it.
        place: Of the graph with a map from orbit: what it knows of its place there, see
            `graph.anchor.Anchor.place`; empty without.
        news: What moved the estimate at this frame; empty for nothing.
    """

    stamp_ns: int
    state: int
    position_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    covariance: NDArray[np.float64] | None = None
    place: str = ''
    news: str = ''


def packed(kind: int, body: bytes = b'') -> bytes:
    """Return a message as bytes."""
    return _HEADER.pack(MAGIC, VERSION, kind, len(body)) + body


def pack_settings(values: Mapping[str, Any]) -> bytes:
    """Return SETTINGS: a JSON object."""
    return packed(SETTINGS, json.dumps(dict(values)).encode())


def pack_frames(frames: FrameSet) -> bytes:
    """Return FRAMES: a header, then the rows of each image without gaps."""
    height, width = frames.images[0].shape
    return packed(FRAMES, _FRAMES.pack(frames.stamp_ns, width, height, len(frames.images))
                  + b''.join(np.ascontiguousarray(image).tobytes() for image in frames.images))


def pack_imu(samples: Sequence[tuple[int, Sequence[float], Sequence[float]]]) -> bytes:
    """Return IMU: a count, then (stamp [ns], rate xyz [rad/s], specific force xyz [m/s^2])."""
    return packed(IMU, _COUNT.pack(len(samples)) + np.array(
        [(ns, tuple(rate), tuple(force)) for ns, rate, force in samples], _IMU).tobytes())


def pack_pose(pose: TrackedPose) -> bytes:
    """Return POSE."""
    w, x, y, z = pose.wxyz
    return packed(POSE, _POSE.pack(pose.stamp_ns, pose.state, *pose.position_m, x, y, z, w))


def read_message(stream: BinaryIO) -> Message | None:
    """Return the next message of a stream; None at its end.

    Raises:
        SlamError: For anything that is none of this protocol, and where the stream ends within a
            message.
    """
    header = stream.read(_HEADER.size)
    if not header:
        return None
    if len(header) < _HEADER.size or not header.startswith(MAGIC):
        raise SlamError(f'{header!r} is not the header of a message; does the program print to '
                        'its standard output? (valid is its standard error)')
    _, version, kind, length = _HEADER.unpack(header)
    if version != VERSION:
        raise SlamError(f'version {version} of the protocol is not valid; valid is {VERSION}')
    if not SETTINGS <= kind <= POSE or length > _MAX_BYTES:
        raise SlamError(f'kind {kind}, {length} bytes: not a message; valid are kinds {SETTINGS} '
                        f'to {POSE} and at most {_MAX_BYTES} bytes')
    body = stream.read(length)
    if len(body) < length:
        raise SlamError(f'the stream ends after {len(body)} of {length} bytes of a message')
    return Message(kind, body)


def settings_of(body: bytes) -> dict[str, Any]:
    """Return the values of SETTINGS; raise SlamError if it is no JSON object."""
    try:
        values = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise SlamError(f'settings: not JSON: {error}') from None
    if not isinstance(values, dict):
        raise SlamError('settings: not a JSON object')
    return values


def frames_of(body: bytes) -> FrameSet:
    """Return the images of FRAMES; raise SlamError if they do not have their size."""
    if len(body) < _FRAMES.size:
        raise SlamError(f'frames: {len(body)} bytes are too few')
    stamp_ns, width, height, count = _FRAMES.unpack_from(body)
    if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE and count in (1, 2)
            and len(body) == _FRAMES.size + count * width * height):
        raise SlamError(f'frames: {count} images of {width}x{height} do not fit {len(body)} bytes')
    pixels = np.frombuffer(body, np.uint8, offset=_FRAMES.size).reshape(count, height, width)
    return FrameSet(stamp_ns, tuple(pixels))


def imu_of(body: bytes) -> ImuSamples:
    """Return the samples of IMU; raise SlamError if their count does not fit."""
    count = _COUNT.unpack_from(body)[0] if len(body) >= _COUNT.size else -1
    if len(body) != _COUNT.size + count * _IMU.itemsize:
        raise SlamError(f'imu: {count} samples do not fit {len(body)} bytes')
    rows = np.frombuffer(body, _IMU, offset=_COUNT.size)
    return ImuSamples(rows['stamp_ns'], rows['rates_radps'], rows['forces_mps2'])


def pose_of(body: bytes) -> TrackedPose:
    """Return POSE; raise SlamError if a number is not finite or the quaternion has no length."""
    if len(body) != _POSE.size:
        raise SlamError(f'pose: {len(body)} bytes; valid is {_POSE.size}')
    stamp_ns, state, *numbers = _POSE.unpack(body)
    if state >= len(STATES):
        raise SlamError(f'pose: state {state} is not valid; valid are 0 to {len(STATES) - 1}')
    if state != TRACKING:
        return TrackedPose(stamp_ns, state)
    x, y, z, w = numbers[3:]
    length = float(np.linalg.norm(numbers[3:]))
    if not np.isfinite(numbers).all() or not 0.99 < length < 1.01:
        raise SlamError(f'pose at {stamp_ns / 1e9:.3f} s: {numbers} is no position and unit '
                        'quaternion')
    return TrackedPose(stamp_ns, state, tuple(numbers[:3]),
                       (w / length, x / length, y / length, z / length))
