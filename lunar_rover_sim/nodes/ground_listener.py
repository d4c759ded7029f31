"""The ground under a node: its world, which is that of the physics; its window; its changes."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from lunar_rover_sim.bag.ground_points import changes_of
from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.ground.regolith.overlay import GroundChanges, Overlay
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.node_main import GraphNode


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

    qos.subscription(node, topics.WORLD_HASH, callback, lockstep)


def log_window(node: Node, world: World, stamp_ns: int, took_s: float) -> None:
    """Log that a window was entered, and for how long all else stood still for it."""
    x, y = world.ground.middle_m
    node.get_logger().info(f'at {stamp_ns / 1e9:.3f} s in the window around x {x:g} m, y {y:g} m: '
                           f'{took_s:.2f} s')


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
        self._follower, self._middle_m = Follower(world), world.ground.middle_m
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
            self._coming = self._pool.submit(self._follower.window, middle)
        if self._coming is None or not (self._lockstep or self._coming.done()):
            return None
        coming, self._coming = self._coming, None
        self._follower.world = coming.result()
        return self._follower.world

    def ahead(self, x_m: float, y_m: float) -> World | None:
        """Return the window that will probably be next for a rover at a place, once it is made.

        It is made in a thread when the rover nears it: who needs much of it can begin before
        physics is there.
        """
        if self._coming is None:
            self._follower.look_ahead(x_m, y_m)
        return self._follower.next

    @property
    def middle_m(self) -> tuple[float, float]:
        """Middle of the present window [m]."""
        return self._middle_m

    def go_to(self, middle_m: tuple[float, float]) -> World:
        """Return a window, which is the present one from now on; raise WorldError."""
        self._middle_m = middle_m
        return self._follower.go_to(middle_m)

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(cancel_futures=True)
        self._follower.close()
        self._follower.site.close()

    def _take(self, message: PointStamped) -> None:
        stamp_ns = time_ns(message.header.stamp)
        # What was told for later no longer holds: time has begun anew.
        self._waiting = [item for item in self._waiting if item[0] < stamp_ns]
        self._waiting.append((stamp_ns, (message.point.x, message.point.y)))


# Messages of two topics may arrive a little out of order; stamps further back are of a restart.
_JUMP_NS = 500_000_000


class GroundListener:
    """The ground as far as it is known; `overlay` is that of the stamp last asked for.

    Nothing counts before the first snapshot. Later ones, for other readers, change nothing.
    Without a publisher nothing arrives, and the overlay stays empty.
    """

    def __init__(self, node: GraphNode, on_change: Callable[[], None]) -> None:
        """Subscribe; on_change: called when more of the ground is known."""
        self.overlay = Overlay()
        self._on_change = on_change
        self._known_ns: int | None = None       # stamp up to which changes have arrived
        # Stamp, whether it is a snapshot, and its values; in the order of stamps.
        self._waiting: list[tuple[int, bool, GroundChanges]] = []
        qos.subscription(node, topics.GROUND_SNAPSHOT, lambda raw: self._take(raw, True),
                         lockstep=True, raw=True)
        node.create_subscription(PointCloud2, topics.GROUND_CHANGES.name,
                                 lambda raw: self._take(raw, False),
                                 qos.reliable(qos.STATE_DEPTH), raw=True)

    @property
    def is_known(self) -> bool:
        """Whether there is ground that gives."""
        return self._known_ns is not None

    def knows(self, at_ns: int) -> bool:
        """Return whether all changes up to a stamp [ns] have arrived."""
        return self._known_ns is not None and self._known_ns >= at_ns

    def advance(self, to_ns: int) -> None:
        """Apply the changes up to a stamp [ns] to the overlay."""
        if self._known_ns is None:
            return
        while self._waiting and self._waiting[0][0] <= to_ns:
            _, whole, changes = self._waiting.pop(0)
            if whole:
                known = Overlay()
                known.apply(changes)
                self.overlay.restore(known)
            else:
                self.overlay.apply(changes)

    def _take(self, raw: bytes, whole: bool) -> None:
        at_ns = stamp_ns(topics.GROUND_CHANGES.type, raw) or 0
        if self._known_ns is not None and at_ns < self._known_ns - _JUMP_NS:
            self._waiting.clear()
            self._known_ns = at_ns
        item = at_ns, whole, changes_of(deserialize_message(raw, PointCloud2))
        bisect.insort(self._waiting, item, key=lambda entry: entry[0])
        if self._known_ns is None and whole:
            self._known_ns = self._waiting[-1][0]
        elif self._known_ns is not None and not whole:
            self._known_ns = max(self._known_ns, at_ns)
        self._on_change()
