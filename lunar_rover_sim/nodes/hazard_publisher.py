"""The pictures of a hazard camera, drawn while somebody reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher

from lunar_rover_sim import topics
from lunar_rover_sim.camera.hazard import fixed_frames, HazardMount, sides
from lunar_rover_sim.camera.hazard_config import HazardConfig
from lunar_rover_sim.camera.models import geometry_of
from lunar_rover_sim.errors import RenderError
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.rendering.frame import StereoFrame
from lunar_rover_sim.rendering.renderer import FurtherCamera, Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.node_config import RenderNodeConfig
from lunar_rover_sim.seconds import NS_PER_S

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

# Layers of the topics of a camera, left and right, in the order of `topics.OF_HAZARD`.
_LAYERS = (('left', '', 'label', 'crater', 'depth'),
           ('right', '', 'right_label', 'right_crater', 'right_depth'))


class _Output(NamedTuple):
    """A topic of a camera (0 left or the only one, 1 right); layer: '' of its CameraInfo."""

    topic: topics.Topic
    side: int
    layer: str
    publisher: Publisher


class HazardPublisher:
    """Draws and publishes a hazard camera, or a pair. It is made when it is first read.

    publishers: those of images, CameraInfos and truth
    on_reader: called when the readers of a topic change
    """

    def __init__(self, node: Node, name: str, config: RenderNodeConfig, renderer: Renderer,
                 on_reader: Callable[[], None]) -> None:
        self._name, self._config, self._renderer = name, config.hazard[name], renderer
        self._period_ns = NS_PER_S // self._config.rate_hz
        self._frame_period_ns = config.frame_period_ns
        # Its noise does not depend on which camera is read first.
        self._seed = int(np.random.SeedSequence(
            [config.seed, *name.encode()]).generate_state(1)[0]) >> 1
        self._geometry = geometry_of(self._config)
        self._camera: FurtherCamera | None = None
        # In lockstep the first one is that of the first whole period, as with frames.
        self._stamp_ns = 0 if config.lockstep else -self._period_ns
        self._published: set[_Output] = set()
        events = PublisherEventCallbacks(matched=lambda _: on_reader())
        self._outputs = [
            _Output(topic, side, layer, node.create_publisher(
                message_class(topic.type), topic.name, qos.offered(topic), event_callbacks=events))
            for side, camera in enumerate(sides(name, self._config))
            for topic, layer in zip(topics.hazard(camera), _LAYERS[side])]

    @property
    def publishers(self) -> list[Publisher]:
        """All of them."""
        return [output.publisher for output in self._outputs]

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether `draw` has something to do for a stamp."""
        return bool(self._wanted(stamp_ns))

    def draw(self, stamp_ns: int, state: RoverPose) -> None:
        """Draw and publish a frame, if one is due and read.

        Call it before the frame is begun in the renderer, with the ground as it is at the stamp.
        Raises RenderError, which names the camera.
        """
        wanted = self._wanted(stamp_ns)
        if not wanted:
            return
        if stamp_ns != self._stamp_ns:
            self._stamp_ns = stamp_ns
            self._published.clear()
        self._published.update(wanted)
        stamp = conversions.time_msg(stamp_ns)
        layers = [output.layer for output in wanted if output.layer]
        if layers:
            frame = self._render(state, stamp_ns // self._frame_period_ns, layers)
        for output in wanted:
            frame_id = output.topic.frame_id
            if output.layer:
                output.publisher.publish(image_conversions.image(
                    frame.layer(output.layer), frame_id, stamp))
            else:
                P = self._geometry.P_left.copy()
                P[0, 3] = -output.side * self._geometry.focal_px * self._config.stereo_baseline_m
                output.publisher.publish(image_conversions.camera_info(
                    self._geometry, frame_id, P, stamp))

    def _wanted(self, stamp_ns: int) -> list[_Output]:
        """Return what is due, read, and not published yet of this stamp."""
        published: set[_Output] = set()
        if stamp_ns == self._stamp_ns:      # somebody has come to read more of it
            published = self._published
        elif stamp_ns // self._period_ns == self._stamp_ns // self._period_ns:
            return []
        return [output for output in self._outputs
                if output not in published and output.publisher.get_subscription_count()]

    def _render(self, state: RoverPose, frame_index: int, layers: list[str]) -> StereoFrame:
        try:
            if self._camera is None:
                self._camera = self._renderer.add_camera(self._config, HazardMount(self._config),
                                                         self._seed)
            return self._camera.render(state, frame_index, layers)
        except RenderError as error:
            raise RenderError(f'hazard.{self._name}: {error}') from error


def publish_frames(node: Node, hazards: Mapping[str, HazardConfig]) -> None:
    """Publish the frames of hazard cameras on tf_static, where tf2_msgs is installed."""
    if TFMessage is None or not hazards:
        return
    zero = conversions.time_msg(0)
    node.create_publisher(TFMessage, topics.TF_STATIC.name, qos.offered(topics.TF_STATIC)).publish(
        TFMessage(transforms=[
            conversions.transform(parent, child, pose, zero) for name, config in hazards.items()
            for parent, child, pose in fixed_frames(name, config)]))
