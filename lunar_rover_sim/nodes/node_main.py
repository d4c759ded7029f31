"""How every node starts, spins and ends."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import ctypes
import functools
import sys
import time
from typing import Any

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from lunar_rover_sim.errors import LunarRoverSimError

_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3   # of malloc.h


class GraphNode(Node):
    """A node that can end by itself: finished, or because of an error in a callback.

    Errors of this package in callbacks are kept for `run` to print as one line, where executors
    would print a traceback.
    """

    def __init__(self, name: str) -> None:
        self.finished = False
        self.failure: LunarRoverSimError | None = None
        self._served = 0        # callbacks so far
        self._woken = Future()
        super().__init__(name)

    def spin(self) -> None:
        """Serve callbacks until the node is woken or ends, or for a while. For `run` alone."""
        # One call for many messages: one for each, as spin_once, takes as long as the messages.
        # With a limit: that of the events executor does not end with the context.
        if not self._woken.done() and self.executor is not None:
            self.executor.spin_until_future_complete(self._woken, timeout_sec=0.2)
        self._woken = Future()

    def wake(self) -> None:
        """Have `work` called as soon as this callback, or this call of it, returns."""
        if not self._woken.done():
            self._woken.set_result(None)

    def serve(self) -> bool:
        """Serve one callback if one is due; return whether one was. For `work` alone."""
        before = self._served
        if self.executor is not None:
            with contextlib.suppress(ExternalShutdownException):    # the loop of `run` sees it too
                self.executor.spin_once(timeout_sec=0.0)
        return self._served != before

    def work(self) -> None:
        """Do what takes long, after a call of `wake`."""

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[..., None],
                            *args: Any, **kwargs: Any) -> Any:
        """Create a subscription whose callback may raise our errors."""
        return super().create_subscription(msg_type, topic, self._guarded(callback), *args,
                                           **kwargs)

    def create_timer(self, timer_period_sec: float, callback: Callable[..., None],
                     *args: Any, **kwargs: Any) -> Any:
        """Create a timer whose callback may raise our errors."""
        return super().create_timer(timer_period_sec, self._guarded(callback), *args, **kwargs)

    def _guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(callback)
        def guarded(*args: Any) -> None:
            if self.finished or self.failure is not None:
                return
            self._served += 1
            try:
                callback(*args)
            except LunarRoverSimError as error:
                self.failure = error
            if self.finished or self.failure is not None:
                self.wake()

        return guarded


def executor() -> Executor:
    """Return the events executor (a third of the CPU time), or rclpy's own where it is missing."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def run(factory: Callable[[], GraphNode], args: list[str] | None = None) -> int:
    """Run one node until it is finished or told to stop; return the exit status.

    0 after SIGINT, SIGTERM or when finished, 1 after an error, which is printed as one line.
    """
    _keep_freed_memory()
    rclpy.init(args=args)
    failure: LunarRoverSimError | None = None
    node: GraphNode | None = None
    spinner = executor()
    try:
        node = factory()
        spinner.add_node(node)
        while not node.finished and node.failure is None and rclpy.ok():
            node.spin()
            node.work()
        failure = node.failure
    except (KeyboardInterrupt, ExternalShutdownException):
        failure = node.failure if node is not None else None
    except LunarRoverSimError as error:
        failure = error
    except Exception:
        # A signal ends the context under callbacks that publish, and where it meets rclpy's own
        # code, that reports some other error in its stead.
        if _goes_on():
            raise
        failure = node.failure if node is not None else None
    if failure is not None:
        # Before the clean-up, which may take long: whoever started this node is waiting for it.
        print(f'FATAL {failure}', file=sys.stderr, flush=True)
    second = _destroy(node)
    try:
        rclpy.try_shutdown()
    except KeyboardInterrupt:
        pass
    if failure is None and second is not None:
        print(f'FATAL {second}', file=sys.stderr, flush=True)
    return 0 if failure is None and second is None else 1


def _goes_on() -> bool:
    """Return whether the context is still valid a moment later: signals end it in a thread."""
    time.sleep(0.1)
    return bool(rclpy.ok())


def _keep_freed_memory() -> None:
    """Keep what is freed for the next message, up to 64 MiB; without glibc, do nothing.

    Images are a megabyte each. Given back to the kernel, their memory would come again page by
    page: half of the recorder's time.
    """
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)
    if mallopt is not None:
        for parameter, value in ((_M_MMAP_THRESHOLD, 32 << 20), (_M_TRIM_THRESHOLD, 64 << 20),
                                 (_M_TOP_PAD, 4 << 20)):
            mallopt(parameter, value)


def _destroy(node: GraphNode | None) -> LunarRoverSimError | None:
    """Destroy the node; another SIGINT must not cut the clean-up short."""
    while node is not None:
        try:
            node.destroy_node()
            return None
        except (KeyboardInterrupt, ExternalShutdownException):
            continue
        except LunarRoverSimError as error:
            return error
    return None
