"""The world folder that a node is given, that it is that of the physics, and its windows."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import String

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.ground.world.follower import site_of
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


class WindowListener:
    """The windows of the site in which physics says that the rover is.

    Make it before the subscriptions to states: of messages that are there together, those of the
    subscription that was made first are taken first. Physics sends a window and waits until its
    readers have it before it sends the first state in it.
    """

    def __init__(self, node: Node, world: World, lockstep: bool) -> None:
        """Subscribe.

        Args:
            world: The window in which the node begins.
            lockstep: Whether a window is waited for; otherwise the node goes on in the earlier
                one until it is there.
        """
        self._site, self._middle_m = site_of(world), world.ground.middle_m
        self._lockstep = lockstep
        self._waiting: list[tuple[int, tuple[float, float]]] = []   # in the order of stamps
        self._pool = ThreadPoolExecutor(1)
        self._coming: Future[World] | None = None
        node.create_subscription(PointStamped, topics.WORLD_WINDOW.name, self._take,
                                 qos.reliable(qos.FRAME_DEPTH, durable=True))

    def at(self, stamp_ns: int) -> World | None:
        """Return the window to enter before what shows a stamp [ns]; None: the present one.

        Raises:
            WorldError: If it cannot be made or read.
        """
        middle = self._middle_m
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            _, middle = self._waiting.pop(0)
        if middle != self._middle_m:
            self._middle_m = middle
            self._coming = self._pool.submit(self._site.window, middle)
        if self._coming is None or not (self._lockstep or self._coming.done()):
            return None
        coming, self._coming = self._coming, None
        return coming.result()

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(cancel_futures=True)
        self._site.close()

    def _take(self, message: PointStamped) -> None:
        stamp_ns = time_ns(message.header.stamp)
        # What was told for later no longer holds: time has begun anew.
        self._waiting = [item for item in self._waiting if item[0] < stamp_ns]
        self._waiting.append((stamp_ns, (message.point.x, message.point.y)))
