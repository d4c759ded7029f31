"""tf on the graph where PyPI's packages have no tf2_msgs: what others find and read."""

import pytest

pytest.importorskip('rclpy')

from peer import Peer, running  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from type_description_interfaces.srv import GetTypeDescription  # noqa: E402

from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.nodes import qos  # noqa: E402
from lunar_rover_sim.nodes.message_types import message_class  # noqa: E402

pytestmark = pytest.mark.ros
STORE = get_typestore(Stores.ROS2_JAZZY)


def test_physics_publishes_tf(peer: Peer, world_folder: str) -> None:
    """Frames arrive; name and hash of the type, and its description, are those of tf2_msgs."""
    moving = peer.listen_tf()
    fixed = peer.listen_tf('tf_static', qos.reliable(1, durable=True))
    with running('physics_node', '-p', f'world:={world_folder}', '-p', 'time_mode:=real_time'):
        peer.spin_until(lambda: fixed and len(moving) > 20)
        info, = peer.node.get_publishers_info_by_topic('/tf')
        expected = STORE.hash_rihs01(topics.TF.type)
        assert (info.topic_type, str(info.topic_type_hash)) == (topics.TF.type, expected)
        client = peer.node.create_client(GetTypeDescription, 'physics_node/get_type_description')
        peer.spin_until(client.service_is_ready)
        answer = client.call_async(GetTypeDescription.Request(
            type_name=topics.TF.type, type_hash=expected))
        peer.spin_until(answer.done)
    assert {(t.header.frame_id, t.child_frame_id) for t in moving} >= {
        ('odom', 'base_link'), ('base_link', 'front_left_link')}
    assert ('base_link', 'stereo_left_link') in {
        (t.header.frame_id, t.child_frame_id) for t in fixed}
    told = answer.result().type_description
    named = [part.type_name for part in told.referenced_type_descriptions]
    assert told.type_description.type_name == topics.TF.type and named == sorted(named)
    assert set(named) == {'builtin_interfaces/msg/Time', 'std_msgs/msg/Header', *(
        f'geometry_msgs/msg/{name}' for name in ('Quaternion', 'Transform', 'TransformStamped',
                                                 'Vector3'))}


def test_messages_that_are_not_serialised_are_refused(peer: Peer) -> None:
    """An object is not converted: an error, not a crash."""
    cls = message_class(topics.TF.type)
    if hasattr(cls, 'transforms'):
        pytest.skip('tf2_msgs is installed')
    with pytest.raises(MemoryError):
        peer.node.create_publisher(cls, 'tf', 1).publish(cls())
