"""The window of a site that goes on with a rover."""

import threading

import pytest
from waiting import wait_until
from windows_scene import CutSite, window

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world.follower import Follower

AT = (0.0, 0.0)


def start(site, middle_m=(0.0, 0.0)):
    """Return a follower in a window of a site."""
    return Follower(window(middle_m, 1.6, AT), site)


@pytest.fixture(name='site')
def _site():
    return CutSite(AT, half_m=1.6, reach_m=64.0)


def test_it_changes_where_the_site_says(site):
    follower = start(site)
    middles = [follower.at(x, y).ground.middle_m for x, y in (
        (3.0, 2.0), (9.5, 0.0), (9.7, 0.0), (9.5, 0.0), (3.3, 0.0), (3.1, -9.7), (3.1, -3.0))]
    assert middles == [(0.0, 0.0), (0.0, 0.0), (12.8, 0.0), (12.8, 0.0), (12.8, 0.0),
                       (0.0, -12.8), (0.0, 0.0)]


def test_the_next_window_is_made_once_ahead(site):
    follower = start(site)
    for k in range(50):
        follower.at(0.19 * k, 0.1 * k)
    wait_until(lambda: follower.next)
    known = follower.next
    assert site.entered_m == [(12.8, 0.0)] and known.ground.middle_m == (12.8, 0.0)
    assert follower.at(9.7, 5.0) is known and follower.next is None
    assert site.entered_m == [(12.8, 0.0)]


def test_another_way_than_expected(site):
    """It turns north before the eastern window is entered."""
    follower = start(site)
    follower.at(6.0, 0.0)
    wait_until(lambda: follower.next)
    assert follower.at(6.0, 9.7).ground.middle_m == (0.0, 12.8)
    assert site.entered_m[:2] == [(12.8, 0.0), (0.0, 12.8)]


def test_a_window_that_is_being_made_is_waited_for(site):
    ready, made = threading.Event(), site.window

    def slow(middle_m):
        ready.wait(10.0)
        return made(middle_m)

    site.window = slow
    follower = start(site)
    follower.at(8.0, 0.0)
    assert follower.next is None
    threading.Timer(0.1, ready.set).start()
    assert follower.at(9.7, 0.0).ground.middle_m == (12.8, 0.0)


def test_ground_that_cannot_be_made_is_an_error_only_where_it_is_needed(site):
    def hole(middle_m):
        raise WorldError(f'a hole at {middle_m}')

    site.window = hole
    follower = start(site)
    assert follower.at(8.0, 0.0).ground.middle_m == (0.0, 0.0)
    follower.close()
    assert follower.next is None
    with pytest.raises(WorldError, match='a hole at'):
        follower.at(9.7, 0.0)


def test_the_end_of_a_site_and_of_a_world_made_by_hand(site):
    assert start(site).end == 'the site ends at x = -65.6 and 65.6 m, y = -65.6 and 65.6 m'
    assert start(site).holds(65.5, -65.5) and not start(site).holds(0.0, 65.7)
    alone = Follower(window((12.8, 0.0), 1.6, AT))
    assert alone.end == 'the ground ends at 1.60 m around x = 12.8 m, y = 0 m'
    assert alone.at(99.0, 0.0) is alone.world and not alone.holds(0.0, 0.0)
