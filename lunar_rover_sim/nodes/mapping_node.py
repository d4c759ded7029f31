"""mapping_node: depth and poses to a rolling map of heights, and of what the rover can cross."""

from __future__ import annotations

from collections import deque
import dataclasses
from typing import Any

import numpy as np

from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.autonomy.navigation.traversability import (Limits, traversability,
                                                                Traversability)
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.nodes import conversions, map_conversions, node_main, qos
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.pose_source import PoseSource
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.mounts import lidar_pose
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import DEPTH_TOPICS, LIDAR, MappingNodeConfig, STEREO


class MappingNode(node_main.GraphNode):
    """Answers every depth image or scan with a map that bears its stamp.

    Without a pose at that stamp the map stays as it was, and says so by its `map_load_time`. In
    real time the newest depth wins.
    """

    def __init__(self) -> None:
        super().__init__('mapping_node')
        self._config = config = declare(self, MappingNodeConfig)
        rover = load_rover(config.rover or None)
        self._rig = StereoRig(rover, config.camera)
        self._T_base_sensor = (lidar_pose(rover) if config.depth == LIDAR
                               else self._rig.T_base_left)
        # Of true depth and of a LiDAR the error does not grow with the range.
        self._baseline_m = self._rig.baseline_m if config.depth == STEREO else 0.0
        self._limits = Limits.of(rover, config.limits)
        self._map = ElevationMap(config.map.by_pose(config.pose))
        self._newest: Traversability | None = None
        self._pending: deque[Any] = deque()
        self._elevation_ns = round(config.elevation_period_s * 1e9)
        self._sent_period = -1
        self._is_blind = False
        self._poses = PoseSource(self, config, config.pose, rover, self.wake, self._restart)
        depth = DEPTH_TOPICS[config.depth]
        qos.subscription(self, depth, self._depth_callback, config.lockstep)
        self._traversability = qos.publisher(self, topics.TRAVERSABILITY)
        self._elevation = qos.publisher(self, topics.ELEVATION)
        self._matching = ReaderDiscovery(self, [self._traversability, self._elevation],
                                         config.participants if config.lockstep else ())
        self.report_ready(config, f'{config.map.cells} x {config.map.cells} cells of '
                          f'{config.map.cell_m:g} m, steps up to {self._limits.step_m:.3f} m',
                          (depth.name, *self._poses.waits))

    def _restart(self) -> None:
        self._pending.clear()
        self._map.clear()
        self._newest, self._sent_period, self._is_blind = None, -1, False

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        return not self._pending and self._poses.is_at_rest(begun.time_ns)

    def state(self) -> dict[str, Any]:
        """See `GraphNode`."""
        return {'map': self._map.state(), 'poses': self._poses.state(),
                **attributes(self, '_newest', '_sent_period', '_is_blind')}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._map.resume(state.pop('map'))
        self._poses.resume(time_ns, state.pop('poses'))
        restore_attributes(self, state)

    def _depth_callback(self, msg: Any) -> None:
        if not self._config.lockstep:
            self._pending.clear()
        self._pending.append(msg)
        self.wake()

    def work(self) -> None:
        """Map the depth whose pose is known, or known to be missing."""
        while self._pending and self._matching.is_complete \
                and self._poses.answered_ns >= header_ns(self._pending[0]):
            self._answer(self._pending.popleft())

    def _answer(self, msg: Any) -> None:
        stamp = header_ns(msg)
        T = self._poses.at(stamp)
        if T is None or not np.isfinite(T).all():
            if not self._is_blind:
                self.get_logger().warning(f'no pose at {stamp / 1e9:.3f} s: the map stays as it '
                                          'is')
            self._is_blind = True
        else:
            self._is_blind = False
            jumped = self._poses.has_jumped(stamp)
            if jumped:
                self._map.clear()
            if self._take_in(stamp, msg, T) or jumped:
                self.get_logger().warning(f'the pose has jumped at {stamp / 1e9:.3f} s: the map '
                                          'is begun anew')
            self._newest = None if not self._map.has_seen else traversability(
                self._map.elevation(), self._limits, self._config.limits.fill_cells, T[:2, 3])
        self._publish(stamp)

    def _take_in(self, stamp: int, msg: Any, T_world_base: Array) -> bool:
        position = T_world_base[:3, 3]
        T = T_world_base @ self._T_base_sensor
        if self._config.depth == LIDAR:
            points = np.frombuffer(msg.data, np.uint8).reshape(-1, msg.point_step)
            return self._map.add_points(stamp, points[:, :12].copy().view('<f4'), T, position)
        depth = np.frombuffer(msg.data, '<f4').reshape(msg.height, msg.width)
        return self._map.add_depth(stamp, depth, self._rig.K, self._baseline_m, T, position)

    def _publish(self, stamp_ns: int) -> None:
        stamp, frame_id = conversions.time_msg(stamp_ns), self._poses.frame_id
        grid = self._newest
        if grid is None:
            # The answer lets time go on; nothing is known yet.
            n = self._config.map.cells
            grid = Traversability(0, np.full(2, -0.5 * self._config.map.size_m),
                                  self._config.map.cell_m, np.full((n, n), -1, np.int8))
            grid = dataclasses.replace(grid, stamp_ns=1)
        self._traversability.publish(map_conversions.occupancy_grid(grid, frame_id, stamp))
        if self._newest is None or stamp_ns // self._elevation_ns == self._sent_period:
            return
        self._sent_period = stamp_ns // self._elevation_ns
        elevation = self._map.elevation()
        self._elevation.publish(map_conversions.elevation_cloud(elevation, frame_id, stamp))
