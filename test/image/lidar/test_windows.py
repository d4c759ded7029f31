"""One place of a site, scanned from windows of it."""

import numpy as np
import pytest
from site_windows import cut, Windows
import worlds

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.image.lidar.lidar import Lidar
from lunar_rover_sim.image.lidar.optics import LidarConfig
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import moved, RoverPose

ROVER = RoverDescription()
QUIET = LidarConfig(noise=False)
MIDDLE = np.array([1286.4, -985.6, 0.0])
NEAR_M = 15.0       # within both windows


@pytest.fixture(scope='module')
def windows():
    """Return two windows whose middles are 12.8 m apart, far from the origin of the site."""
    wide = worlds.small(2, size_m=64.0, cell_m=0.05)
    return [cut(wide, (x, 0.0), [1025, 225, 253], (1286.4, -985.6)) for x in (-6.4, 6.4)]


@pytest.fixture(scope='module')
def state(windows):
    """Return a rover between both middles."""
    return RoverPose(standing(windows[0], *MIDDLE[:2], 30.0))


@pytest.fixture(scope='module')
def lidar(windows):
    """Return the sensor in the first window, to which tests that leave it come back."""
    return Lidar(windows[0], ROVER, QUIET)


def trodden(x_m, y_m):
    """Return an overlay with pits around a place."""
    overlay = Overlay()
    for angle in np.linspace(0.0, 2.0 * np.pi, 30):
        overlay.put(round((x_m + 2.2 * np.cos(angle)) / 0.005) - 30,
                    round((y_m + 2.2 * np.sin(angle)) / 0.005) - 30,
                    np.full((60, 60), -0.05), np.zeros((60, 60)))
    return overlay


def ranges(lidar, state):
    """Return the ranges of a scan, NaN beyond what is in both windows."""
    found = lidar.scan(state).returns.range_m
    return np.where(found < NEAR_M, found, np.nan)


def test_two_windows_have_one_scan(windows, lidar, state):
    first, whole = ranges(lidar, state), lidar.scan(state)
    lidar.ahead(windows[1])
    lidar.enter(windows[1])
    assert lidar.world is windows[1]
    second = ranges(lidar, state)
    assert np.isfinite(first).mean() > 0.3
    assert (np.isfinite(first) == np.isfinite(second)).mean() > 0.9999
    both = np.isfinite(first) & np.isfinite(second)
    assert (np.abs(first[both] - second[both]) < 1e-5).mean() > 0.9999
    np.testing.assert_array_equal(lidar.scan(state).p, whole.p)     # in the site
    lidar.enter(windows[0])
    np.testing.assert_array_equal(ranges(lidar, state), first)


def test_a_window_in_its_own_frame_has_the_same_scan(windows, lidar, state):
    there = lidar.scan(state)
    own = moved(state, -np.array([*windows[0].ground.middle_m, 0.0]))
    here = Lidar(windows[0].local(), ROVER, QUIET).scan(own)
    same = np.abs(there.returns.range_m - here.returns.range_m) < 1e-6
    assert same[np.isfinite(there.returns.range_m)].mean() > 0.9999


def test_tracks_stay(windows, state):
    lidar = Lidar(windows[0], ROVER, QUIET)
    untouched = ranges(lidar, state)
    lidar.follow(trodden(*MIDDLE[:2]))
    first = ranges(lidar, state)
    lidar.enter(windows[1])
    second = ranges(lidar, state)
    assert (np.abs(first - untouched) > 0.01).sum() > 100
    both = np.isfinite(first) & np.isfinite(second)
    assert (np.abs(first[both] - second[both]) < 1e-5).mean() > 0.9999


def test_beside_the_window(lidar, state):
    with pytest.raises(ConfigError, match=r'valid is within 25.6 m of \(1280, -985.6\), in x'):
        lidar.scan(moved(state, np.array([30.0, 0.0, 0.0])))


def test_the_window_follows_the_sensor(windows, lidar, state):
    """Beyond three quarters of the way to the next middle it scans the next window."""
    site = Windows(windows)
    moving = Lidar(windows[0], ROVER, QUIET, follower=Follower(windows[0], site))
    for x, there in ((0.0, 0), (3.0, 0), (3.3, 1), (0.0, 1), (-3.3, 0)):
        scan = moving.scan(moved(state, np.array([x, 0.0, 0.0])))
        assert moving.world is windows[there] and np.isfinite(scan.returns.range_m).any()
    assert site.asked.count(windows[1].ground.middle_m) == 1     # made ahead, not once more
    np.testing.assert_array_equal(moving.scan(state).returns.range_m,
                                  lidar.scan(state).returns.range_m)
