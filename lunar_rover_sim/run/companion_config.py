"""The parameters of companions: nodes that run beside a graph and in no scenario."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.run.shared_config import NodeConfig

SET_ENTITY_STATE, TELEPORT = 'set_entity_state', 'teleport'
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
class FrameOffsetConfig(Parameters):
    """The pose of `odom` in the world of another simulator."""

    x_m: float = param(0.0, 'east', unit='m', low=-1e6, high=1e6)
    y_m: float = param(0.0, 'north', unit='m', low=-1e6, high=1e6)
    z_m: float = param(0.0, 'up', unit='m', low=-1e6, high=1e6)
    roll_deg: float = param(0.0, 'about x, fixed axes', unit='deg', low=-360.0, high=360.0)
    pitch_deg: float = param(0.0, 'about y, fixed axes', unit='deg', low=-360.0, high=360.0)
    yaw_deg: float = param(0.0, 'about z, fixed axes', unit='deg', low=-360.0, high=360.0)


@dataclasses.dataclass(frozen=True)
class PoseBridgeNodeConfig(NodeConfig):
    """Parameters of pose_bridge_node."""

    interface: str = param(
        SET_ENTITY_STATE, 'set_entity_state calls that service of simulation_interfaces, as Isaac '
        'Sim and Gazebo offer it; teleport publishes PoseStamped, as OmniLRS reads it',
        choices=(SET_ENTITY_STATE, TELEPORT))
    rate_hz: int = param(10, 'states per second of simulated time; those that the other simulator '
                         'has no time for are left out', unit='Hz', low=1, high=200)
    entity: str = param('/World/Rover/base_link', 'name of base_link over there: a path of USD in '
                        'Isaac Sim, the name of the robot in OmniLRS')
    send_legs: bool = param(True, 'with set_entity_state: set the legs too; false where the '
                            'entity is the whole rover')
    leg_entities: tuple[str, ...] = param(
        (), 'names of the legs over there, in the order of the rover; empty: /World/Rover/<leg>')
    frame_id: str = param('', 'frame of the poses in their headers; empty: world, and with '
                          'teleport the entity, as OmniLRS wants it')
    offset: FrameOffsetConfig = group(FrameOffsetConfig)
    send_twist: bool = param(False, 'with set_entity_state: send the velocity of base_link too; '
                             'simulators refuse it for a body without physics')
    answer_s: float = param(5.0, 'wall time after which a call without an answer is made again',
                            unit='s', low=0.1, high=600.0)

    def validate(self) -> None:
        """Raise ConfigError unless the entities have names, and each one its own."""
        self._check((self.entity, *self.leg_entities) if self.send_legs else (self.entity,))

    def entities_of(self, legs: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the legs over there; ConfigError unless each leg has one."""
        names = self.leg_entities or tuple(f'/World/Rover/{leg}' for leg in legs)
        if self.send_legs:
            if len(names) != len(legs):
                raise ConfigError(f'leg_entities: {len(names)} elements given; valid is one for '
                                  f'each leg of the rover: {", ".join(legs)}')
            self._check((self.entity, *names))
        return names

    @staticmethod
    def _check(names: tuple[str, ...]) -> None:
        if not all(names):
            raise ConfigError("entity, leg_entities: '' is not valid; valid is a name in the "
                              'other simulator')
        if len(set(names)) < len(names):
            raise ConfigError(f'leg_entities: {names[1:]} is not valid for entity {names[0]!r}; '
                              'valid are names that differ')


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
    'pose_bridge_node': PoseBridgeNodeConfig,
    'view_node': ViewNodeConfig,
}
