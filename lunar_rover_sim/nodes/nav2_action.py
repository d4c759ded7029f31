"""Nav2's action NavigateToPose, where nav2_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import importlib
import threading
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from lunar_rover_sim.autonomy.navigation.navigator import ARRIVED, FAILED, NavigatorCommand
from lunar_rover_sim.nodes.node_main import GraphNode

_NAME = 'navigate_to_pose'
_POLL_S = 0.05


class NavigateToPoseServer:
    """Hands goals of the action to the navigator, and its end back.

    A newer goal, of this action or of a topic, aborts an older one.
    """

    def __init__(self, node: GraphNode, kind: Any, set_goals: Callable[[Sequence[Any]], str]
                 ) -> None:
        action = importlib.import_module('rclpy.action')
        self._kind, self._set_goals = kind, set_goals
        self._command: NavigatorCommand | None = None
        self._number = 0
        self._cancel = action.CancelResponse.ACCEPT
        self._server = action.ActionServer(
            node, kind, _NAME, self._execute, callback_group=ReentrantCallbackGroup(),
            cancel_callback=lambda _: self._cancel)

    @classmethod
    def make(cls, node: GraphNode,
             set_goals: Callable[[Sequence[Any]], str]) -> NavigateToPoseServer | None:
        """Return the server; None where nav2_msgs is not installed."""
        try:
            kind = importlib.import_module('nav2_msgs.action').NavigateToPose
        except ImportError:
            return None
        return cls(node, kind, set_goals)

    def tell(self, command: NavigatorCommand) -> None:
        """Take note of the newest command."""
        self._command = command

    def replace(self) -> None:
        """Abort the present goal: the navigator has got another one by a topic."""
        self._number += 1

    async def _execute(self, handle: Any) -> Any:
        refused = self._set_goals([handle.request.pose])
        if refused:
            handle.abort()      # an earlier goal stays
            return self._result(refused)
        self.replace()
        number, self._command = self._number, None
        while number == self._number:
            command = self._command
            if handle.is_cancel_requested:
                self._set_goals([])
                handle.canceled()
                return self._result()
            if command is not None and command.status in (ARRIVED, FAILED):
                (handle.succeed if command.status == ARRIVED else handle.abort)()
                return self._result(command.reason)
            await _pause()
        handle.abort()
        return self._result('a newer goal has replaced this one')

    def _result(self, reason: str = '') -> Any:
        result = self._kind.Result()
        if hasattr(result, 'error_msg'):    # early releases of Jazzy have none
            result.error_msg = reason
        return result


async def _pause() -> None:
    one = Future()
    threading.Timer(_POLL_S, one.set_result, (None,)).start()
    await one
