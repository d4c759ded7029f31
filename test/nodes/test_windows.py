"""Nodes enter the window of the site that physics tells, at its stamp."""

import threading
from types import SimpleNamespace

import pytest
from windows_scene import CutSite, window

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy')

from geometry_msgs.msg import PointStamped  # noqa: E402  (needs rclpy)

from lunar_rover_sim.base.errors import WorldError  # noqa: E402
from lunar_rover_sim.ground.world import follower  # noqa: E402
from lunar_rover_sim.nodes import ground_listener  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402

AT = (0.0, 0.0)


class Told:
    """A listener without a graph, and what it is told."""

    def __init__(self, monkeypatch, lockstep):
        self.site = CutSite(AT, half_m=1.6)
        monkeypatch.setattr(follower.Site, 'of', lambda world: self.site)
        node = SimpleNamespace(create_subscription=self._subscribe)
        self.listener = ground_listener.WindowListener(node, window((0.0, 0.0), 1.6, AT), lockstep)

    def _subscribe(self, kind, topic, callback, profile):
        assert kind is PointStamped and topic == 'world/window'
        self._callback = callback

    def tell(self, stamp_ns, x, y=0.0):
        """Let physics tell a window."""
        message = PointStamped()
        message.header.stamp = time_msg(stamp_ns)
        message.point.x, message.point.y = x, y
        self._callback(message)

    def middle(self, stamp_ns):
        """Return the middle of the window that is to be entered, None: none."""
        world = self.listener.at(stamp_ns)
        return None if world is None else world.ground.middle_m


def test_a_window_is_entered_at_its_stamp_and_once(monkeypatch):
    told = Told(monkeypatch, lockstep=True)
    told.tell(0, 0.0)
    assert told.middle(5) is None       # it begins there
    told.tell(100, 12.8)
    assert [told.middle(ns) for ns in (99, 100, 101)] == [None, (12.8, 0.0), None]
    told.tell(200, 12.8, 12.8)
    told.tell(300, 25.6, 12.8)
    assert told.middle(350) == (25.6, 12.8)     # of several the last one
    assert told.site.entered_m == [(12.8, 0.0), (25.6, 12.8)]


def test_who_draws_can_begin_before_physics_enters_the_next_window(monkeypatch):
    told = Told(monkeypatch, lockstep=True)
    told.tell(0, 0.0)
    assert told.listener.ahead(3.0, 0.0) is None and told.site.entered_m == []
    told.listener.ahead(8.0, 0.0)
    told.listener._follower._coming[1].result(10.0)
    coming = told.listener.ahead(8.1, 0.0)
    assert coming.ground.middle_m == (12.8, 0.0)
    told.tell(100, 12.8)
    assert told.listener.at(100) is coming and told.site.entered_m == [(12.8, 0.0)]
    assert told.listener.ahead(12.8, 0.0) is None       # it begins anew from there


def test_after_time_has_begun_anew_what_was_told_for_later_does_not_hold(monkeypatch):
    told = Told(monkeypatch, lockstep=True)
    told.tell(0, 0.0)
    told.tell(700, 12.8)
    told.tell(5, 25.6)
    assert told.middle(10) == (25.6, 0.0) and told.middle(800) is None


def test_in_real_time_the_earlier_window_stays_until_the_next_is_there(monkeypatch):
    told, ready = Told(monkeypatch, lockstep=False), threading.Event()
    made = told.site.window
    told.site.window = lambda middle_m: (ready.wait(10.0), made(middle_m))[1]
    told.tell(100, 12.8)
    assert told.middle(100) is None
    ready.set()
    told.listener._coming.result(10.0)
    assert told.middle(101) == (12.8, 0.0)


@pytest.mark.parametrize('lockstep', [True, False])
def test_ground_that_cannot_be_made_is_an_error(monkeypatch, lockstep):
    told = Told(monkeypatch, lockstep)

    def hole(middle_m):
        raise WorldError(f'a hole at {middle_m}')

    told.site.window = hole
    told.tell(100, 12.8)
    with pytest.raises(WorldError, match='a hole at'):
        for _ in range(100):
            told.middle(100)
            if told.listener._coming is not None:
                threading.Event().wait(0.05)
