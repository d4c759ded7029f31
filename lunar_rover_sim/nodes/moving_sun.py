"""The sun of render_node: it moves with simulated time, and its direction is published."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.sun_of_date import SunPath
from lunar_rover_sim.image.rendering.drawn_window import WorldLight
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.nodes import conversions, qos
from lunar_rover_sim.run.node_config import RenderNodeConfig


class MovingSun:
    """Moves the sun of a renderer, step by step.

    In lockstep a frame waits for the light of its step. In real time that is computed beside the
    drawing, which takes seconds, and frames keep the earlier light until it is ready.
    """

    def __init__(self, node: Node, config: RenderNodeConfig, renderer: Renderer) -> None:
        """Publish the direction of the start; config: with the sun of its date."""
        self._renderer, self._path, self._lockstep = renderer, SunPath(config.sun), config.lockstep
        self._frame_id = topics.SUN.frame(config.separate_truth)
        self._publisher = qos.publisher(node, topics.SUN)
        self._pool = ThreadPoolExecutor(1)
        self._coming: Future[WorldLight] | None = None
        # Steps of the path, and its number: parameters may give another one.
        self._drawn = self._announced = self._coming_step = (0, 0)
        self._number = 0
        self._publish(0)

    def follow(self, sun: SunConfig, stamp_ns: int) -> None:
        """Show another sun, one without a date, from a stamp on."""
        self._path, self._number = SunPath(sun), self._number + 1
        self._publish(0, stamp_ns)

    def _step(self, stamp_ns: int) -> tuple[int, int]:
        return self._number, self._path.step(stamp_ns)

    def announce(self, stamp_ns: int) -> None:
        """Publish the direction at a stamp, if it is that of another step."""
        if self._step(stamp_ns) != self._announced:
            self._publish(self._path.step(stamp_ns))

    def resume(self, time_ns: int) -> None:
        """Go on at a time [ns], with the light that the frames before it had."""
        self.announce(time_ns)
        self.light(time_ns)

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether `light` will move the sun; no frame may be under way then."""
        if self._coming is not None and self._coming.done():
            return True
        return self._lockstep and self._step(stamp_ns) != self._drawn

    def light(self, stamp_ns: int) -> None:
        """Give a frame that is about to be drawn its light."""
        step = self._step(stamp_ns)
        if self._coming is not None and self._coming.done():
            self._renderer.show_sun(self._coming.result())
            self._drawn, self._coming = self._coming_step, None
        if step == self._drawn or self._coming is not None:
            return
        sun = self._path.of_step(step[1])
        if self._lockstep:
            self._renderer.show_sun(self._renderer.light_of(sun))
            self._drawn = step
        else:
            self._coming = self._pool.submit(self._renderer.light_of, sun)
            self._coming_step = step

    def close(self) -> None:
        """Wait for what is being computed."""
        self._pool.shutdown(cancel_futures=True)

    def _publish(self, step: int, stamp_ns: int | None = None) -> None:
        """Publish the direction of a step, stamped with the time from which it holds."""
        self._announced, sun = (self._number, step), self._path.of_step(step)
        stamp_ns = self._path.start_ns(step) if stamp_ns is None else stamp_ns
        message = Vector3Stamped()
        message.header.frame_id = self._frame_id
        message.header.stamp = conversions.time_msg(stamp_ns)
        conversions.set_vector(message.vector,
                               sun_direction(sun.azimuth_deg, sun.elevation_deg))
        self._publisher.publish(message)
