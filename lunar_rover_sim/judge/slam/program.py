"""A SLAM program as a child process: messages to its standard input, poses from its output."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import reduce
from pathlib import Path
import queue
import subprocess
import threading
import time
from typing import Any

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.paths import program_path
from lunar_rover_sim.judge.slam import protocol
from lunar_rover_sim.judge.slam.protocol import FrameSet, TrackedPose
from lunar_rover_sim.products.sequences.orbslam3_settings import settings
from lunar_rover_sim.products.sequences.sensors import SensorSuite
from lunar_rover_sim.run.child_process import (dies_with_parent, end_group, executable,
                                               program_words, signal_name)

# In resource/: what a Python with the wheel `pyorbslam3` runs as ORB-SLAM3.
WHEEL_PROGRAM = 'orb_slam3/wheel.py'
_END_S = 5.0        # for the program to end by itself
_HUNG_S = 0.3
_JOIN_S = 2.0


class SlamProgram:
    """Starts a program; frames are sent one at a time, and `check` names what goes wrong.

    Its standard error stays that of this process.

    Args:
        command: Program and its arguments.
        settings: Of the sensors, see docs/reference/slam_protocol.md.
        ready_s, answer_s: Longest wall time until it is ready, and until it answers a frame [s].
        on_news: Called from a thread when something has come from the program.

    Raises:
        ProcessError: If it cannot be started.
    """

    def __init__(self, command: Sequence[str], settings: Mapping[str, Any], ready_s: float,
                 answer_s: float, on_news: Callable[[], None] = lambda: None) -> None:
        self._name = command[0]
        self._ready_s, self._answer_s = ready_s, answer_s
        self._on_news = on_news
        self.is_ready = False
        self._under_way: tuple[int, float] | None = None    # stamp [ns], wall time [s]
        self._answered_ns: int | None = None                # stamp of the last frame
        self._since_s = time.monotonic()
        self._problem = ''
        self._has_ended = False
        self._answers: deque[tuple[TrackedPose, float]] = deque()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        words = [str(executable(command[0])), *command[1:]]
        self._process = subprocess.Popen(dies_with_parent(words), stdin=subprocess.PIPE,
                                         stdout=subprocess.PIPE, start_new_session=True)
        self._threads = [threading.Thread(target=target, daemon=True)
                         for target in (self._write, self._read)]
        for thread in self._threads:
            thread.start()
        self._outgoing.put(protocol.pack_settings(settings))

    @property
    def is_busy(self) -> bool:
        """Whether it is not ready yet, or has a frame without an answer."""
        return not self.is_ready or self._under_way is not None

    def send_imu(self, samples: Sequence[tuple[int, Sequence[float], Sequence[float]]]) -> None:
        """Send samples of the IMU: those up to the frame that is sent next."""
        self._outgoing.put(protocol.pack_imu(samples))

    def send(self, frames: FrameSet) -> None:
        """Send a frame; only while the program is not busy."""
        self._under_way = frames.stamp_ns, time.monotonic()
        self._outgoing.put(protocol.pack_frames(frames))

    def take(self) -> tuple[TrackedPose, float] | None:
        """Return the next answer, and how long it took [s]; None if there is none."""
        return self._answers.popleft() if self._answers else None

    def check(self) -> None:
        """Raise SlamError, naming the program, if it has ended, is silent, or wrote nonsense."""
        under_way = self._under_way
        at = f' at the frame of {under_way[0] / 1e9:.3f} s' if under_way else ''
        if self._problem:
            raise SlamError(f'{self._name}: {self._problem}{at}')
        if self._has_ended:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)     # its output has ended, it is about to follow
            status = self._process.poll()
            how = ('closed its output' if status is None else f'ended with status {status}'
                   if status >= 0 else f'crashed with {signal_name(-status)}')
            raise SlamError(f'{self._name}: {how}{at or self._since()}')
        now_s = time.monotonic()
        if not self.is_ready and now_s - self._since_s > self._ready_s:
            raise SlamError(f'{self._name}: not ready within {self._ready_s:g} s')
        if under_way is not None and now_s - under_way[1] > self._answer_s:
            raise SlamError(f'{self._name}: no answer for {self._answer_s:g} s{at}')

    def _since(self) -> str:
        if self._answered_ns is not None:
            return f' after the frame of {self._answered_ns / 1e9:.3f} s'
        return ' before its first frame' if self.is_ready else ' before it was ready'

    def close(self) -> None:
        """Tell the program the end, give it some seconds, and kill what is left."""
        self._on_news = lambda: None
        # A program that does not answer is not expected to end by itself.
        grace_s = _HUNG_S if self._problem or self._under_way is not None else _END_S
        self._outgoing.put(protocol.packed(protocol.END))
        self._outgoing.put(None)
        try:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(grace_s)
        finally:
            end_group(self._process, 0.0)       # with what it has started
            for thread in self._threads:
                thread.join(_JOIN_S)

    def _write(self) -> None:
        assert self._process.stdin is not None
        # A program that has ended closes the pipe; the reader notices it too, and reports it.
        with suppress(BrokenPipeError), self._process.stdin as pipe:
            while (message := self._outgoing.get()) is not None:
                pipe.write(message)
                pipe.flush()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            try:
                while (message := protocol.read_message(pipe)) is not None:  # type: ignore
                    self._take(message)
                    self._on_news()
            except SlamError as error:
                self._problem = str(error)
        self._has_ended = True
        self._on_news()

    def _take(self, message: protocol.Message) -> None:
        if message.kind == protocol.READY:
            self.is_ready = True
            return
        if message.kind != protocol.POSE:
            raise SlamError(f'message of kind {message.kind} is not valid; valid are ready, pose')
        pose = protocol.pose_of(message.body)
        if self._under_way is None or pose.stamp_ns != self._under_way[0]:
            raise SlamError(f'an answer to {pose.stamp_ns / 1e9:.3f} s; no such frame was asked')
        self._answers.append((pose, time.monotonic() - self._under_way[1]))
        self._answered_ns = pose.stamp_ns
        self._under_way = None


def command_words(command: str, suite: SensorSuite, sensor: str, folder: Path) -> list[str]:
    """Return a program and its arguments.

    Args:
        command: {settings} is the settings file of ORB-SLAM3, written here, {wheel} the packaged
            program for a Python that has ORB-SLAM3 as a wheel.
        sensor: mono, stereo or stereo-inertial.
        folder: Gets the settings file.

    Raises:
        ConfigError: If the command is empty or no line of a shell.
    """
    words = program_words(command)
    path = folder / 'settings.yaml'
    path.write_text(settings(suite, sensor), encoding='ascii')
    fields = {'{settings}': str(path)}
    if '{wheel}' in command:
        fields['{wheel}'] = str(program_path(WHEEL_PROGRAM))
    return [reduce(lambda text, field: text.replace(*field), fields.items(), word)
            for word in words]


def program_settings(suite: SensorSuite, sensor: str, lockstep: bool) -> dict[str, Any]:
    """Return the settings that a program gets, see docs/reference/slam_protocol.md."""
    (fx, fy), (cx, cy), noise = suite.focal_px, suite.centre_px, suite.noise
    return {'sensor': sensor, 'lockstep': lockstep, 'width': suite.width,
            'height': suite.height, 'fx': fx, 'fy': fy, 'cx': cx, 'cy': cy,
            'distortion': list(suite.distortion), 'baseline_m': suite.baseline_m,
            'gravity_mps2': suite.gravity_mps2,
            'frame_rate_hz': suite.frame_rate_hz, 'imu_rate_hz': suite.imu_rate_hz,
            'T_imu_left': suite.T_imu_left.tolist(),
            'gyro_noise_density': noise.gyro_noise_density,
            'accel_noise_density': noise.accel_noise_density,
            'gyro_bias_random_walk': noise.gyro_bias_random_walk,
            'accel_bias_random_walk': noise.accel_bias_random_walk}
