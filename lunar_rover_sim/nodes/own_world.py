"""The world folder that a node is given, and that it is the world of the physics."""

from __future__ import annotations

from rclpy.node import Node
from std_msgs.msg import String

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.nodes import qos


def load_own_world(folder: str) -> World:
    """Return the world of a node's parameter `world`; raise ConfigError where it is empty."""
    if not folder:
        raise ConfigError("world: '' is not valid; valid is a folder made by "
                          '`lunar_rover_sim world build`')
    return load_world(folder)


def refuse_other_worlds(node: Node, folder: str, world: World, lockstep: bool) -> None:
    """Subscribe to the hash of the physics' world; another one than ours raises GraphError.

    Args:
        folder: Of our world, for the message.
    """
    def callback(msg: String) -> None:
        if msg.data != world.hash:
            raise GraphError(f'world {folder}: hash {world.hash[:12]} is not '
                             f'that of the physics, {msg.data[:12]}; give both nodes one world')

    node.create_subscription(String, topics.WORLD_HASH.name, callback,
                             qos.requested(topics.WORLD_HASH, lockstep))
