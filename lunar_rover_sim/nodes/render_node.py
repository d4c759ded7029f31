"""render_node: pose and joint angles to stereo images, true depth, SGM disparity and depth."""

from __future__ import annotations

import collections
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from lunar_rover_sim import topics
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.camera.renderer import Renderer, StereoFrame
from lunar_rover_sim.config import RenderNodeConfig
from lunar_rover_sim.errors import ConfigError, GraphError
from lunar_rover_sim.nodes import conversions, main as node_main, qos
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.types import message_class
from lunar_rover_sim.rover.store import load_rover
from lunar_rover_sim.stereo.depth import depth_from_disparity
from lunar_rover_sim.stereo.sgm import SgmMatcher
from lunar_rover_sim.world.store import load as load_world

_DRAWN = (topics.LEFT_IMAGE, topics.RIGHT_IMAGE, topics.TRUE_DEPTH)
_MATCHED = (topics.DISPARITY, topics.DEPTH)
_INFOS = (topics.LEFT_INFO, topics.RIGHT_INFO)
_LAYERS = {topics.LEFT_IMAGE.name: 'left', topics.RIGHT_IMAGE.name: 'right',
           topics.TRUE_DEPTH.name: 'depth'}


class RenderNode(node_main.GraphNode):
    """Draws the newest odometry of every frame period, for the topics that somebody reads.

    Matching runs in a thread of its own beside the drawing of the next frame.
    """

    def __init__(self) -> None:
        super().__init__('render_node')
        self._config = config = declare(self, RenderNodeConfig)
        if not config.world:
            raise ConfigError("world: '' is not valid; valid is a folder made by "
                              '`lunar_rover_sim world build`')
        world = load_world(config.world)
        self._world_hash = world.hash
        self._renderer = Renderer(world, load_rover(config.rover or None), config, config.seed)
        self._rig = self._renderer.rig
        self._matcher = SgmMatcher(config.sgm)
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._matching: Future[None] | None = None

        # In lockstep the first frame is that of the first whole period; else any message is shown.
        self._last_period = 0 if config.lockstep else -1
        self._poses: collections.deque[tuple[int, bytes]] = collections.deque()
        self._joints: dict[int, bytes] = {}
        self._shown: tuple[int, Any, Any, set[str]] | None = None

        self._publishers_by_topic = {
            topic.name: self.create_publisher(message_class(topic.type), topic.name,
                                              qos.offered(topic))
            for topic in (*_DRAWN, *_MATCHED, *_INFOS)}
        self._publish_sun()
        self.create_subscription(String, topics.WORLD_HASH.name, self._world_hash_callback,
                                 qos.requested(topics.WORLD_HASH, config.lockstep))
        self.create_subscription(JointState, topics.JOINT_STATES.name, self._joints_callback,
                                 qos.requested(topics.JOINT_STATES, config.lockstep), raw=True)
        self.create_subscription(Odometry, topics.ODOM.name, self._odom_callback,
                                 qos.requested(topics.ODOM, config.lockstep), raw=True)
        self.create_timer(0.1, self._draw_missing)

    def destroy_node(self) -> None:
        """Finish the matching under way and release the GL context."""
        self._thread.shutdown(wait=True)
        self._renderer.close()
        super().destroy_node()

    def _publish_sun(self) -> None:
        msg = Vector3Stamped()
        msg.header.frame_id = topics.SUN.frame_id
        msg.vector.x, msg.vector.y, msg.vector.z = map(float, self._renderer.sun_direction)
        self._sun = self.create_publisher(Vector3Stamped, topics.SUN.name,
                                          qos.offered(topics.SUN))
        self._sun.publish(msg)

    # Input

    def _world_hash_callback(self, msg: String) -> None:
        if msg.data != self._world_hash:
            raise GraphError(f'world {self._config.world}: hash {self._world_hash[:12]} is not '
                             f'that of the physics, {msg.data[:12]}; give both nodes one world')

    def _joints_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.JOINT_STATES.type, raw)
        if stamp is None:
            return
        if not self._config.lockstep:
            self._joints.clear()
        elif stamp % self._config.frame_period_ns:
            return
        self._joints[stamp] = raw
        self._draw_due()

    def _odom_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        period = -1 if stamp is None else stamp // self._config.frame_period_ns
        if stamp is None or period == self._last_period:
            return
        self._last_period = period
        if not self._config.lockstep:
            self._poses.clear()
        self._poses.append((stamp, raw))
        self._draw_due()

    # Output

    def _draw_due(self) -> None:
        while self._poses:
            stamp, raw = self._poses[0]
            if self._config.lockstep and stamp not in self._joints:
                return  # the legs of this pose are still on their way
            self._poses.popleft()
            joints_raw = self._joints.pop(stamp, None) if self._config.lockstep else \
                next(iter(self._joints.values()), None)
            angles = np.zeros(4) if joints_raw is None else conversions.legs_of(
                deserialize_message(joints_raw, JointState), 'position')
            pose = conversions.pose_of(deserialize_message(raw, Odometry))
            self._shown = (stamp, pose, angles, set())
            self._draw()

    def _draw_missing(self) -> None:
        """Serve a reader that appeared after the present frame was drawn."""
        if self._shown is not None:
            self._draw()

    def _wanted(self, among: tuple[topics.Topic, ...]) -> list[str]:
        assert self._shown is not None
        return [t.name for t in among if t.name not in self._shown[3]
                and self._publishers_by_topic[t.name].get_subscription_count() > 0]

    def _draw(self) -> None:
        assert self._shown is not None
        stamp_ns_, pose, angles, done = self._shown
        drawn, matched = self._wanted(_DRAWN), self._wanted(_MATCHED)
        infos = [t.name for t in _INFOS if t.name not in done]
        layers = {_LAYERS[name] for name in drawn} | ({'left', 'right'} if matched else set())
        stamp = conversions.time_msg(stamp_ns_)
        if layers:
            frame = self._renderer.render(pose, angles, stamp_ns_ // self._config.frame_period_ns,
                                          layers)
            self._publish_drawn(frame, drawn, stamp)
            if matched:
                self._match(frame, matched, stamp)
        for name in infos:
            left = name == topics.LEFT_INFO.name
            self._publishers_by_topic[name].publish(conversions.camera_info(
                self._rig, _frame_id(name), self._rig.P_left if left else self._rig.P_right,
                stamp))
        done.update(drawn, matched, infos)

    def _publish_drawn(self, frame: StereoFrame, names: list[str], stamp: Time) -> None:
        pixels = {'left': frame.left, 'right': frame.right, 'depth': frame.depth_m}
        for name in names:
            layer = pixels[_LAYERS[name]]
            if layer is not None:
                self._publishers_by_topic[name].publish(
                    conversions.image(layer, _frame_id(name), stamp))

    def _match(self, frame: StereoFrame, names: list[str], stamp: Time) -> None:
        if self._matching is not None:
            self._matching.result()
        self._matching = self._thread.submit(self._match_and_publish, frame, names, stamp)

    def _match_and_publish(self, frame: StereoFrame, names: list[str], stamp: Time) -> None:
        if frame.left is None or frame.right is None:
            return
        disparity = self._matcher.match(frame.left, frame.right)
        focal_px, baseline_m = float(self._rig.K[0, 0]), self._rig.baseline_m
        if topics.DISPARITY.name in names:
            self._publishers_by_topic[topics.DISPARITY.name].publish(conversions.disparity_image(
                disparity, focal_px, baseline_m, topics.DISPARITY.frame_id, stamp))
        if topics.DEPTH.name in names:
            depth_m = depth_from_disparity(disparity, focal_px, baseline_m)
            self._publishers_by_topic[topics.DEPTH.name].publish(
                conversions.image(depth_m, topics.DEPTH.frame_id, stamp))


def _frame_id(name: str) -> str:
    return next(topic.frame_id for topic in topics.CONTRACT if topic.name == name)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(RenderNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
