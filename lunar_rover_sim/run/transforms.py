"""Messages of tf where tf2_msgs is not installed.

PyPI has no tf2_msgs: with its packages no node can publish tf. Then the live view makes tf of
odometry, and the recorder of a run makes the tf that physics would publish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.bag.messages import header_ns, joint_order, pose_matrix
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import GraphError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.rover.mounts import fixed_frames, moving_frames
from lunar_rover_sim.rover.visual import link_poses
from lunar_rover_sim.run.recorded_run import RecordedNodes

_MOST_OPEN = 100     # states of which one of two messages has come


def transforms_of(topic: str) -> str:
    """Return the tf topic that belongs to a topic of odometry; '' for any other topic.

    Odometry of wheels, of SLAM, or of the truth beside an estimator does not place base_link.
    """
    scope, _, name = topic.rpartition('/')
    truth = topics.TRUE_ODOM.name.rpartition('/')[0]
    return f'{scope}/{topics.TF.name}' if name == topics.ODOM.name and \
        scope.rpartition('/')[2] != truth else ''


class _Messages:
    """Messages by the definitions of rosbags, as on the wire."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)

    def read(self, topic: topics.Topic, raw: bytes) -> Any:
        """Return a message of a topic."""
        return self._store.deserialize_cdr(raw, topic.type)

    def written(self, header: Any, moved: Sequence[tuple[str, str, Array]]) -> bytes:
        """Return (parent, child, (4, 4) T_parent_child) as a TFMessage with a header's stamp."""
        stamp = self.make('builtin_interfaces/msg/Time', sec=0, nanosec=0) if header is None \
            else header.stamp
        stamped = []
        for parent, child, T in moved:
            w, x, y, z = map(float, frames.wxyz_from_matrix(T[:3, :3]))
            place = dict(zip('xyz', map(float, T[:3, 3])))
            stamped.append(self.make(
                'geometry_msgs/msg/TransformStamped', child_frame_id=child,
                header=self.make('std_msgs/msg/Header', stamp=stamp, frame_id=parent),
                transform=self.make(
                    'geometry_msgs/msg/Transform',
                    translation=self.make('geometry_msgs/msg/Vector3', **place),
                    rotation=self.make('geometry_msgs/msg/Quaternion', x=x, y=y, z=z, w=w))))
        message = self.make(topics.TF.type, transforms=stamped)
        return bytes(self._store.serialize_cdr(message, topics.TF.type))

    def make(self, msgtype: str, **fields: Any) -> Any:
        """Return a new message."""
        return self._store.types[msgtype](**fields)


class OdometryTransforms:
    """Makes tf of odometry alone: the legs and sensors of a live view follow from its URDF."""

    def __init__(self) -> None:
        self._messages = _Messages()

    def of(self, raw: bytes) -> bytes:
        """Return the transform from the frame of an odometry to its child, both as on the wire."""
        odometry = self._messages.read(topics.ODOM, raw)
        return self._messages.written(odometry.header, [
            (odometry.header.frame_id, odometry.child_frame_id, pose_matrix(odometry))])


class RunTransforms:
    """Makes the tf of a run, for its recorder, of true odometry and joint states.

    Args:
        nodes: Rover and parameters of the run.
        full: Returns the full name of a topic.

    Attributes:
        sources: Full name → topic that it is made of.
    """

    def __init__(self, nodes: RecordedNodes, full: Callable[[str], str]) -> None:
        self._messages = _Messages()
        self._nodes = nodes
        self._open: dict[int, dict[str, Any]] = {}      # stamp [ns] → source → message
        self.sources = {full(topic.name): topic
                        for topic in (nodes.physics.truth, topics.JOINT_STATES)}

    def fixed(self) -> bytes:
        """Return the message of tf_static, with the frames of hazard cameras."""
        return self._messages.written(None, [
            *fixed_frames(self._nodes.rover),
            *(frame for camera in self._nodes.render.cameras for frame in camera.frames)])

    def add(self, source: str, raw: bytes) -> bytes | None:
        """Take a message of a source; return that of tf when both of a stamp have come.

        Raises:
            GraphError: Joints of the rover are missing.
        """
        message = self._messages.read(self.sources[source], raw)
        stamp_ns = header_ns(message)
        found = self._open.setdefault(stamp_ns, {})
        found[source] = message
        if len(found) < len(self.sources):
            if len(self._open) > _MOST_OPEN:    # in real time, messages may be lost
                del self._open[next(iter(self._open))]
            return None
        del self._open[stamp_ns]
        odometry, joints = (found[name] for name in self.sources)
        rover = self._nodes.rover
        order = joint_order(joints, rover.legs, 'tf', GraphError)
        return self._messages.written(joints.header, moving_frames(
            rover, pose_matrix(odometry), link_poses(rover, np.asarray(joints.position)[order]),
            self._nodes.physics.pose_frames))
