"""What tests of nodes share: a plain rclpy node beside them, a state."""

from collections.abc import Iterator
import dataclasses
from typing import Any

import numpy as np
import pytest

from lunar_rover_sim.base import frames
from lunar_rover_sim.rover.physics.state import RoverState


@pytest.fixture()
def peer(domain: int) -> Iterator[Any]:
    """Give a plain rclpy node in a domain of its own."""
    from peer import Peer
    import rclpy
    peer = Peer()
    yield peer
    peer.node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture()
def state() -> RoverState:
    """A rover at (1, 2, 3), turned left by 90 degrees, rolling forward at 0.1 m/s."""
    values: dict[str, Any] = {f.name: np.zeros(4) for f in dataclasses.fields(RoverState)}
    values.update(stamp_ns=5_000_000, position_m=np.array([1.0, 2.0, 3.0]),
                  orientation_wxyz=frames.wxyz_from_rpy(0, 0, np.pi / 2),
                  linear_velocity_mps=np.array([0.1, 0.0, 0.0]),
                  angular_velocity_radps=np.zeros(3), contact_force_n=np.ones((4, 3)),
                  contact_torque_nm=np.zeros((4, 3)),
                  specific_force_mps2=np.array([0.0, 0.0, 1.62]), imu_rate_radps=np.zeros(3))
    return RoverState(**values)
