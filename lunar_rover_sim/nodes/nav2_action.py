"""Nav2's action NavigateToPose, where nav2_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import importlib
import threading
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from lunar_rover_sim.autonomy.navigation.command import NavigatorCommand
from lunar_rover_sim.nodes.node_main import GraphNode

_NAME = 'navigate_to_pose'
_POLL_S = 0.05
_FEEDBACK_NS = 500_000_000


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far the navigator is.

    Attributes:
        pose: PoseStamped of the rover.
        left_m, left_s: To the goal.
    """

    command: NavigatorCommand
    stamp_ns: int
    pose: Any
    left_m: float
    left_s: float
    recoveries: int


class NavigateToPoseServer:
    """Hands goals of the action to the navigator, and feedback and its end back.

    A newer goal, of this action or of a topic, aborts an older one.
    """

    def __init__(self, node: GraphNode, kind: Any,
                 set_goals: Callable[[Sequence[Any], bool], str | None]) -> None:
        """Serve; set_goals takes poses, and whether to turn to the last one's heading."""
        action = importlib.import_module('rclpy.action')
        self._kind, self._set_goals = kind, set_goals
        self._progress: Progress | None = None
        self._number = 0
        self._cancel = action.CancelResponse.ACCEPT
        self._server = action.ActionServer(
            node, kind, _NAME, self._execute, callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda _: self._cancel)

    @classmethod
    def make(cls, node: GraphNode,
             set_goals: Callable[[Sequence[Any], bool], str | None]
             ) -> NavigateToPoseServer | None:
        """Return the server; None where nav2_msgs is not installed."""
        try:
            kind = importlib.import_module('nav2_msgs.action').NavigateToPose
        except ImportError:
            return None
        return cls(node, kind, set_goals)

    def tell(self, progress: Progress) -> None:
        """Take note of the newest command and what it has come to."""
        self._progress = progress

    def replace(self) -> None:
        """Abort the present goal: the navigator has got another one by a topic."""
        self._number += 1

    async def _execute(self, handle: Any) -> Any:
        refused = self._set_goals([handle.request.pose], True)
        if refused is not None:
            handle.abort()      # an earlier goal stays
            return self._result(refused)
        self.replace()
        number, self._progress = self._number, None
        begun_ns = told_ns = -1
        while number == self._number:
            progress = self._progress
            if handle.is_cancel_requested:
                self._set_goals([], False)
                handle.canceled()
                return self._result()
            if progress is not None and progress.command.status.is_end:
                (handle.abort if progress.command.failure else handle.succeed)()
                return self._result(progress.command.reason)
            if progress is not None:
                begun_ns = progress.stamp_ns if begun_ns < 0 else begun_ns
                if told_ns < 0 or progress.stamp_ns - told_ns >= _FEEDBACK_NS:
                    told_ns = progress.stamp_ns
                    handle.publish_feedback(self._feedback(progress, told_ns - begun_ns))
            await _pause()
        handle.abort()
        return self._result('a newer goal has replaced this one')

    def _feedback(self, progress: Progress, driven_ns: int) -> Any:
        feedback = self._kind.Feedback()
        feedback.current_pose = progress.pose
        for duration, ns in ((feedback.navigation_time, driven_ns),
                             (feedback.estimated_time_remaining, round(progress.left_s * 1e9))):
            duration.sec, duration.nanosec = divmod(ns, 1_000_000_000)
        feedback.number_of_recoveries = progress.recoveries
        feedback.distance_remaining = progress.left_m
        return feedback

    def _result(self, reason: str = '') -> Any:
        result = self._kind.Result()
        if hasattr(result, 'error_msg'):    # early releases of Jazzy have none
            result.error_msg = reason
        return result


async def _pause() -> None:
    one = Future()
    threading.Timer(_POLL_S, one.set_result, (None,)).start()
    await one
