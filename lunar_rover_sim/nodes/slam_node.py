"""slam_node: images to a SLAM program over pipes, or to the odometry with a memory; its poses."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
import functools
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image, Imu

from lunar_rover_sim.bag.message_validity import image_problem, pixels
from lunar_rover_sim.bag.messages import header_ns, time_ns, xyz
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.image.camera.encoding import eight_bits, ENCODINGS
from lunar_rover_sim.image.stereo.depth import grey
from lunar_rover_sim.judge.slam import protocol
from lunar_rover_sim.judge.slam.graph.anchor import Anchor, Doubt
from lunar_rover_sim.judge.slam.graph.in_process import GraphTracker
from lunar_rover_sim.judge.slam.graph.measured import AIDS
from lunar_rover_sim.judge.slam.program import command_words, program_settings, SlamProgram
from lunar_rover_sim.judge.slam.protocol import FrameSet
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.diagnostics import Diagnostics, Drops, OK, SubjectStatus, WARN
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.products.sequences.sensors import described_sensors
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.run.node_config import SlamNodeConfig
from lunar_rover_sim.run.transforms import tf_message

_MOST_UNPAIRED = 20
_RECENT = 20                # answers whose latency is in the diagnostics
_COMPILED_MPS2 = 9.81       # gravity in ORB-SLAM3


class SlamNode(node_main.GraphNode):
    """Hands one frame after the other to the program.

    In lockstep every frame is tracked, and `slam/status` with its stamp lets time go on. In real
    time the newest frame wins; those that come while the program is busy are counted as lost.
    """

    def __init__(self) -> None:
        super().__init__('slam_node')
        self._config = config = declare(self, SlamNodeConfig)
        self._sides = [topics.LEFT_IMAGE, *([topics.RIGHT_IMAGE] if config.is_stereo else [])]
        self._jump = TimeJump(self)
        self._open: dict[int, dict[str, Any]] = {}      # stamp → side → pixels
        self._waiting: deque[FrameSet] = deque()
        self._imu: deque[tuple[int, tuple[float, ...], tuple[float, ...]]] = deque()
        self._drops, self._state = Drops(), protocol.INITIALISING
        self._place = ''        # of the graph, on a map from orbit
        self._latencies_s: list[float] = []
        self._frames = [0] * len(protocol.STATES)       # answered, by their state
        if config.has_imu and abs(config.gravity_mps2 - _COMPILED_MPS2) > 0.1 \
                and '{wheel}' not in config.command:    # which is told of it
            self.get_logger().warning(
                f'gravity is {config.gravity_mps2:g} m/s^2: ORB-SLAM3 has {_COMPILED_MPS2:g} '
                'compiled in (GRAVITY_VALUE in ImuTypes.h), and finds a wrong scale'
                ' from the IMU unless it is built with the other value')
        suite = described_sensors(load_rover(config.rover or None), config.camera, config.imu,
                                  config.frame_rate_hz, config.imu_rate_hz, config.gravity_mps2)
        self._owned = ExitStack()
        self._graph = GraphTracker(suite, self.wake_later, self.get_logger().info, _anchor(config)
                                   ) if config.is_graph else None
        self._program = self._graph or SlamProgram(
            command_words(config.command, suite, config.sensor, Path(self._owned.enter_context(
                TemporaryDirectory(prefix='slam_node_')))),
            program_settings(suite, config.sensor, config.lockstep), config.ready_s,
            config.answer_s, self.wake_later)
        self._owned.callback(self._program.close)
        if self._graph is not None and self._graph.note:
            self.get_logger().warning(self._graph.note)
        # The publisher of the status is made when the program is ready: time waits for it.
        self._status: Publisher | None = None
        self._matching: ReaderDiscovery | None = None
        self._pose = qos.publisher(self, topics.SLAM_POSE)
        self._covariance = None
        if self._graph is not None and not self._graph.note:
            self._covariance = qos.publisher(self, topics.SLAM_COVARIANCE)
        self._tf = qos.publisher(self, topics.TF) if config.publish_tf else None
        for topic in self._sides:
            qos.subscription(self, topic, functools.partial(self._image_callback, topic.name),
                             config.lockstep)
        if config.has_imu:
            qos.subscription(self, topics.IMU_RAW, self._imu_callback, lockstep=True, light=True)
        for topic in AIDS if self._graph is not None else ():
            qos.subscription(self, topic, functools.partial(self._aid_callback, topic),
                             lockstep=True, light=True)
        Diagnostics(self, {'Tracking': self._tracking_status, 'Drops': self._drops.status})
        self.report_ready(config, waits=[topic.name for topic in self._sides])

    def close(self) -> None:
        """End the program, and say how it went."""
        self._owned.close()
        counts = ', '.join(f'{count} {state}'
                           for state, count in zip(protocol.STATES, self._frames))
        self.get_logger().info(f'{sum(self._frames)} frames answered: {counts}; '
                               f'{self._drops.total} left out; latency '
                               f'{_median_ms(self._latencies_s)} ms in the median')
        if self._graph is not None and self._graph.words:
            self.get_logger().info(self._graph.words)

    # Input

    def _image_callback(self, side: str, msg: Image) -> None:
        stamp = header_ns(msg)
        if side == topics.LEFT_IMAGE.name and self._jump.has_occurred(stamp):
            self._open.clear()
            self._waiting.clear()
            self._imu.clear()
            if self._graph is not None:
                raise GraphError('simulated time has gone back: the graph knows one drive; start '
                                 'slam_node anew')
        if msg.encoding not in ENCODINGS:
            raise GraphError(f'{side}: encoding {msg.encoding!r} is not valid for slam_node; '
                             f'valid are {", ".join(ENCODINGS)}')
        if problem := image_problem(msg):
            raise GraphError(f'{side}: {problem}')
        images = self._open.setdefault(stamp, {})
        images[side] = eight_bits(grey(pixels(msg)))
        if len(images) < len(self._sides):
            if len(self._open) > _MOST_UNPAIRED:
                del self._open[min(self._open)]
                self._drops.add('Frames without the other image')
            return
        del self._open[stamp]
        if not self._config.lockstep and self._waiting:
            self._drops.add('Frames', len(self._waiting))
            self._waiting.clear()
        self._waiting.append(FrameSet(stamp, tuple(images[t.name] for t in self._sides)))
        self.wake()

    def _imu_callback(self, msg: Imu) -> None:
        self._imu.append((header_ns(msg), xyz(msg.angular_velocity),
                          xyz(msg.linear_acceleration)))
        if self._waiting:
            self.wake()

    def _aid_callback(self, topic: topics.Topic, msg: Any) -> None:
        assert self._graph is not None
        self._graph.collected.add(topic, msg)
        if self._waiting:
            self.wake()

    # Output

    def work(self) -> None:
        """Publish what the program has answered, and give it the next frame."""
        while (taken := self._program.take()) is not None:
            self._publish(*taken)
        self._program.check()
        if self._program.is_busy:
            return
        if self._status is None:
            self._begin()
        assert self._matching is not None
        if self._waiting and self._matching.is_complete and self._has_all_until(
                self._waiting[0].stamp_ns):
            frames = self._waiting.popleft()
            if isinstance(self._program, SlamProgram) and self._config.has_imu:
                samples = []
                while self._imu and self._imu[0][0] <= frames.stamp_ns:
                    samples.append(self._imu.popleft())
                self._program.send_imu(samples)
            self._program.send(frames)

    def _begin(self) -> None:
        self._status = qos.publisher(self, topics.SLAM_STATUS)
        self._matching = ReaderDiscovery(
            self, [self._pose, self._status,
                   *([] if self._covariance is None else [self._covariance])],
            self._config.participants if self._config.lockstep else ())
        self.get_logger().info('the program is ready')

    def _has_all_until(self, stamp_ns: int) -> bool:
        if self._graph is not None:
            # In real time what has come must do: not all rovers have all of it.
            return not self._config.lockstep or self._graph.collected.has_until(stamp_ns)
        return not self._config.has_imu or bool(self._imu) and self._imu[-1][0] >= stamp_ns

    def _publish(self, pose: protocol.TrackedPose, latency_s: float) -> None:
        stamp = conversions.time_msg(pose.stamp_ns)
        self._state = pose.state
        self._frames[pose.state] += 1
        self._latencies_s.append(latency_s)
        if pose.state == protocol.TRACKING:
            T = se3(matrix_from_wxyz(pose.wxyz), pose.position_m)
            self._pose.publish(conversions.pose_stamped(T, self._config.frame_id, stamp))
            if self._covariance is not None and pose.covariance is not None:
                self._covariance.publish(conversions.pose_with_covariance(
                    T, pose.covariance, self._config.frame_id, stamp))
            if self._tf is not None:
                self._tf.publish(tf_message(
                    [(self._config.frame_id, self._config.child_frame_id, T)], pose.stamp_ns))
        # Without the latency, which is wall time: recordings in lockstep are repeatable.
        level = DiagnosticStatus.OK if pose.state == protocol.TRACKING else DiagnosticStatus.WARN
        self._place = pose.place
        array = DiagnosticArray(status=[DiagnosticStatus(
            level=level, name='slam', message=protocol.STATES[pose.state],
            values=[KeyValue(key=key, value=value) for key, value in
                    (('place', pose.place), ('news', pose.news)) if value])])
        array.header.stamp = stamp
        assert self._status is not None and time_ns(stamp) == pose.stamp_ns
        self._status.publish(array)

    def _tracking_status(self) -> SubjectStatus:
        state = protocol.STATES[self._state] if self._program.is_ready else 'not ready'
        place = {'Place on the map from orbit': self._place} if self._place else {}
        return SubjectStatus(OK if self._state == protocol.TRACKING else WARN, state,
                             {**place, 'Frames answered': str(sum(self._frames)),
                              'Frames tracked': str(self._frames[protocol.TRACKING]),
                              'Latency (ms)': _median_ms(self._latencies_s[-_RECENT:])})


def _anchor(config: SlamNodeConfig) -> Anchor | None:
    if not config.maps:
        return None
    return Anchor(OrbitalMap.load(Path(config.maps)),
                  Doubt((config.near_x_m, config.near_y_m), config.doubt_m))


def _median_ms(latencies_s: Sequence[float]) -> str:
    return f'{1e3 * float(np.median(latencies_s)):.1f}' if latencies_s else 'nan'
