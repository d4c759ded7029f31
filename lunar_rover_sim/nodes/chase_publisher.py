"""The pictures of the chase camera, drawn while somebody reads them."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from lunar_rover_sim import topics
from lunar_rover_sim.camera.chase import ChaseMount
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.node_config import RenderNodeConfig


class ChasePublisher:
    """Draws and publishes the chase camera.

    publishers: those of image, CameraInfo and pose
    on_reader: called when the readers of a topic change
    """

    def __init__(self, node: Node, config: RenderNodeConfig, renderer: Renderer,
                 on_reader: Callable[[], None]) -> None:
        self._period_ns, self._frame_period_ns = config.chase_period_ns, config.frame_period_ns
        self._mount = ChaseMount(config.chase, config.sun.azimuth_deg, renderer.world)
        self._camera = renderer.add_camera(config.chase, self._mount)
        # The first one is that of the first whole period, as with frames.
        self._period: int | None = 0 if config.lockstep else None
        self._world_frame = topics.CHASE_POSE.frame(config.separate_truth)
        events = PublisherEventCallbacks(matched=lambda _: on_reader())
        self._image, self._info, self._pose = self.publishers = [
            node.create_publisher(kind, topic.name, qos.offered(topic), event_callbacks=events)
            for kind, topic in ((Image, topics.CHASE_IMAGE), (CameraInfo, topics.CHASE_INFO),
                                (PoseStamped, topics.CHASE_POSE))]

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether `draw` has something to do for a stamp."""
        return stamp_ns // self._period_ns != self._period and any(
            publisher.get_subscription_count() for publisher in self.publishers)

    def draw(self, stamp_ns: int, state: RoverPose) -> None:
        """Draw and publish a frame, if one is due and read.

        Call it before the frame is begun in the renderer, with the ground as it is at the stamp.
        """
        if not self.is_due(stamp_ns):
            return
        self._period = stamp_ns // self._period_ns
        self._mount.follow(state, stamp_ns)
        stamp = conversions.time_msg(stamp_ns)
        if self._image.get_subscription_count():
            pixels = self._camera.render(state, stamp_ns // self._frame_period_ns).left
            assert pixels is not None
            self._image.publish(image_conversions.image(pixels, topics.CHASE_IMAGE.frame_id,
                                                        stamp))
        camera = self._camera.camera
        self._info.publish(image_conversions.camera_info(camera, topics.CHASE_INFO.frame_id,
                                                         camera.P_left, stamp))
        self._pose.publish(conversions.pose_stamped(self._mount.T_world_camera,
                                                    self._world_frame, stamp))
