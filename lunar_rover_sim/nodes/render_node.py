"""render_node: pose and joint angles to stereo images, true depth, SGM disparity and depth."""

from __future__ import annotations

import collections
from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from lunar_rover_sim import topics
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.errors import ConfigError, GraphError
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.run.node_config import RenderNodeConfig
from lunar_rover_sim.stereo.depth import depth_from_disparity
from lunar_rover_sim.stereo.sgm import SgmMatcher
from lunar_rover_sim.world.world_folder import load_world

_INFOS = (topics.LEFT_INFO.name, topics.RIGHT_INFO.name)
_MATCHED = (topics.DISPARITY.name, topics.DEPTH.name)
# Topic → what of the renderer it shows or is made from. CameraInfos come last: they say that the
# frame is done.
_LAYERS: dict[str, tuple[str, ...]] = {
    topics.LEFT_IMAGE.name: ('left',), topics.RIGHT_IMAGE.name: ('right',),
    topics.TRUE_DEPTH.name: ('depth',), topics.DISPARITY.name: ('left', 'right'),
    topics.DEPTH.name: ('left', 'right'), **dict.fromkeys(_INFOS, ())}
_TOPICS = tuple(topic for topic in topics.CONTRACT if topic.name in _LAYERS)
_FRAME_IDS = {topic.name: topic.frame_id for topic in _TOPICS}


@dataclasses.dataclass
class _Shown:
    """A frame: the state it shows, what was drawn of it, and what was published."""

    stamp_ns: int
    T_world_base: NDArray[np.float64]
    joint_angle_rad: NDArray[np.float64]
    layers: dict[str, Any] = dataclasses.field(default_factory=dict)
    published: set[str] = dataclasses.field(default_factory=set)


class RenderNode(node_main.GraphNode):
    """Draws the newest odometry of every frame period, for the topics that somebody reads.

    Callbacks only keep what comes. In lockstep the next frame is begun while one is drawn, if its
    state has come. Matching runs in a thread of its own beside the drawing.
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
        self._shown: _Shown | None = None
        self._following: _Shown | None = None
        self._look_again = False
        self._awaited = list(config.await_readers)

        self._publishers_by_topic = {
            topic.name: self.create_publisher(message_class(topic.type), topic.name,
                                              qos.offered(topic))
            for topic in _TOPICS}
        self._publish_sun()
        self.create_subscription(String, topics.WORLD_HASH.name, self._world_hash_callback,
                                 qos.requested(topics.WORLD_HASH, config.lockstep))
        self.create_subscription(JointState, topics.JOINT_STATES.name, self._joints_callback,
                                 qos.requested(topics.JOINT_STATES, config.lockstep), raw=True)
        self.create_subscription(Odometry, topics.ODOM.name, self._odom_callback,
                                 qos.requested(topics.ODOM, config.lockstep), raw=True)
        self.create_timer(0.05, self._look_for_readers)     # that appear after a frame was drawn

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
        else:
            self.wake()
        self._joints[stamp] = raw

    def _odom_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        period = -1 if stamp is None else stamp // self._config.frame_period_ns
        if stamp is None or period == self._last_period:
            return
        self._last_period = period
        if not self._config.lockstep:
            self._poses.clear()
        self._poses.append((stamp, raw))
        self.wake()

    # Output

    def work(self) -> None:
        """Draw the next frame that is due, or what new readers want of the present one."""
        shown, self._following = self._following or self._take(), None
        if shown is None and self._look_again:
            shown = self._shown
        self._look_again = False
        if shown is None:
            return
        self._shown = shown
        self._draw(shown)
        if self._following or self._poses:
            self.wake()

    def _take(self) -> _Shown | None:
        """Take the next frame, if all that it needs has come."""
        if not self._poses:
            return None
        lockstep = self._config.lockstep
        stamp, raw = self._poses[0]
        if lockstep and (stamp not in self._joints or not self._readers_are_there()):
            return None  # the legs of this pose, or who is to read it, are still on their way
        self._poses.popleft()
        joints_raw = self._joints.pop(stamp, None) if lockstep else \
            next(iter(self._joints.values()), None)
        angles = np.zeros(4) if joints_raw is None else conversions.legs_of(
            deserialize_message(joints_raw, JointState), 'position')
        return _Shown(stamp, conversions.pose_of(deserialize_message(raw, Odometry)), angles)

    def _next_state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the state of the next frame, if it has come, for the renderer to begin."""
        while rclpy.ok() and self.serve():
            pass
        if self._following is None:
            self._following = self._take()
        if self._following is None:
            return None
        return self._following.T_world_base, self._following.joint_angle_rad

    def _readers_are_there(self) -> bool:
        while self._awaited and self._is_read(self._awaited[-1]):
            self._awaited.pop()
        return not self._awaited

    def _is_read(self, name: str) -> bool:
        return self._publishers_by_topic[name].get_subscription_count() > 0

    def _look_for_readers(self) -> None:
        self._look_again = True
        self.wake()

    def _draw(self, shown: _Shown) -> None:
        """Draw and publish what is read of this frame and was not published yet."""
        wanted = [name for name in _LAYERS if name not in shown.published
                  and (name in _INFOS or self._is_read(name))]
        if not wanted:
            return
        layers = {layer for name in wanted for layer in _LAYERS[name]} - set(shown.layers)
        if layers:
            frame = self._renderer.render(
                shown.T_world_base, shown.joint_angle_rad,
                shown.stamp_ns // self._config.frame_period_ns, layers,
                # In real time the newest state counts when its turn comes.
                then=self._next_state if self._config.lockstep else None)
            drawn = {'left': frame.left, 'right': frame.right, 'depth': frame.depth_m}
            shown.layers.update((name, drawn[name]) for name in layers)
        stamp = conversions.time_msg(shown.stamp_ns)
        for name in wanted:
            if name in _INFOS:
                left = name == topics.LEFT_INFO.name
                self._send(name, conversions.camera_info(
                    self._rig, _FRAME_IDS[name],
                    self._rig.P_left if left else self._rig.P_right, stamp))
            elif name not in _MATCHED:
                self._send(name, conversions.image(shown.layers[_LAYERS[name][0]],
                                                   _FRAME_IDS[name], stamp))
        matched = [name for name in wanted if name in _MATCHED]
        if matched:
            self._match(shown.layers['left'], shown.layers['right'], matched, stamp)
        shown.published.update(wanted)

    def _send(self, name: str, msg: Any) -> None:
        self._publishers_by_topic[name].publish(msg)

    def _match(self, left: Any, right: Any, names: list[str], stamp: Time) -> None:
        if self._matching is not None:
            self._matching.result()
        self._matching = self._thread.submit(self._match_and_publish, left, right, names, stamp)

    def _match_and_publish(self, left: Any, right: Any, names: list[str], stamp: Time) -> None:
        disparity = self._matcher.match(left, right)
        focal_px, baseline_m = float(self._rig.K[0, 0]), self._rig.baseline_m
        if topics.DISPARITY.name in names:
            self._send(topics.DISPARITY.name, conversions.disparity_image(
                disparity, focal_px, baseline_m, topics.DISPARITY.frame_id, stamp))
        if topics.DEPTH.name in names:
            self._send(topics.DEPTH.name, conversions.image(
                depth_from_disparity(disparity, focal_px, baseline_m), topics.DEPTH.frame_id,
                stamp))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return node_main.run(RenderNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
