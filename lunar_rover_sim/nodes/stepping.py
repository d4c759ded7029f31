"""Steps that are made while time is paused, for a service that answers when they are done.

rclpy's events executor awaits no coroutine: a callback that waited in the node's thread would wait
for ever. So the service has a thread, and a ROS node for it.
"""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node


class Stepping:
    """Steps granted while time is paused; wake: makes the node look, from any thread."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._changed = threading.Condition()
        self._left = 0
        self._problem = ''

    def run(self, count: int) -> str:
        """Grant steps and wait until they are made; return why they were not, or ''."""
        with self._changed:
            self._left, self._problem = count, ''
            self._wake()
            self._changed.wait_for(lambda: not self._left)
            return self._problem

    @property
    def pending(self) -> bool:
        """Whether a step is granted."""
        return self._left > 0

    def made(self) -> None:
        """Note that the node has made a step."""
        with self._changed:
            self._left = max(self._left - 1, 0)
            self._changed.notify_all()

    def cancel(self, problem: str) -> None:
        """Withdraw what is left."""
        with self._changed:
            if self._left:
                self._left, self._problem = 0, problem
            self._changed.notify_all()


class ServiceThread:
    """A service `~/NAME` of a node whose callback may wait."""

    def __init__(self, node: Node, kind: Any, name: str, callback: Callable[..., Any]) -> None:
        # Remaps of the process, its __node above all, are for the node itself.
        self._node = rclpy.create_node(
            f'{node.get_name()}_{name}', namespace=node.get_namespace(),
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False)
        self._node.create_service(kind, node.resolve_service_name(f'~/{name}'), callback)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass        # the context has ended: so does the thread

    def close(self) -> None:
        """End the thread; nobody may be waiting in the callback."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
