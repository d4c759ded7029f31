"""The frame of the rover in the live view where tf2_msgs is not installed: made of odometry.

Without this frame a viewer draws the rover at rest, and nothing that is given in `odom`. The legs
and sensors below base_link follow from robot_description and joint_states.
"""

from __future__ import annotations

from typing import Any

from rosbags.typesys.store import Typestore

from lunar_rover_sim import topics


def transforms_of(topic: str) -> str:
    """Return the tf topic that belongs to a topic of odometry; '' for any other topic.

    Odometry of wheels, of SLAM, or of the truth beside an estimator does not place base_link.
    """
    scope, _, name = topic.rpartition('/')
    truth = topics.TRUE_ODOM.name.rpartition('/')[0]
    return f'{scope}/{topics.TF.name}' if name == topics.ODOM.name and \
        scope.rpartition('/')[2] != truth else ''


class OdometryTransforms:
    """Makes tf2_msgs/TFMessage of nav_msgs/Odometry, both as on the wire."""

    def __init__(self, store: Typestore) -> None:
        self._store = store

    def of(self, raw: bytes) -> bytes:
        """Return the transform from the frame of an odometry to its child."""
        odometry = self._store.deserialize_cdr(raw, topics.ODOM.type)
        pose = odometry.pose.pose   # type: ignore[attr-defined]
        position = pose.position
        transform = self._make('geometry_msgs/msg/Transform', rotation=pose.orientation,
                               translation=self._make('geometry_msgs/msg/Vector3', x=position.x,
                                                      y=position.y, z=position.z))
        stamped = self._make(
            'geometry_msgs/msg/TransformStamped', transform=transform,
            header=odometry.header,                     # type: ignore[attr-defined]
            child_frame_id=odometry.child_frame_id)     # type: ignore[attr-defined]
        message = self._make(topics.TF.type, transforms=[stamped])
        return bytes(self._store.serialize_cdr(message, topics.TF.type))

    def _make(self, msgtype: str, **fields: Any) -> Any:
        return self._store.types[msgtype](**fields)
