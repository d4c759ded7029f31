"""Transforms that the view of a bag makes of odometry."""

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import pose_matrix, transform_matrix
from lunar_rover_sim.base import topics
from lunar_rover_sim.run.transforms import tf_of_odometry, transforms_of


@pytest.mark.parametrize(('topic', 'transforms'), [
    ('/odom', '/tf'), ('/rover_1/odom', '/rover_1/tf'), ('/ground_truth/odom', ''),
    ('/rover_1/ground_truth/odom', ''), ('/wheel/odometry', ''), ('/my_odom', '')])
def test_only_the_odometry_of_the_rover(topic: str, transforms: str) -> None:
    assert transforms_of(topic) == transforms


def test_the_pose_goes_through() -> None:
    """Frames, stamp and pose of the transform are those of the odometry."""
    item = next(i for i in synthetic.drive(0.1) if i.topic == 'odom')
    raw = bytes(synthetic.STORE.serialize_cdr(item.message, topics.ODOM.type))
    message = synthetic.STORE.deserialize_cdr(tf_of_odometry(raw), topics.TF.type)
    (transform,) = message.transforms
    assert transform.header == item.message.header
    assert transform.child_frame_id == item.message.child_frame_id
    np.testing.assert_allclose(transform_matrix(transform), pose_matrix(item.message), atol=1e-12)
