"""view_node alone: what a client of its websocket gets."""

import math
import struct

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry  # noqa: E402
from peer import at_rest_odometry, Peer, running  # noqa: E402
from rclpy.publisher import Publisher  # noqa: E402

from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402


def latched_description(peer: Peer) -> Publisher:
    """Publish a description of a robot, which has no stamp, as physics_node does."""
    from std_msgs.msg import String

    from lunar_rover_sim.nodes import qos
    latched = peer.node.create_publisher(String, 'robot_description',
                                         qos.reliable(1, durable=True))
    latched.publish(String(data='<robot/>'))
    return latched


def test_view_node_serves_what_is_watched(peer: Peer) -> None:
    """A client without ROS gets the bytes of messages; latched ones come to every client."""
    pytest.importorskip('websockets')
    from rclpy.serialization import deserialize_message
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String
    from view_client import client, free_port

    latched_description(peer)
    poses = peer.node.create_publisher(Odometry, 'odom', 10)
    port = free_port()
    with running('view_node', '-p', f'port:={port}'), client(port) as first:
        first.find('/odom')
        assert not poses.get_subscription_count()       # nobody watches: nothing is read
        first.subscribe('/odom')
        peer.spin_until(lambda: poses.get_subscription_count() > 0, meanwhile=first.attend)
        poses.publish(at_rest_odometry())
        number, _, data = first.message()
        assert number == 7 and deserialize_message(data, Odometry) == at_rest_odometry()
        clock = peer.node.create_publisher(Clock, '/clock', 10)
        peer.spin_until(lambda: clock.get_subscription_count() > 0)
        clock.publish(Clock(clock=time_msg(7_000_000_000)))
        while first.time_ns() != 7_000_000_000:     # that of the wall, as long as there was none
            pass
        first.subscribe('/robot_description', 8)
        _, stamp_ns, data = first.message()
        assert deserialize_message(data, String).data == '<robot/>'
        assert stamp_ns == 7_000_000_000        # it has none of its own
        with client(port) as second:
            second.subscribe('/robot_description')
            assert deserialize_message(second.message()[2], String).data == '<robot/>'
    peer.spin_until(lambda: not poses.get_subscription_count())


def test_view_node_hears_the_clock_before_what_has_no_stamp(peer: Peer) -> None:
    """A latched message comes at once; its first client gets it in simulated time too."""
    pytest.importorskip('websockets')
    from rosgraph_msgs.msg import Clock
    from view_client import client, free_port
    latched = latched_description(peer)
    clock = peer.node.create_publisher(Clock, '/clock', 10)
    port = free_port()
    with running('view_node', '-p', f'port:={port}'), client(port) as first:
        first.find('/clock')
        first.subscribe('/robot_description')

        def attend() -> None:
            first.attend()      # the topic is offered anew where the request came too soon
            clock.publish(Clock(clock=time_msg(7_000_000_000)))

        peer.spin_until(lambda: latched.get_subscription_count() > 0, meanwhile=attend)
        assert first.message()[1] == 7_000_000_000


def test_view_node_publishes_velocities_of_its_own_page_only(peer: Peer) -> None:
    """What a client with the token drives arrives; other topics, NaN and strangers do not."""
    pytest.importorskip('websockets')
    from geometry_msgs.msg import Twist
    from view_client import client, free_port
    from websockets.exceptions import InvalidStatus
    peer.node.create_publisher(Odometry, 'odom', 10)
    heard = peer.listen(Twist, 'cmd_vel')
    port = free_port()
    with running('view_node', '-p', f'port:={port}'), client(port) as friend:
        friend.find('/odom')
        with pytest.raises(InvalidStatus), client(port, origin='https://evil.example'):
            pass
        for topic in ('/no such name/cmd_vel', '/odom', '/xcmd_vel'):
            friend.drive(topic, struct.pack('<4x6d', 1, 0, 0, 0, 0, 1))
        friend.drive('/cmd_vel', struct.pack('<4x6d', math.nan, 0, 0, 0, 0, 1))
        peer.spin_until(lambda: heard, meanwhile=lambda: friend.drive(
            '/cmd_vel', struct.pack('<4x6d', 0.1, 0, 0, 0, 0, 0.2)))
    assert {(one.linear.x, one.angular.z) for one in heard} == {(0.1, 0.2)}
