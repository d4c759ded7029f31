"""drive_node: follows a velocity profile or waypoints on odometry."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from lunar_rover_sim.autonomy.path_following.driver import DONE, Driver, STOPPED
from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.files.state_file import attributes, restore_attributes
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import DriveNodeConfig


class DriveNode(node_main.GraphNode):
    """Answers the odometry of every command period with a velocity that bears its stamp."""

    def __init__(self) -> None:
        super().__init__('drive_node')
        self._config = config = declare(self, DriveNodeConfig)
        half_extent_m = np.inf
        if config.world:
            # physics_node and render_node verify the files of the world.
            half_extent_m = Site.of(load_world(config.world, verify=False)).half_extent_m
        self._driver = Driver(config, half_extent_m)
        self._period_ns = NS_PER_S // config.rate_hz
        self._no_period = self._last_period = 0 if config.lockstep else -1
        self._jump = TimeJump(self)
        self._status = ''
        self._held: list[bytes] = []
        qos.subscription(self, config.truth, self._odom_callback, config.lockstep, raw=True)
        stamped = config.enable_stamped_cmd_vel
        # After what it reads: who sees it may send the first state.
        self._publisher = self.create_publisher(TwistStamped if stamped else Twist,
                                                topics.CMD_VEL.name, qos.offered(topics.CMD_VEL))
        publishers = [self._publisher]
        if config.end_after_s >= 0.0:
            self._end = qos.publisher(self, topics.NAVIGATED)
            publishers.append(self._end)
        # In lockstep the first command is held until everybody reads it.
        self._matching = ReaderDiscovery(self, publishers,
                                         config.participants if config.lockstep else ())
        self.report_ready(config, waits=(config.truth.name,))

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        return not self._held and self._last_period >= begun.time_ns // self._period_ns

    def state(self) -> dict[str, Any]:
        """See `GraphNode`."""
        return {'driver': self._driver.state(), **attributes(self, '_last_period', '_status')}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._driver.resume(state.pop('driver'))
        restore_attributes(self, state)
        self._jump.resume(time_ns)

    # Raw: one message in ten is used, and deserialising odometry takes 50 us.
    def _odom_callback(self, raw: bytes) -> None:
        now_ns = stamp_ns(topics.ODOM.type, raw)
        if now_ns is None:
            return
        if self._jump.has_occurred(now_ns):
            self._held.clear()
            self._last_period = self._no_period
            self._driver.reset()
        if now_ns // self._period_ns <= self._last_period:
            return
        self._last_period = now_ns // self._period_ns
        self._held.append(raw)
        self.work()

    def work(self) -> None:
        """Answer the odometry held so far, if the readers of the answers are matched."""
        while self._held and self._matching.is_complete:
            self._answer(self._held.pop(0))

    def _answer(self, raw: bytes) -> None:
        odom = deserialize_message(raw, Odometry)
        T_world_base = conversions.pose_of(odom)
        now_ns = time_ns(odom.header.stamp)
        command = self._driver.update(now_ns, T_world_base[:3, 3],
                                      frames.wxyz_from_matrix(T_world_base[:3, :3]))
        if command.status != self._status:
            self._status = command.status
            text = f'{command.status} at {now_ns / 1e9:.2f} s'
            if command.status == STOPPED:
                self.get_logger().warning(f'{text}: {command.reason}')
            else:
                self.get_logger().info(f'{text}: {command.reason}' if command.reason else text)
            if command.status in (DONE, STOPPED) and (end_ns := self._config.end_ns(now_ns)) > 0:
                self._end.publish(Header(stamp=conversions.time_msg(end_ns)))
        velocity = command.forward_mps, command.yaw_rate_radps
        if self._config.enable_stamped_cmd_vel:
            self._publisher.publish(conversions.twist_stamped(*velocity, odom.header.stamp))
        else:
            self._publisher.publish(conversions.twist(*velocity))
