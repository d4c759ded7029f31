"""What tests of nodes share: a plain rclpy node beside them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture()
def peer(domain: int) -> Iterator[Any]:
    """Give a plain rclpy node in a domain of its own."""
    from peer import Peer
    import rclpy
    peer = Peer()
    yield peer
    peer.node.destroy_node()
    rclpy.try_shutdown()
