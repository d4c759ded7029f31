"""Messages of tf in CDR, made without ROS: nodes publish them, the view of a bag may need them."""

from __future__ import annotations

from collections.abc import Iterable
import functools
from typing import Any

from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from lunar_rover_sim.bag.messages import header_ns, pose_matrix
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.seconds import NS_PER_S


@functools.cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def tf_message(moved: Iterable[tuple[str, str, Array]], stamp_ns: int) -> bytes:
    """Return (parent, child, (4, 4) T_parent_child) as a TFMessage with a stamp [ns], in CDR."""
    types, stamped = _store().types, []
    stamp = types['builtin_interfaces/msg/Time'](sec=stamp_ns // NS_PER_S,
                                                 nanosec=stamp_ns % NS_PER_S)
    for parent, child, T in moved:
        x, y, z = T[:3, 3].tolist()
        qw, qx, qy, qz = frames.wxyz_from_matrix(T[:3, :3]).tolist()
        stamped.append(types['geometry_msgs/msg/TransformStamped'](
            header=types['std_msgs/msg/Header'](stamp=stamp, frame_id=parent),
            child_frame_id=child, transform=types['geometry_msgs/msg/Transform'](
                translation=types['geometry_msgs/msg/Vector3'](x=x, y=y, z=z),
                rotation=types['geometry_msgs/msg/Quaternion'](x=qx, y=qy, z=qz, w=qw))))
    return bytes(_store().serialize_cdr(types[topics.TF.type](transforms=stamped),
                                        topics.TF.type))


def transforms_of(topic: str) -> str:
    """Return the tf topic that belongs to a topic of odometry; '' for any other topic.

    Odometry of wheels, of SLAM, or of the truth beside an estimator does not place base_link.
    """
    scope, _, name = topic.rpartition('/')
    truth = topics.TRUE_ODOM.name.rpartition('/')[0]
    return f'{scope}/{topics.TF.name}' if name == topics.ODOM.name and \
        scope.rpartition('/')[2] != truth else ''


def tf_of_odometry(raw: bytes) -> bytes:
    """Return the transform from the frame of an odometry to its child, both in CDR."""
    odometry: Any = _store().deserialize_cdr(raw, topics.ODOM.type)
    return tf_message([(odometry.header.frame_id, odometry.child_frame_id,
                        pose_matrix(odometry))], header_ns(odometry))
