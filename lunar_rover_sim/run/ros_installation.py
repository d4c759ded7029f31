"""Whether ROS 2 is installed."""

from __future__ import annotations

import importlib.util

from lunar_rover_sim.errors import GraphError


def require_ros() -> None:
    """Raise GraphError with the remedy if rclpy is not installed."""
    if importlib.util.find_spec('rclpy') is None:
        raise GraphError('rclpy is missing: source /opt/ros/jazzy/setup.bash, or '
                         "pip install 'lunar_rover_sim[ros]'")
