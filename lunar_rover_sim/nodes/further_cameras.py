"""The cameras of render_node besides the stereo pair."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.publisher import Publisher

from lunar_rover_sim.nodes.chase_publisher import ChasePublisher
from lunar_rover_sim.nodes.hazard_publisher import HazardPublisher, publish_frames
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.node_config import RenderNodeConfig


class FurtherCameras:
    """Draws and publishes the chase camera, where it is enabled, and hazard cameras."""

    def __init__(self, node: Node, config: RenderNodeConfig, renderer: Renderer,
                 on_reader: Callable[[], None]) -> None:
        """on_reader: called when the readers of a topic change."""
        self._cameras: list[ChasePublisher | HazardPublisher] = [
            HazardPublisher(node, name, config, renderer, on_reader) for name in config.hazard]
        if config.chase.enabled:
            self._cameras.append(ChasePublisher(node, config, renderer, on_reader))
        publish_frames(node, config.hazard)

    @property
    def publishers(self) -> list[Publisher]:
        """Those of all cameras."""
        return [publisher for camera in self._cameras for publisher in camera.publishers]

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether `draw` has something to do for a stamp."""
        return any(camera.is_due(stamp_ns) for camera in self._cameras)

    def draw(self, stamp_ns: int, state: RoverPose) -> None:
        """Draw and publish what is due and read, before a frame is begun in the renderer."""
        for camera in self._cameras:
            camera.draw(stamp_ns, state)
