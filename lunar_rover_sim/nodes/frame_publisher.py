"""What render_node publishes of a frame, and what has to be drawn for it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header

from lunar_rover_sim import topics
from lunar_rover_sim.camera.compression import compressed
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.frames import Array
from lunar_rover_sim.nodes import image_conversions, qos
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.nodes.vision_conversions import detections, vision_messages
from lunar_rover_sim.rendering import layer_pictures
from lunar_rover_sim.run.node_config import RenderNodeConfig
from lunar_rover_sim.sequences.instances import instances
from lunar_rover_sim.stereo.points import grey, points_from_depth
from lunar_rover_sim.stereo.sgm import SgmMatcher

_BOTH = ('left', 'right')
_NORMALS = ('normal', 'right_normal')
_FULL_FLOW_PX, _FULL_FLOW_M = 32.0, 0.1     # whose colour is full; a choice, see `topics`
# Topic → the layers of the renderer that it shows or is computed from. CameraInfos are published
# last: they tell that the images of the frame are out.
_LAYERS: dict[str, tuple[str, ...]] = {
    topics.LEFT_IMAGE.name: ('left',), topics.RIGHT_IMAGE.name: ('right',),
    topics.TRUE_DEPTH.name: ('depth',), topics.LEFT_COMPRESSED.name: ('left',),
    topics.RIGHT_COMPRESSED.name: ('right',), topics.DISPARITY.name: _BOTH,
    topics.DEPTH.name: _BOTH, topics.POINTS.name: _BOTH, topics.DEPTH_INFO.name: (),
    topics.LABELS.name: ('label',), topics.CRATERS.name: ('crater',),
    topics.SHADOW.name: ('shadow',), topics.NORMALS.name: ('normal',),
    topics.OPTICAL_FLOW.name: ('optical_flow',), topics.SCENE_FLOW.name: ('scene_flow',),
    **{topic.name: (layer,) for topic, layer in zip(topics.OF_RIGHT, (
        'right_depth', 'right_label', 'right_crater', 'right_shadow', 'right_normal'))},
    topics.NORMALS_COLOUR.name: ('normal',), topics.RIGHT_NORMALS_COLOUR.name: ('right_normal',),
    topics.FLOW_COLOUR.name: ('optical_flow',), topics.SCENE_FLOW_COLOUR.name: ('scene_flow',),
    topics.BOXES.name: ('label', 'crater'),
    topics.LEFT_INFO.name: (), topics.RIGHT_INFO.name: ()}
_TOPICS = {topic.name: topic for topic in topics.CONTRACT if topic.name in _LAYERS}
_INFOS = (topics.LEFT_INFO.name, topics.RIGHT_INFO.name, topics.DEPTH_INFO.name)
# Published for every frame, read or not: time may wait for them.
_ALWAYS = (topics.LEFT_INFO.name, topics.RIGHT_INFO.name)
_COMPRESSED = (topics.LEFT_COMPRESSED.name, topics.RIGHT_COMPRESSED.name)
_COLOURS: dict[str, Callable[[NDArray[np.float32]], NDArray[np.uint8]]] = {
    topics.NORMALS_COLOUR.name: layer_pictures.normal_picture,
    topics.RIGHT_NORMALS_COLOUR.name: layer_pictures.normal_picture,
    topics.FLOW_COLOUR.name: lambda flow: layer_pictures.flow_picture(flow, _FULL_FLOW_PX),
    topics.SCENE_FLOW_COLOUR.name: lambda flow: layer_pictures.flow_picture(flow, _FULL_FLOW_M)}
_MATCHED = (topics.DISPARITY.name, topics.DEPTH.name, topics.POINTS.name)
_DERIVED = (*_COMPRESSED, *_COLOURS, *_MATCHED)
# Those of every n-th frame.
_DEPTH = tuple(name for name, topic in _TOPICS.items() if topic.rate == topics.DEPTH_FRAME)


class FramePublisher:
    """Publishes a frame; matching, compression and colours, which take long, in a thread.

    on_reader: called when the readers of a topic change
    on_derived: called from the thread when all of a frame has been published
    """

    def __init__(self, node: Node, config: RenderNodeConfig, rig: StereoRig,
                 on_reader: Callable[[], None], on_derived: Callable[[], None]) -> None:
        self._rig = rig
        self._matcher = SgmMatcher(config.sgm, rig)
        self._on_derived = on_derived
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._derived: Future[None] | None = None
        events = PublisherEventCallbacks(matched=lambda _: on_reader())
        self._vision = vision_messages()
        self._publishers: dict[str, Publisher] = {
            name: node.create_publisher(message_class(topic.type), name, qos.offered(topic),
                                        event_callbacks=events)
            for name, topic in _TOPICS.items()
            if self._vision is not None or topic not in topics.OF_VISION}
        if self._vision is None:
            node.get_logger().info('vision_msgs is not installed: '
                                   f'{topics.BOXES.name} is not published')
        self.configure(config)

    def configure(self, config: RenderNodeConfig) -> None:
        """Use changed live parameters: those of compression and points."""
        self._points_step = config.stereo.points2.step_px
        self._compression = dict(zip(_COMPRESSED, (config.stereo.left.image_raw.compressed,
                                                   config.stereo.right.image_raw.compressed)))

    def close(self) -> None:
        """Finish the thread's work under way."""
        self._thread.shutdown(wait=True)

    @property
    def publishers(self) -> list[Publisher]:
        """All of them."""
        return list(self._publishers.values())

    def is_read(self, name: str) -> bool:
        """Return whether a topic has subscribers."""
        publisher = self._publishers.get(name)
        return publisher is not None and publisher.get_subscription_count() > 0

    def wanted(self, published: Collection[str], with_depth: bool) -> list[str]:
        """Return the topics that are to be published of a frame, without those that were."""
        return [name for name in _LAYERS if name not in published
                and (with_depth or name not in _DEPTH)
                and (name in _ALWAYS or self.is_read(name))]

    @staticmethod
    def layers_of(names: Collection[str]) -> set[str]:
        """Return the layers that topics need, names of `rendering.frame`."""
        return {layer for name in names for layer in _LAYERS[name]}

    def publish(self, names: Collection[str], layers: Mapping[str, Any], stamp: Time,
                R_world_camera: Array) -> None:
        """Publish topics of one frame from its layers.

        R_world_camera: (3, 3) axes of both optical frames, in which normals are published
        Raises what the thread raised on the frame before.
        """
        layers = {layer: pixels @ R_world_camera.astype(np.float32) if layer in _NORMALS
                  else pixels for layer, pixels in layers.items()}
        for name in names:
            frame_id = _TOPICS[name].frame_id
            if name in _INFOS:
                right = name == topics.RIGHT_INFO.name
                self._send(name, image_conversions.camera_info(
                    self._rig, frame_id, self._rig.P_right if right else self._rig.P_left, stamp))
            elif name == topics.BOXES.name:
                self._send(name, self._boxes(layers, Header(stamp=stamp, frame_id=frame_id)))
            elif name not in _DERIVED:
                self._send(name, image_conversions.image(layers[_LAYERS[name][0]], frame_id,
                                                         stamp))
        derived = [name for name in names if name in _DERIVED]
        if derived:
            self.raise_error(wait=True)
            self._derived = self._thread.submit(
                self._derive, derived, {layer: layers[layer] for layer in self.layers_of(derived)},
                stamp)
            self._derived.add_done_callback(lambda _: self._on_derived())

    def raise_error(self, wait: bool = False) -> None:
        """Raise what the thread raised, if it is done or `wait` is given."""
        derived = self._derived
        if derived is not None and (wait or derived.done()):
            self._derived = None
            derived.result()

    def _boxes(self, layers: Mapping[str, Any], header: Header) -> Any:
        assert self._vision is not None
        return detections(self._vision, instances(layers['label'], layers['crater']), header)

    def _send(self, name: str, msg: Any) -> None:
        self._publishers[name].publish(msg)

    def _derive(self, names: list[str], layers: dict[str, NDArray[Any]], stamp: Time) -> None:
        """Compute topics from images and publish them; runs in the thread."""
        for name in names:
            if name in _COMPRESSED:
                pixels = layers[_LAYERS[name][0]]
                self._send(name, image_conversions.compressed_image(
                    *compressed(pixels, self._compression[name]), _TOPICS[name].frame_id, stamp))
            elif name in _COLOURS:
                picture = _COLOURS[name](layers[_LAYERS[name][0]])
                self._send(name, image_conversions.image(picture[..., ::-1],
                                                         _TOPICS[name].frame_id, stamp))
        if not any(name in _MATCHED for name in names):
            return
        disparity = self._matcher.match(layers['left'], layers['right'])
        if topics.DISPARITY.name in names:
            self._send(topics.DISPARITY.name, image_conversions.disparity_image(
                disparity, self._rig.focal_px, self._rig.baseline_m, topics.DISPARITY.frame_id,
                stamp))
        depth = disparity.depth_m
        if topics.DEPTH.name in names:
            self._send(topics.DEPTH.name,
                       image_conversions.image(depth, topics.DEPTH.frame_id, stamp))
        if topics.POINTS.name in names:
            step = self._points_step
            self._send(topics.POINTS.name, image_conversions.point_cloud(
                points_from_depth(depth, self._rig.K)[::step, ::step],
                grey(layers['left'])[::step, ::step], topics.POINTS.frame_id, stamp))
