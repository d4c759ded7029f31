"""Publishes what readers want of one camera of the list, the stereo pair or any other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header, String

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.files.state_file import attributes, attributes_but, restore_attributes
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.cameras import CameraEntry, Output
from lunar_rover_sim.image.camera.compression import compressed
from lunar_rover_sim.image.camera.fisheye import geometry_of
from lunar_rover_sim.image.camera.mosaic import shown
from lunar_rover_sim.image.camera.mount import BodyMount, Mount
from lunar_rover_sim.image.rendering import layer_pictures
from lunar_rover_sim.image.rendering.labels import class_names, instances, vocabulary
from lunar_rover_sim.image.rendering.renderer import FurtherCamera, Renderer
from lunar_rover_sim.image.stereo.depth import points_from_depth
from lunar_rover_sim.image.stereo.sgm import SgmMatcher
from lunar_rover_sim.nodes import conversions, image_conversions, qos
from lunar_rover_sim.nodes.image_conversions import (detections, label_info, vision_info,
                                                     vision_messages)
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.node_config import RenderNodeConfig

_SENSED = ('left', 'right')
EXPOSURE = 'exposure_s'     # beside the layers of a frame
_NORMALS = ('normal', 'right_normal')
_FULL_FLOW_PX, _FULL_FLOW_M = 32.0, 0.1     # whose colour is full; a choice, see `topics`
_COLOURS: dict[str, Callable[[NDArray[np.float32]], NDArray[np.uint8]]] = {
    topics.NORMALS_COLOUR.name: layer_pictures.normal_picture,
    topics.RIGHT_NORMALS_COLOUR.name: layer_pictures.normal_picture,
    topics.FLOW_COLOUR.name: lambda flow: layer_pictures.flow_picture(flow, _FULL_FLOW_PX),
    topics.SCENE_FLOW_COLOUR.name: lambda flow: layer_pictures.flow_picture(flow, _FULL_FLOW_M)}
_COMPRESSED = (topics.LEFT_COMPRESSED.name, topics.RIGHT_COMPRESSED.name)
_MATCHED = (topics.DISPARITY.name, topics.DEPTH.name, topics.POINTS.name)
_DERIVED = (*_COMPRESSED, *_COLOURS, *_MATCHED)
_INFO, _POSE = 'sensor_msgs/msg/CameraInfo', 'geometry_msgs/msg/PoseStamped'


class Periods:
    """The rule of when images are due: in the first frame of each of their periods.

    In lockstep the first one is that of the first whole period; in real time it is the first frame
    there is.
    """

    def __init__(self, periods_ns: Iterable[int], lockstep: bool) -> None:
        self._periods_ns, self._lockstep = frozenset(periods_ns), lockstep
        self.restart()

    def restart(self) -> None:
        """Forget all frames: time starts anew."""
        self._last = dict.fromkeys(self._periods_ns, 0 if self._lockstep else None)

    def state(self) -> dict[str, Any]:
        """Return the numbers of the present periods."""
        return attributes(self, '_last')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of the same periods."""
        restore_attributes(self, state)

    @property
    def has_begun(self) -> bool:
        """Whether a period is known."""
        return None not in self._last.values()

    def begun(self, stamp_ns: int) -> frozenset[int]:
        """Return the periods [ns] whose first frame is that of this stamp, the next in time."""
        now = {period: stamp_ns // period for period in self._periods_ns}
        last, self._last = self._last, {**now}
        return frozenset(period for period in now if now[period] != last[period])


class CameraPublisher:
    """Publishes one camera; matching, compression and colours, which take long, in a thread.

    A camera besides the pair has no GL objects before it is read for the first time.
    """

    def __init__(self, node: Node, entry: CameraEntry, config: RenderNodeConfig,
                 renderer: Renderer, on_reader: Callable[[], None],
                 on_derived: Callable[[], None]) -> None:
        """Advertise its topics.

        Args:
            node: Publishes them.
            config: Parameters of the node.
            renderer: Draws it.
            on_reader: Called when the readers of a topic change.
            on_derived: Called from the thread when all of a frame has been published.

        Raises:
            ConfigError: Where the camera cannot be in its place.
        """
        self.entry, self._renderer, self._config = entry, renderer, config
        self._encoding = entry.config.sensor.encoding
        rig = renderer.rig
        self._camera = rig if entry.mount is None else geometry_of(entry.config)
        self._baseline_m = rig.baseline_m if entry.baseline_m is None else entry.baseline_m
        self._mount: Mount = BodyMount(rig) if entry.mount is None else entry.mount(
            renderer.world, config.sun.azimuth_deg)
        self._drawn: FurtherCamera | None = None
        self._matcher = SgmMatcher(config.sgm, rig) if entry.mount is None else None
        self._on_derived = on_derived
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._derived: Future[None] | None = None
        self._vision = vision_messages()
        events = PublisherEventCallbacks(matched=lambda _: on_reader())
        self._outputs: dict[str, Output] = {
            output.topic.name: output for output in entry.outputs
            if self._vision is not None or output.topic not in topics.OF_VISION}
        self._publishers: dict[str, Publisher] = {
            name: qos.publisher(node, output.topic, event_callbacks=events)
            for name, output in self._outputs.items()}
        for output in entry.outputs:
            if output.topic.name not in self._outputs:
                node.get_logger().info('vision_msgs is not installed: '
                                       f'{output.topic.name} is not published')
        self.configure(config)

    def enter(self, world: World) -> None:
        """Be in another window of the site: the renderer has entered it."""
        self._mount.enter(world)

    def configure(self, config: RenderNodeConfig) -> None:
        """Use changed live parameters: those of compression, points, exposure and rates."""
        entry = next(one for one in config.cameras if one.name == self.entry.name)
        sensor = entry.config.sensor
        if sensor != self.entry.config.sensor:
            if entry.mount is None:
                self._renderer.expose(sensor)
            elif self._drawn is not None:
                self._drawn.drawn.expose(sensor)
        self.entry, self._config = entry, config
        self._outputs = {output.topic.name: output for output in entry.outputs
                         if output.topic.name in self._publishers}
        self._points_step = config.stereo.points2.step_px
        self._compression = dict(zip(_COMPRESSED, (config.stereo.left.image_raw.compressed,
                                                   config.stereo.right.image_raw.compressed)))

    def close(self) -> None:
        """Finish the thread's work under way."""
        self._thread.shutdown(wait=True)

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing is under way in the thread."""
        return self._derived is None or self._derived.done()

    def state(self) -> dict[str, Any]:
        """Return where its mount is and what its exposure goes on from, at rest."""
        if self.entry.mount is None:
            return {'exposure': self._renderer.exposure, 'mount': {}}
        return {'exposure': None if self._drawn is None else self._drawn.drawn.exposure,
                'mount': attributes_but(self._mount, '_config', '_world')}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of the same camera."""
        restore_attributes(self._mount, state['mount'])
        if self.entry.mount is None:
            self._renderer.exposure = state['exposure']
        elif state['exposure'] is not None:
            self._add()
            assert self._drawn is not None
            self._drawn.drawn.exposure = state['exposure']

    def _add(self) -> None:
        self._drawn = self._renderer.add_camera(
            self.entry.config, self._mount, self.entry.noise_seed(self._config.seed))

    @property
    def publishers(self) -> list[Publisher]:
        """All of them."""
        return list(self._publishers.values())

    def is_read(self, name: str) -> bool:
        """Return whether a topic has subscribers."""
        publisher = self._publishers.get(name)
        return publisher is not None and publisher.get_subscription_count() > 0

    def wanted(self, due: Collection[int], published: Collection[str]) -> list[str]:
        """Return the topics that are to be published of a frame.

        Args:
            due: Periods [ns] whose first frame it is.
            published: Topics of it that have been published.
        """
        return [name for name, output in self._outputs.items()
                if output.period_ns in due and name not in published
                and (output.always or self.is_read(name))]

    def layers_of(self, names: Collection[str]) -> set[str]:
        """Return the layers that topics need, names of `rendering.frame`."""
        return {layer for name in names for layer in self._outputs[name].layers}

    def draw(self, names: Collection[str], state: RoverPose, stamp_ns: int) -> None:
        """Draw a camera besides the pair, and publish topics of it.

        Call it before the frame is begun in the renderer, with the ground as it is at the stamp.

        Raises:
            RenderError: It names the camera.
        """
        assert self.entry.mount is not None
        self._mount.follow(state, stamp_ns)
        layers = self.layers_of(names)
        drawn = dict[str, Any]()
        if layers:
            try:
                if self._drawn is None:
                    self._add()
                    assert self._drawn is not None
                frame = self._drawn.render(state, stamp_ns // self._config.frame_period_ns, layers)
            except RenderError as error:
                raise RenderError(f'{self.entry.name}: {error}') from error
            drawn = {layer: frame.layer(layer) for layer in layers}
        self.publish(names, drawn, state, stamp_ns)

    def publish(self, names: Collection[str], layers: Mapping[str, Any], state: RoverPose,
                stamp_ns: int) -> None:
        """Publish topics of one frame from its layers, normals in axes of the optical frames.

        Raises what the thread raised on the frame before.
        """
        stamp, T_world_camera = conversions.time_msg(stamp_ns), self._mount.poses(state)[0]
        axes = T_world_camera[:3, :3].astype(np.float32)
        layers = {layer: pixels @ axes if layer in _NORMALS else pixels
                  for layer, pixels in layers.items()}
        for name in names:
            output = self._outputs[name]
            frame_id = output.topic.frame(self._config.separate_truth)
            if output.topic.type == _INFO:
                P = self._camera.P_left.copy()
                P[0, 3] = -output.side * self._camera.focal_px * self._baseline_m
                self._send(name, image_conversions.camera_info(self._camera, frame_id, P, stamp))
            elif output.topic.type == _POSE:
                self._send(name, conversions.pose_stamped(T_world_camera, frame_id, stamp))
            elif name == topics.BOXES.name:
                self._send(name, self._boxes(layers, Header(stamp=stamp, frame_id=frame_id)))
            elif name == topics.EXPOSURE.name:
                self._send(name, image_conversions.exposure(layers[EXPOSURE], frame_id, stamp))
            elif name not in _DERIVED:
                layer = output.layers[0]
                self._send(name, image_conversions.image(
                    layers[layer], frame_id, stamp, self._encoding if layer in _SENSED else ''))
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
        layers = {layer: shown(pixels, self._encoding) if layer in _SENSED else pixels
                  for layer, pixels in layers.items()}
        for name in names:
            output = self._outputs[name]
            if name in _COMPRESSED:
                self._send(name, image_conversions.compressed_image(
                    *compressed(layers[output.layers[0]], self._compression[name]),
                    output.topic.frame_id, stamp))
            elif name in _COLOURS:
                picture = _COLOURS[name](layers[output.layers[0]])
                self._send(name, image_conversions.image(picture[..., ::-1],
                                                         output.topic.frame_id, stamp))
        if self._matcher is None or not any(name in _MATCHED for name in names):
            return
        disparity = self._matcher.match(layers['left'], layers['right'])
        if topics.DISPARITY.name in names:
            self._send(topics.DISPARITY.name, image_conversions.disparity_image(
                disparity, self._camera.focal_px, self._baseline_m, topics.DISPARITY.frame_id,
                stamp))
        depth = disparity.depth_m
        if topics.DEPTH.name in names:
            self._send(topics.DEPTH.name,
                       image_conversions.image(depth, topics.DEPTH.frame_id, stamp))
        if topics.POINTS.name in names:
            step = self._points_step
            self._send(topics.POINTS.name, image_conversions.point_cloud(
                points_from_depth(depth, self._camera.K)[::step, ::step],
                self._matcher.rectified(layers['left'])[::step, ::step],
                topics.POINTS.frame_id, stamp))


class LabelPublisher:
    """Publishes the vocabulary of a window; it is as large as the catalogues of that.

    Where vision_msgs is installed, its LabelInfo and VisionInfo as well.
    """

    def __init__(self, node: Node, renderer: Renderer, legs: Sequence[str]) -> None:
        """Wait for readers.

        Args:
            renderer: Has the rocks and craters, and their numbers.
            legs: Names of those of the rover.
        """
        self._node = node
        self._publishers: dict[str, Any] = {}
        self._sent: dict[str, Callable[[], Any]] = {}
        self._offer(topics.LABEL_INFO, lambda: String(data=vocabulary(
            renderer.rocks, renderer.world.craters, renderer.world.hash, legs,
            renderer.rock_labels, renderer.crater_numbers)))
        msg = vision_messages()
        if msg is not None:
            header = Header(frame_id=topics.LABEL_CLASSES.frame_id)
            self._offer(topics.LABEL_CLASSES, lambda: label_info(msg, class_names(
                len(renderer.rocks), legs, renderer.rock_labels), header))
            self._offer(topics.VISION_INFO,
                        lambda: vision_info(msg, renderer.world.hash, header))

    def enter(self) -> None:
        """Publish what is read once more: the renderer has entered another window."""
        for name, make in self._sent.items():
            self._publishers[name].publish(make())

    def _offer(self, topic: topics.Topic, make: Callable[[], Any]) -> None:
        """Publish what `make` returns when a topic is first read."""
        def on_match(event: object) -> None:
            if topic.name not in self._sent and getattr(event, 'current_count') > 0:
                self._sent[topic.name] = make
                self._publishers[topic.name].publish(make())

        self._publishers[topic.name] = qos.publisher(
            self._node, topic, event_callbacks=PublisherEventCallbacks(matched=on_match))
