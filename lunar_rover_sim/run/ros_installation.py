"""Whether ROS 2 is installed, and how its nodes find each other and repair losses."""

from __future__ import annotations

import importlib.util

from lunar_rover_sim.errors import GraphError, with_extra
from lunar_rover_sim.files.paths import config_path

_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'


def require_ros() -> None:
    """Raise GraphError with the remedy if rclpy is not installed."""
    if importlib.util.find_spec('rclpy') is None:
        raise GraphError('rclpy is missing: source /opt/ros/jazzy/setup.bash, or '
                         + with_extra('ros'))


def dds_environment() -> dict[str, str]:
    """Return the environment variable by which Fast DDS reads `config/fastdds.xml`.

    Nodes that have it discover each other, and repair the loss of a message, in tenths of a
    second, without it in 3 s. Other middleware does not read it. A file that the user names
    instead takes precedence: that is for the caller.
    """
    return {_PROFILES: str(config_path('fastdds.xml'))}
