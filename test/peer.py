"""A plain rclpy program beside a node, as in somebody else's stack."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
import subprocess
import sys
import time
from typing import Any

from conftest import PLAIN
from nav_msgs.msg import Odometry
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.typesys import get_typestore, Stores
from waiting import LIMIT_S

from lunar_rover_sim.base import topics
from lunar_rover_sim.nodes.message_types import message_class
from lunar_rover_sim.run.ending import DONE

LEGS = [f'{leg}_joint' for leg in ('front_left', 'front_right', 'rear_left', 'rear_right')]
SMALL_CAMERA = ('-p', 'camera.width:=160', '-p', 'camera.height:=120', '-p',
                'sgm.num_disparities:=32', '-p', 'frame_rate_hz:=10')
# For images that nobody looks at: what relief below the grid looks like takes 2.5 s.
PLAIN_DETAIL = tuple(word for setting in PLAIN for word in (
    '-p', setting.removeprefix('render_node.').replace('=', ':=')))


def at_rest_odometry() -> Odometry:
    """Return a rover that stands level, 0.1 m above the origin."""
    odometry = Odometry()
    odometry.pose.pose.position.z = 0.1
    odometry.pose.pose.orientation.w = 1.0
    return odometry


class Peer:
    """A plain rclpy node with the default QoS of a script."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node('peer')

    def listen(self, kind: Any, topic: str, qos: Any = 10) -> list[Any]:
        """Return a list that fills with the messages of a topic."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def listen_tf(self, topic: str = 'tf', qos: Any = 10) -> list[Any]:
        """Return a list that fills with the transforms of a topic, as rosbags reads them."""
        received: list[Any] = []
        store = get_typestore(Stores.ROS2_JAZZY)

        def take(raw: bytes) -> None:
            message: Any = store.deserialize_cdr(raw, topics.TF.type)
            received.extend(message.transforms)

        self.node.create_subscription(message_class(topics.TF.type), topic, take, qos, raw=True)
        return received

    def echo(self, kind: Any, topic: str) -> list[Any]:
        """Listen as `ros2 topic echo` does: durable where all publishers are."""
        self.spin_until(lambda: self.node.count_publishers(topic) > 0)
        infos = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(topic))
        durable = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                      for info in infos)
        return self.listen(kind, topic, QoSProfile(
            depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL if durable
            else DurabilityPolicy.VOLATILE))

    def spin_until(self, condition: Callable[[], bool],
                   meanwhile: Callable[[], None] = lambda: None) -> None:
        """Spin until the condition holds; call `meanwhile` about 20 times a second."""
        deadline = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < deadline, 'nothing came'
            meanwhile()
            until = time.monotonic() + 0.05
            while time.monotonic() < until:
                rclpy.spin_once(self.node, timeout_sec=0.01)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(LIMIT_S)
        for _ in range(5):
            # A response is lost where the service has not yet discovered who asks.
            future = client.call_async(request)
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=6.0)
            if future.done():
                return future.result()
        raise AssertionError(f'{service} does not answer')


def node_command(name: str, *arguments: str) -> list[str]:
    """Return the command line of a node with ROS arguments."""
    return [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', name, '--ros-args',
            *arguments]


@contextmanager
def running(name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a node as `ros2 run` would, and end it with SIGINT."""
    process = subprocess.Popen(node_command(name, *arguments), stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT_S) in DONE
    finally:
        process.kill()
        process.communicate()


@contextmanager
def ended(name: str, *arguments: str) -> Iterator[list[str]]:
    """Run a node that ends by itself, with an error, once the block has been left.

    The list then holds the lines of its errors.
    """
    process = subprocess.Popen(node_command(name, *arguments), stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)
    errors: list[str] = []
    try:
        yield errors
        errors += process.communicate(timeout=LIMIT_S)[1].strip().splitlines()
        assert process.returncode == 1
    finally:
        process.kill()
        process.wait(LIMIT_S)


def fails(name: str, *arguments: str) -> str:
    """Run a node that must refuse its parameters; return its one line."""
    finished = subprocess.run(node_command(name, *arguments), capture_output=True, text=True,
                              timeout=LIMIT_S)
    assert finished.returncode == 1, finished.stdout + finished.stderr
    lines = [line for line in finished.stderr.strip().splitlines()
             if not line.startswith('[INFO]')]
    assert len(lines) == 1, finished.stderr
    return lines[0]
