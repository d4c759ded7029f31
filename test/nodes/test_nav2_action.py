"""NavigateToPose on stand-ins of the action's types and server: nav2_msgs is not in the wheels."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('rclpy')

from rclpy import action, callback_groups, task  # noqa: E402  (needs rclpy)
from waiting import wait_until  # noqa: E402

from lunar_rover_sim.autonomy.navigation.navigator import (ARRIVED, FAILED,  # noqa: E402
                                                           FOLLOWING, NavigatorCommand)
from lunar_rover_sim.nodes.nav2_action import NavigateToPoseServer  # noqa: E402

REFUSED = 'too far'


class Handle:
    """A goal of a client, and what became of it."""

    def __init__(self, pose: str) -> None:
        self.request, self.is_cancel_requested, self.ends = SimpleNamespace(pose=pose), False, []
        self.task: Any = None

    @property
    def reason(self) -> str:
        return str(self.task.result().error_msg)

    def __getattr__(self, name: str) -> Any:
        assert name in ('succeed', 'abort', 'canceled')
        return lambda: self.ends.append(name)


class Client:
    """A server, whose goals run as tasks, and the goals that its navigator got."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(action, 'ActionServer', self._take)
        monkeypatch.setattr(callback_groups, 'ReentrantCallbackGroup', SimpleNamespace)
        self.set: list[list[str]] = []
        self.tasks: list[Any] = []
        self.server = NavigateToPoseServer(object(), SimpleNamespace(  # type: ignore
            Result=lambda: SimpleNamespace(error_msg='')), self._set_goals)

    def _take(self, node: Any, kind: Any, name: str, execute: Any, **_: Any) -> None:
        self.name, self.execute = name, execute

    def _set_goals(self, poses: Any) -> str:
        if poses == [REFUSED]:
            return 'goal: too far'
        self.set.append(poses)
        return ''

    def send(self, pose: str) -> Handle:
        handle = Handle(pose)
        handle.task = task.Task(self.execute, (handle,))
        self.tasks.append(handle.task)
        self.turn()
        return handle

    def turn(self) -> None:
        for one in self.tasks:
            if not one.done():
                one()

    def ends(self, handle: Handle) -> list[str]:
        wait_until(lambda: handle.ends, meanwhile=self.turn)
        return handle.ends


@pytest.fixture()
def client(monkeypatch):
    return Client(monkeypatch)


@pytest.mark.parametrize('status, end', [(ARRIVED, 'succeed'), (FAILED, 'abort')])
def test_a_goal_ends_as_the_navigator_ends(client, status, end):
    goal = client.send('a')
    assert client.name == 'navigate_to_pose' and client.set == [['a']]
    client.server.tell(NavigatorCommand(0.1, 0.0, FOLLOWING))
    client.turn()
    assert not goal.ends
    client.server.tell(NavigatorCommand(0.0, 0.0, status, 'stuck: moved'))
    assert client.ends(goal) == [end] and goal.reason == 'stuck: moved'


def test_a_cancelled_goal_makes_the_rover_stand(client):
    goal = client.send('a')
    goal.is_cancel_requested = True
    assert client.ends(goal) == ['canceled'] and client.set == [['a'], []]


def test_a_newer_goal_aborts_an_older_one_but_a_refused_one_does_not(client):
    first = client.send('a')
    refused = client.send(REFUSED)
    assert client.ends(refused) == ['abort'] and refused.reason == 'goal: too far'
    client.turn()
    assert not first.ends
    second = client.send('b')
    assert client.ends(first) == ['abort'] and not second.ends
    assert first.reason == 'a newer goal has replaced this one'
    client.server.replace()     # by a topic
    client.server.tell(NavigatorCommand(0.0, 0.0, ARRIVED))
    assert client.ends(second) == ['abort']
