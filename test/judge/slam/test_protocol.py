"""The protocol of slam_node's pipes, ORB-SLAM3's adapter, and wrappers of live SLAM."""

import io
from pathlib import Path
import shutil
import struct
import subprocess
import sys

from judge.slam.fed_frames import feed, LEFT, wait
import numpy as np
import psutil
import pytest
from waiting import LIMIT_S

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.judge.slam import live
from lunar_rover_sim.judge.slam import program as slam_program
from lunar_rover_sim.judge.slam import protocol
from lunar_rover_sim.judge.slam.client import answer
from lunar_rover_sim.judge.slam.program import SlamProgram
from lunar_rover_sim.judge.slam.protocol import FrameSet, TrackedPose
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS

IMU = [(5, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), (7_500_000_000, (0.0,) * 3, (0.0, 0.0, 1.62))]
STUB = Path(__file__).parent / 'orb_slam3_stub'
ADAPTER = Path(__file__).parents[3] / 'resource' / 'orb_slam3' / 'adapter.cc'
# A program of the standard library alone: the documented layout, and a fault after `good` frames.
PROGRAM = """
import os, struct, sys, time
def read(n):
    data = sys.stdin.buffer.read(n)
    return data if len(data) == n else sys.exit(0)
def send(kind, body=b''):
    os.write(1, struct.pack('<4sHHI', b'LRSP', 1, kind, len(body)) + body)
good, fault = int(sys.argv[1]), sys.argv[2]
while True:
    magic, version, kind, length = struct.unpack('<4sHHI', read(12))
    body = read(length)
    if kind == 4:
        break
    if kind == 1 and fault != 'never_ready':
        send(5)
    if kind == 2:
        if good == 0:
            if fault == 'crash':
                os.abort()
            if fault == 'leave':
                sys.exit(3)
            if fault == 'print':
                print('hello, world', flush=True)
            if fault in ('silent', 'print'):
                time.sleep(60)
            if fault == 'wrong':
                body = struct.pack('<q', 99) + body[8:]
        good -= 1
        send(6, body[:8] + struct.pack('<I7d', 1, good, 0, 0, 0, 0, 0, 1))
"""


def body_of(message: bytes) -> bytes:
    """Return the body of a message as the other end reads it."""
    read = protocol.read_message(io.BytesIO(message))
    assert read is not None
    return read.body


def test_every_message_is_read_as_it_was_written() -> None:
    frames = protocol.frames_of(body_of(protocol.pack_frames(FrameSet(9, (LEFT, LEFT.T.reshape(
        3, 4))))))
    assert frames.stamp_ns == 9
    assert np.array_equal(frames.images[0], LEFT)
    assert np.array_equal(frames.images[1], LEFT.T.reshape(3, 4))
    samples = protocol.imu_of(body_of(protocol.pack_imu(IMU)))
    assert samples.stamps_ns.tolist() == [5, 7_500_000_000]
    assert samples.rates_radps[0].tolist() == [1.0, 2.0, 3.0]
    assert samples.forces_mps2[1].tolist() == [0.0, 0.0, 1.62]
    pose = TrackedPose(7, protocol.TRACKING, (1.0, 2.0, 3.0), (0.5, -0.5, 0.5, 0.5))
    assert protocol.pose_of(body_of(protocol.pack_pose(pose))) == pose
    assert protocol.settings_of(body_of(protocol.pack_settings({'fx': 3.5}))) == {'fx': 3.5}
    assert protocol.read_message(io.BytesIO()) is None


def test_the_layout_is_the_documented_one() -> None:
    """Bytes by hand: other programs rely on them."""
    assert protocol.pack_frames(FrameSet(258, (LEFT,))) == (
        b'LRSP\x01\x00\x02\x00\x20\x00\x00\x00' + b'\x02\x01' + bytes(6)
        + struct.pack('<III', 4, 3, 1) + bytes(range(12)))
    assert protocol.pack_imu(IMU[:1])[12:] == struct.pack('<Iq6d', 1, 5, 1, 2, 3, 4, 5, 6)
    assert body_of(protocol.pack_pose(TrackedPose(3, 1, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0)))
                   ) == struct.pack('<qI7d', 3, 1, 1, 2, 3, 0, 0, 0, 1)


@pytest.mark.parametrize(('data', 'said'), [
    (b'hello, world', 'does the program print to its standard output'),
    (b'LRSP\x02\x00\x06\x00' + bytes(4), 'version 2 of the protocol'),
    (b'LRSP\x01\x00\x09\x00' + bytes(4), 'kind 9, 0 bytes'),
    (b'LRSP\x01\x00\x06\x00\xff\xff\xff\xff', '4294967295 bytes: not a message'),
    (protocol.packed(protocol.POSE, b'abc')[:-1], 'ends after 2 of 3 bytes'),
])
def test_what_is_no_message_is_named(data: bytes, said: str) -> None:
    with pytest.raises(SlamError, match=said):
        protocol.read_message(io.BytesIO(data))


@pytest.mark.parametrize(('read', 'body', 'said'), [
    (protocol.pose_of, bytes(5), '5 bytes'),
    (protocol.pose_of, struct.pack('<qI7d', 1, 7, *[0] * 7), 'state 7'),
    (protocol.pose_of, struct.pack('<qI7d', 1, 1, *[0] * 7), 'no position and unit quaternion'),
    (protocol.pose_of, struct.pack('<qI7d', 1, 1, np.nan, *[0] * 5, 1), 'no position and unit'),
    (protocol.frames_of, struct.pack('<qIII', 1, 4, 3, 2) + bytes(12), '2 images of 4x3 do not'),
    (protocol.frames_of, b'', '0 bytes'),
    (protocol.imu_of, struct.pack('<I', 2), '2 samples do not fit'),
    (protocol.settings_of, b'[1]', 'not a JSON object'),
    (protocol.settings_of, b'{', 'not JSON'),
])
def test_what_does_not_fit_is_named(read, body: bytes, said: str) -> None:
    with pytest.raises(SlamError, match=said):
        read(body)


def test_a_frame_without_a_pose_is_initialising_or_lost() -> None:
    assert answer(1, None, False).state == protocol.INITIALISING
    assert answer(1, None, True).state == protocol.LOST
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    assert np.abs(answer(1, turned, True).wxyz) == pytest.approx([0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(('fault', 'said'), [
    ('crash', 'crashed with SIGABRT at the frame of 0.000 s'), ('leave', 'ended with status 3 at'),
    ('silent', 'no answer for 0.5 s at the frame'), ('print', 'print to its standard output'),
    ('wrong', 'no such frame was asked'), ('never_ready', 'not ready within 0.7 s')])
def test_a_program_that_misbehaves_is_named(fault: str, said: str, tmp_path: Path) -> None:
    (tmp_path / 'program.py').write_text(PROGRAM)
    program = SlamProgram([sys.executable, str(tmp_path / 'program.py'), '2', fault], {},
                          0.7 if fault == 'never_ready' else LIMIT_S,
                          0.5 if fault == 'silent' else LIMIT_S)
    try:
        with pytest.raises(SlamError, match=said) as error:
            answers = feed(program, range(1, 3))
            assert [a.position_m[0] for a in answers] == [1.0, 0.0]
            feed(program, range(3, 5))
        assert str(error.value).startswith(sys.executable)
    finally:
        program.close()


@pytest.mark.parametrize(('frames', 'said'), [
    (range(0), 'crashed with SIGKILL before its first frame'),
    (range(1_500_000_000, 1_500_000_001), 'crashed with SIGKILL after the frame of 1.500 s')])
def test_a_program_that_is_killed_between_frames_is_told_from_one_that_never_was_ready(
        frames: range, said: str, tmp_path: Path) -> None:
    (tmp_path / 'program.py').write_text(PROGRAM)
    program = SlamProgram([sys.executable, str(tmp_path / 'program.py'), '9', 'none'], {}, 20.0,
                          20.0)
    try:
        wait(program, lambda: program.is_ready)
        feed(program, frames)
        (child,) = [c for c in psutil.Process().children(recursive=True)
                    if str(tmp_path) in ' '.join(c.cmdline())]
        child.kill()
        with pytest.raises(SlamError, match=said):
            wait(program, lambda: False)
    finally:
        program.close()


def test_a_program_that_ends_at_once_was_never_ready() -> None:
    program = SlamProgram([sys.executable, '-c', 'pass'], {}, LIMIT_S, LIMIT_S)
    try:
        with pytest.raises(SlamError, match='ended with status 0 before it was ready'):
            wait(program, lambda: False)
    finally:
        program.close()


def test_what_a_program_has_started_ends_with_it(tmp_path: Path,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrapper that is a shell script does not know of the end of its program."""
    monkeypatch.setattr(slam_program, '_END_S', 0.5)
    (tmp_path / 'program.py').write_text(PROGRAM)
    wrapper = tmp_path / 'wrapper'
    wrapper.write_text(f'#!/bin/sh\nsleep 300 &\necho $! > {tmp_path}/pid\n'
                       f'{sys.executable} {tmp_path}/program.py 99 none\nwait\n')
    wrapper.chmod(0o755)
    program = SlamProgram([str(wrapper)], {}, LIMIT_S, LIMIT_S)
    try:
        feed(program, range(1, 2))
        child = psutil.Process(int((tmp_path / 'pid').read_text()))
    finally:
        program.close()
    psutil.wait_procs([child], 5.0)
    assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE


@pytest.mark.skipif(shutil.which('g++') is None, reason='no C++ compiler')
def test_the_adapter_of_orb_slam3_speaks_the_protocol(tmp_path: Path) -> None:
    """Compiled against a stand-in for the interface of ORB-SLAM3, which prints."""
    adapter = tmp_path / 'adapter'
    subprocess.run(['g++', '-std=c++14', '-Wall', '-Wextra', '-Werror', '-I', str(STUB),
                    str(ADAPTER), '-o', str(adapter)], check=True, timeout=LIMIT_S)
    stamps = range(2_000_000_001, 12_000_000_001, 1_500_000_000)
    program = SlamProgram([str(adapter), 'voc.txt', 'orb.yaml', 'stereo-inertial'], {}, LIMIT_S,
                          LIMIT_S)
    try:
        answers = feed(program, stamps, imu=True)
    finally:
        program.close()
    # The stand-in has its IMU initialised at the third frame: up to it, the frame may be another.
    # It gives its map up at the fifth. After it, too, a frame must have been turned before.
    assert [a.state for a in answers] == (
        [protocol.INITIALISING] * 3 + [protocol.TRACKING, protocol.LOST, protocol.LOST,
                                       protocol.TRACKING])
    assert [a.stamp_ns for a in answers] == list(stamps)
    assert answers[3].position_m == pytest.approx((4.0, 22.0, 6.5))
    assert answers[3].wxyz == (1.0, 0.0, 0.0, 0.0)
    program = SlamProgram([str(adapter), 'voc.txt', 'orb.yaml', 'stereo'], {}, LIMIT_S, LIMIT_S)
    try:
        assert [a.state for a in feed(program, range(1, 3))] == [protocol.INITIALISING,
                                                                 protocol.TRACKING]
        with pytest.raises(SlamError, match='ended with status 1 at the frame of 0.000 s'):
            feed(program, range(1, 2), (LEFT,))
    finally:
        program.close()


KINDS = {topic.name: topic.type for topic in topics.CONTRACT}


@pytest.mark.parametrize('package', live.WRAPPERS)
@pytest.mark.parametrize('sensor', live.SENSORS)
def test_topics_are_those_of_the_graph(package: str, sensor: str) -> None:
    chosen = live.wrapper(package, sensor)
    ours = [ours for _, ours in chosen.remappings]
    ours += [str(value) for name, value in chosen.parameters if name.endswith('_topic_name')]
    kinds = sorted(KINDS[name] for name in ours)
    images = ['sensor_msgs/msg/Image'] * (1 if sensor == 'mono' else 2)
    assert kinds == images + ['sensor_msgs/msg/Imu'] * (sensor == 'stereo-inertial')
    assert len(set(ours)) == len(ours)
    if sensor != 'mono':   # left is left
        pairs = [*chosen.remappings, *chosen.parameters]
        sides = {str(v): str(k) for k, v in pairs if 'stereo/' in str(v)}
        assert 'left' in sides[topics.LEFT_IMAGE.name]
        assert 'right' in sides[topics.RIGHT_IMAGE.name]
    assert sensor in SENSORS


def test_unknown_names() -> None:
    with pytest.raises(SlamError, match="wrapper: 'orbslam' is not valid.*orbslam3"):
        live.wrapper('orbslam', 'stereo')
    with pytest.raises(SlamError, match="sensor: 'rgbd' is not valid"):
        live.wrapper('orbslam3', 'rgbd')
