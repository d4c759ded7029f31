"""The sun of a date and the ground move during a run, in pictures and topics alike."""

from collections.abc import Callable
from pathlib import Path
import threading
from types import SimpleNamespace
from typing import Any

from conftest import PLAIN, SMALL
import numpy as np
from physics_scene import make_world, same, simulate, trot
import pytest
from waiting import LIMIT_S, wait_until

from lunar_rover_sim.bag.messages import pose_matrix
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.image.illumination.sun_of_date import SunPath
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.recording import record
from lunar_rover_sim.run.scenario import Scenario

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from rclpy.serialization import serialize_message  # noqa: E402  (needs rclpy)

from lunar_rover_sim.nodes.ground_listener import GroundListener  # noqa: E402
from lunar_rover_sim.nodes.moving_sun import MovingSun  # noqa: E402
from lunar_rover_sim.nodes.state_publisher import GroundPublisher  # noqa: E402

SKY = ('render_node.sun.date=2026-11-28T00:00:00Z', 'render_node.sun.site.source=given',
       'render_node.sun.site.lat_deg=-85', 'render_node.sun.rate=50000',
       'render_node.sun.step_deg=2.0', 'render_node.sensor.exposure_mode=sunlit',
       'physics_node.sun_sensor.enabled=false',
       'run.nodes=[physics_node,render_node,recorder_node]',
       'recorder_node.topics=[all,sun_sensor/direction]')


def test_a_run_in_lockstep(tmp_path: Path) -> None:
    """A second of the run is 14 h of the sky: after 0.28 s each the sun is 2 deg further.

    The end lies between two frames with depth.
    """
    result = record(Scenario.load('flat', [*SMALL, *PLAIN, *SKY], duration_s=0.7),
                    tmp_path / 'run')
    assert not check(result.bag).failed
    render = result.scenario.render_node
    path = SunPath(render.sun)

    def direction(stamp_ns: int) -> np.ndarray:
        sun = path.of_step(path.step(stamp_ns))
        return sun_direction(sun.azimuth_deg, sun.elevation_deg)

    with open_bag(result.bag) as bag:
        suns = [(ns, m.vector) for _, ns, m in bag.messages(['/sun'])]
        odometry = {ns: pose_matrix(m) for _, ns, m in bag.messages(['/odom'])}
        sensed = [(ns, m.vector) for _, ns, m in bag.messages(['/sun_sensor/direction'])]
        images = {ns: np.frombuffer(m.data.tobytes(), np.uint8).reshape(m.height, m.width)
                  for _, ns, m in bag.messages(['/stereo/left/image_raw'])}
        joints = {ns: m.position[:4] for _, ns, m in bag.messages(['/joint_states'])}
    assert [ns for ns, _ in suns] == [path.start_ns(k) for k in range(3)]
    for ns, v in suns:
        np.testing.assert_allclose([v.x, v.y, v.z], direction(ns), atol=1e-12)
    for ns, v in sensed:    # what a place sees of the disc is not quite its middle
        np.testing.assert_allclose(odometry[ns][:3, :3] @ [v.x, v.y, v.z], direction(ns),
                                   atol=2e-4)
    assert len(sensed) >= 2
    # The last picture has the light of the last step; noise and legs aside.
    last = max(images)
    state = RoverPose(odometry[last], joint_angle_rad=np.asarray(joints[last]))
    with result.scenario.renderer() as renderer:
        drawn = []
        for step in (0, path.step(last)):
            if step:
                renderer.show_sun(renderer.light_of(path.of_step(step)))
            drawn.append(renderer.render(state, last // render.frame_period_ns, ('left',)).left)
    apart = [np.abs(images[last].astype(float) - image).mean() for image in drawn]
    assert path.step(last) == 2 and apart[1] < 0.2 * apart[0] and apart[0] > 1.0


class SlowLight:
    """Computes light when it is told to; shown: what a renderer was given."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.shown: list[Any] = []

    def light_of(self, sun: Any) -> Any:
        assert self.go.wait(LIMIT_S)
        return sun

    def show_sun(self, light: Any) -> None:
        self.shown.append(light)


def test_in_real_time_no_frame_waits_for_the_light() -> None:
    """Frames keep the light of before while the next one is computed, however long that takes."""
    render = resolve(Scenario.load('flat', [*SKY, '/**.time_mode=real_time'])).render_node
    path, renderer = SunPath(render.sun), SlowLight()
    node: Any = SimpleNamespace(create_publisher=lambda *_: SimpleNamespace(
        publish=lambda message: None))
    sun = MovingSun(node, render, renderer)  # type: ignore[arg-type]
    try:
        # Frames over four steps of the sun, which must be back before there is any new light.
        for stamp_ns in range(0, path.start_ns(4), render.frame_period_ns):
            assert not sun.is_due(stamp_ns)
            sun.light(stamp_ns)
        assert not renderer.shown
        renderer.go.set()
        wait_until(lambda: sun.is_due(path.start_ns(4)))
        sun.light(path.start_ns(4))
        assert renderer.shown == [path.of_step(1)]
        # Then comes the light of now, not that of all steps in between.
        wait_until(lambda: sun.is_due(path.start_ns(4)))
        sun.light(path.start_ns(4))
        assert renderer.shown == [path.of_step(1), path.of_step(4)]
    finally:
        renderer.go.set()
        sun.close()


pytest.importorskip('rclpy')

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


def test_a_restart_takes_the_ground_back_for_readers_too() -> None:
    """The tracks of the first pass are gone: in physics, and where the ground is drawn."""
    world, bus = make_world(), Bus()
    listener = GroundListener(bus, lambda: None)  # type: ignore[arg-type]
    with simulate(world, ground=SOFT) as simulation:
        overlay = simulation.overlay
        assert overlay is not None
        publisher = GroundPublisher(bus, overlay, lambda: world.ground,  # type: ignore[arg-type]
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
        publisher = GroundPublisher(bus, simulation.overlay, lambda: world.ground,  # type: ignore
                                    PERIOD_NS, 'odom')
        start = simulation.overlay.snapshot()
        trot(simulation, 1.0)
        publisher.publish(PERIOD_NS)
        simulation.reset()
        publisher.publish(2 * PERIOD_NS)
        listener.advance(2 * PERIOD_NS)
    assert same(listener.overlay.snapshot(), start)
