"""The parameters of companions: nodes that run beside a graph and in no scenario."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.parameters import param
from lunar_rover_sim.run.shared_config import NodeConfig

VIEW_PORT = 8765


@dataclasses.dataclass(frozen=True)
class TrajectoryRecorderNodeConfig(NodeConfig):
    """Parameters of trajectory_recorder_node."""

    output: str = param('', 'TUM file to write; it must not exist')
    type: str = param('', 'message type of the topic `pose`; empty: that of its publisher',
                      choices=('', 'geometry_msgs/msg/PoseStamped',
                               'geometry_msgs/msg/PoseWithCovarianceStamped',
                               'nav_msgs/msg/Odometry', 'nav_msgs/msg/Path'))


@dataclasses.dataclass(frozen=True)
class ViewNodeConfig(NodeConfig):
    """Parameters of view_node."""

    port: int = param(VIEW_PORT, 'port of page and websocket, on this machine only', low=1024,
                      high=65535)
    allow_origin: tuple[str, ...] = param(
        (), 'origins of pages elsewhere that may see and drive the rover too, with the token, '
        'such as https://app.foxglove.dev')


COMPANION_CONFIGS: dict[str, type[NodeConfig]] = {
    'trajectory_recorder_node': TrajectoryRecorderNodeConfig,
    'view_node': ViewNodeConfig,
}
