"""How every node starts, spins and ends."""

from __future__ import annotations

from collections.abc import Callable
import sys

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from lunar_rover_sim.errors import LunarRoverSimError


class Finished(Exception):  # noqa: N818  (it is not an error)
    """Raised in a callback when a node has done what it was started for."""


def executor() -> Executor:
    """Return the events executor (a third of the CPU time), or rclpy's own where it is missing."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def run(factory: Callable[[], Node], args: list[str] | None = None) -> int:
    """Run one node until it is finished or told to stop; return the exit status.

    0 after SIGINT, SIGTERM or Finished, 1 after an error, which is logged as one fatal line.
    """
    rclpy.init(args=args)
    status = 0
    node: Node | None = None
    spinner = executor()
    try:
        node = factory()
        spinner.add_node(node)
        spinner.spin()
    except (KeyboardInterrupt, ExternalShutdownException, Finished):
        pass
    except LunarRoverSimError as error:
        print(f'FATAL {error}', file=sys.stderr, flush=True)
        status = 1
    status = max(status, _close(node))
    try:
        rclpy.try_shutdown()
    except KeyboardInterrupt:
        pass
    return status


def _close(node: Node | None) -> int:
    """Destroy the node; a second SIGINT must not cut the clean-up short."""
    if node is None:
        return 0
    for _ in range(3):
        try:
            node.destroy_node()
            return 0
        except (KeyboardInterrupt, ExternalShutdownException):
            continue
        except LunarRoverSimError as error:
            print(f'FATAL {error}', file=sys.stderr, flush=True)
            return 1
    return 1
