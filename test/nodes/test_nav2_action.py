"""NavigateToPose on stand-ins of the action's types and server: nav2_msgs is not in the wheels."""

from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip('rclpy')

from rclpy import action, callback_groups, task  # noqa: E402  (needs rclpy)
from waiting import wait_until  # noqa: E402

from lunar_rover_sim.autonomy.navigation import navigator  # noqa: E402
from lunar_rover_sim.nodes.nav2_action import NavigateToPoseServer, Progress  # noqa: E402

REFUSED = 'too far'


def progress(status, reason='', failure=None, stamp_s=1.0, left_m=3.0):
    command = navigator.NavigatorCommand(0.1, 0.0, status, reason, failure)
    return Progress(command, round(stamp_s * 1e9), 'here', left_m, left_m / 0.12, 2)


class Handle:
    """A goal of a client, and what became of it."""

    def __init__(self, pose: str) -> None:
        self.request, self.is_cancel_requested, self.ends = SimpleNamespace(pose=pose), False, []
        self.feedback: list[Any] = []
        self.publish_feedback = self.feedback.append
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
            Result=lambda: SimpleNamespace(error_msg=''),
            Feedback=lambda: SimpleNamespace(
                navigation_time=SimpleNamespace(),
                estimated_time_remaining=SimpleNamespace())), self._set_goals)

    def _take(self, node: Any, kind: Any, name: str, execute: Any, **_: Any) -> None:
        self.name, self.execute = name, execute

    def _set_goals(self, poses: Any, turns: bool) -> str | None:
        if poses == [REFUSED]:
            return 'goal: too far'
        assert turns == bool(poses)     # a goal of the action has a heading
        self.set.append(poses)
        return None

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


@pytest.mark.parametrize('status, why, end', [
    (navigator.Status.ARRIVED, None, 'succeed'),
    (navigator.Status.FAILED, navigator.Failure.STUCK, 'abort')])
def test_a_goal_ends_as_the_navigator_ends(client, status, why, end):
    goal = client.send('a')
    assert client.name == 'navigate_to_pose' and client.set == [['a']]
    client.server.tell(progress(navigator.Status.FOLLOWING))
    client.turn()
    assert not goal.ends
    client.server.tell(progress(status, 'stuck: moved', why))
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
    client.server.tell(progress(navigator.Status.ARRIVED))
    assert client.ends(second) == ['abort']


def test_a_goal_is_told_how_far_it_is(client):
    goal = client.send('a')
    for stamp_s, left_m in ((5.0, 3.0), (5.1, 2.99), (7.5, 2.7)):
        client.server.tell(progress(navigator.Status.FOLLOWING, stamp_s=stamp_s, left_m=left_m))
        before = len(goal.feedback)
        if stamp_s != 5.1:      # twice a second
            wait_until(lambda n=before: len(goal.feedback) > n, meanwhile=client.turn)
    first, last = goal.feedback[0], goal.feedback[-1]
    assert first.distance_remaining == 3.0 and first.navigation_time.sec == 0
    assert (last.navigation_time.sec, last.navigation_time.nanosec) == (2, 500_000_000)
    assert last.estimated_time_remaining.sec == 22      # 2.7 m at 0.12 m/s
    assert last.current_pose == 'here' and last.number_of_recoveries == 2
