"""Topics of the ground without a graph: changes, restart, frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from physics_scene import make_world, simulate, trot
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from rclpy.serialization import serialize_message  # noqa: E402  (needs rclpy)

from lunar_rover_sim import topics  # noqa: E402
from lunar_rover_sim.nodes.ground_listener import GroundListener  # noqa: E402
from lunar_rover_sim.nodes.ground_publisher import GroundPublisher  # noqa: E402
from lunar_rover_sim.regolith.config import GroundConfig  # noqa: E402

SOFT = GroundConfig(model='regolith')
PERIOD_NS = 100_000_000


class Bus:
    """A node whose subscriptions get at once what it publishes."""

    def __init__(self) -> None:
        self.sent: dict[str, list[Any]] = {}
        self.readers: dict[str, list[Callable[[bytes], None]]] = {}

    def create_publisher(self, kind: Any, topic: str, qos: Any, **options: Any) -> Any:
        """Return a publisher."""
        messages = self.sent.setdefault(topic, [])

        def publish(message: Any) -> None:
            messages.append(message)
            for callback in self.readers.get(topic, []):
                callback(serialize_message(message))

        return type('Publisher', (), {
            'publish': staticmethod(publish), 'get_subscription_count':
            staticmethod(lambda: len(self.readers.get(topic, [])))})

    def create_subscription(self, kind: Any, topic: str, callback: Callable[[bytes], None],
                            qos: Any, raw: bool) -> None:
        """Call back with serialised messages."""
        self.readers.setdefault(topic, []).append(callback)


def same(one: Any, other: Any) -> bool:
    """Return whether two snapshots are equal, samples at 0 left aside."""
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ('index', 'height_m', 'compaction_m'))


def test_a_restart_takes_the_ground_back_for_readers_too() -> None:
    """The tracks of the first pass are gone: in physics, and where the ground is drawn."""
    world, bus = make_world(), Bus()
    listener = GroundListener(bus, lambda: None)  # type: ignore[arg-type]
    with simulate(world, ground=SOFT) as simulation:
        overlay = simulation.overlay
        assert overlay is not None
        publisher = GroundPublisher(bus, overlay, world.ground,  # type: ignore[arg-type]
                                    PERIOD_NS, 'ground_truth/odom')
        start = overlay.snapshot()

        def drive() -> None:
            trot(simulation, 1.0, observe=lambda state: publisher.publish(
                round(state.stamp_ns / 5e6) * 5_000_000))
            listener.advance(10**9)
            assert same(listener.overlay.snapshot(), overlay.snapshot())
            assert len(overlay.snapshot()) > len(start) + 100

        drive()
        simulation.reset()
        publisher.restart()
        listener.advance(0)
        assert same(overlay.snapshot(), start) and same(listener.overlay.snapshot(), start)
        drive()
    frames = {m.header.frame_id for messages in bus.sent.values() for m in messages}
    assert frames == {'ground_truth/odom'}


def test_a_reset_in_the_run_takes_the_ground_back_by_changes() -> None:
    """Time goes on: there is no new snapshot, and what was trodden down comes back."""
    world, bus = make_world(), Bus()
    listener = GroundListener(bus, lambda: None)  # type: ignore[arg-type]
    with simulate(world, ground=SOFT) as simulation:
        assert simulation.overlay is not None
        publisher = GroundPublisher(bus, simulation.overlay, world.ground,  # type: ignore
                                    PERIOD_NS, 'odom')
        start = simulation.overlay.snapshot()
        trot(simulation, 1.0)
        publisher.publish(PERIOD_NS)
        simulation.reset()
        publisher.publish(2 * PERIOD_NS)
        listener.advance(2 * PERIOD_NS)
    assert same(listener.overlay.snapshot(), start)


def test_the_frames_of_what_is_true_stay_apart_from_an_estimator() -> None:
    """With `separate_truth` the frame `odom` belongs to it."""
    for topic in (topics.GROUND_CHANGES, topics.GROUND_SNAPSHOT, topics.SUN):
        assert (topic.frame(False), topic.frame(True)) == ('odom', 'ground_truth/odom')
    assert topics.ODOM.frame(True) == 'odom' and topics.IMU_RAW.frame(True) == 'imu_link'
