"""trajectory_recorder_node: the poses of an estimator to a TUM file for `evaluate`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.base.seconds import in_seconds
from lunar_rover_sim.judge.evaluation.trajectory_files import POSE_IN, poses_of
from lunar_rover_sim.nodes import node_main, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.run.node_config import TrajectoryRecorderNodeConfig

TOPIC = 'pose'
_DISCOVERY_S = 0.1


class TrajectoryRecorderNode(node_main.GraphNode):
    """Writes each pose on arrival. A Path repeats all poses: only the new ones are written."""

    def __init__(self) -> None:
        super().__init__('trajectory_recorder_node')
        self._config = config = declare(self, TrajectoryRecorderNodeConfig)
        if not config.output:
            raise ConfigError("output: '' is not valid; valid is a file that does not exist")
        try:
            self._file = open(Path(config.output), 'x', encoding='ascii')
        except FileExistsError:
            raise ConfigError(f'output: {config.output} exists already; name another file') \
                from None
        except OSError as error:
            raise ConfigError(f'output: {config.output}: {error.strerror}') from None
        self._newest_ns = -1
        self._count = 0
        self._jump = TimeJump(self)
        # A timer: rclpy reports new publishers only to a subscription, whose type must be known.
        self._timer = self.create_timer(_DISCOVERY_S, self._discover)
        self._discover()
        self.report_ready(config, waits=(TOPIC,))

    def close(self) -> None:
        """Close the file, which holds every pose received."""
        self._file.close()
        self.get_logger().info(f'{self._count} poses written to {self._config.output}')

    def _discover(self) -> None:
        """Subscribe with the publisher's type, or the one that a parameter names."""
        name = self.resolve_topic_name(TOPIC)
        infos = self.get_publishers_info_by_topic(name)
        type_name = self._config.type or (infos[0].topic_type if infos else '')
        if not type_name:
            return
        self._timer.cancel()
        if type_name not in POSE_IN:
            raise GraphError(f'{name}: type {type_name} holds no pose with a stamp; valid are '
                             + ', '.join(POSE_IN))
        self.create_subscription(message_class(type_name), TOPIC,
                                 lambda msg: self._write(poses_of(type_name, msg)),
                                 qos.adapted(infos, qos.STATE_DEPTH))

    def _begin_next_file(self) -> None:
        """Go on in FILE_2, FILE_3 ...: the stamps of a trajectory increase."""
        self._file.close()
        first = Path(self._config.output)
        number = 2
        while (path := first.with_stem(f'{first.stem}_{number}')).exists():
            number += 1
        self._file = open(path, 'x', encoding='ascii')
        self._newest_ns = -1

    def _write(self, poses: Iterable[tuple[int, Any, Any]]) -> None:
        """Write (stamp [ns], position, orientation)."""
        received = list(poses)
        # A Path repeats all poses: only its last one tells that time has gone back.
        if received and self._jump.has_occurred(received[-1][0]):
            self._begin_next_file()
        for stamp_ns, p, q in received:
            if stamp_ns <= self._newest_ns:
                continue
            self._newest_ns = stamp_ns
            numbers = ' '.join(repr(float(v)) for v in (p.x, p.y, p.z, q.x, q.y, q.z, q.w))
            self._file.write(f'{in_seconds(stamp_ns)} {numbers}\n')
            self._count += 1
        self._file.flush()
