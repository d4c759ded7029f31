"""The traverse study on made worlds: ways between rocks, tilt, slip, and its report."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.judge.studies.traverse import (acceptable, CORRIDOR_M, is_stranded, obstacles,
                                                    random_waypoints, traverse, Traverse)
from lunar_rover_sim.judge.studies.walking import flat_world
from lunar_rover_sim.run.scenario import Scenario


def world_of(height, half_extent_m=13.0, cell_m=0.05):
    """Return a world whose ground is height(x, y)."""
    n = 2 * round(half_extent_m / cell_m) + 1
    axis = (np.arange(n) - (n - 1) / 2) * cell_m
    x, y = np.meshgrid(axis, axis)
    ground = HeightGrid(height(x, y).astype(np.float32), cell_m)
    return dataclasses.replace(flat_world(1.0), levels=(ground,))


def with_rocks(world, xy, diameter_m):
    m = len(xy)
    rocks = Rocks(np.zeros(m, np.int32), np.zeros(m, np.int32), np.c_[xy, np.zeros(m)],
                  np.tile([1.0, 0.0, 0.0, 0.0], (m, 1)), np.ones(m, np.float32),
                  np.array([diameter_m]))
    return dataclasses.replace(world, rocks=rocks)


def drive(world, seconds, **config):
    scenario = Scenario.load('flat', {f'drive_node.{name}': config[name] for name in config})
    return traverse(scenario, seconds, world, 3)


def test_the_way_keeps_clear_of_what_is_too_high_and_only_of_that():
    rng = np.random.default_rng(5)
    xy = rng.uniform(-12.0, 12.0, (60, 2))
    xy = xy[np.linalg.norm(xy, axis=1) > 1.0]
    world = with_rocks(world_of(lambda x, y: 0.0 * x), xy, 0.3)
    assert len(obstacles(world)) == len(xy)
    points = np.vstack([[0.0, 0.0], random_waypoints(world, 60.0, np.random.default_rng(1))])
    assert np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)) >= 60.0
    for a, b in zip(points, points[1:]):
        way = a + np.linspace(0.0, 1.0, 200)[:, None] * (b - a)
        nearest = np.linalg.norm(way[:, None] - xy, axis=2).min()
        assert nearest >= CORRIDOR_M - 1e-9
    assert len(obstacles(with_rocks(world, xy, 0.05))) == 0


def test_a_world_without_a_way_is_refused():
    grid = np.stack(np.meshgrid(*2 * [np.arange(-13.0, 13.1, 0.5)]), axis=-1).reshape(-1, 2)
    world = with_rocks(world_of(lambda x, y: 0.0 * x), grid, 0.4)
    with pytest.raises(StudyError, match='no way between the rocks'):
        random_waypoints(world, 10.0, np.random.default_rng(1))
    with pytest.raises(StudyError, match='too small to traverse: 10 m'):
        random_waypoints(flat_world(5.0), 10.0, np.random.default_rng(1))


def test_gentle_waves_are_driven_with_little_slip():
    world = world_of(lambda x, y: 0.03 * np.sin(2.0 * x) * np.cos(1.7 * y))
    result = drive(world, 15.0)
    assert result.outcome == 'driven' and result.driven_s == pytest.approx(15.0)
    # 0.12 m/s, less what it takes to turn to the first waypoint at 0.15 rad/s.
    assert 0.3 < result.distance_m < 1.9
    assert -0.05 < result.slip < 0.3
    # The waves are up to 0.03 * 2 = 3.4 deg steep, and the walk itself pitches and rolls.
    assert 1.0 < result.tilt_mean_deg < result.tilt_p95_deg < result.tilt_max_deg < 20.0
    assert 0.0 < result.transport_mechanical < result.transport_electric < 10.0


def test_what_stays_tilted_past_the_limit_has_tipped_over():
    slope = math.tan(math.radians(8.0))
    result = drive(world_of(lambda x, y: slope * y), 30.0, tilt_limit_deg=5.0)
    # It has been at rest, has backed up once, and has been at rest again.
    assert result.tipped_over and 10.0 < result.driven_s < 20.0


def test_what_comes_back_goes_on():
    # The walk itself tilts it by more than 4 deg now and then; at rest it is level.
    result = drive(world_of(lambda x, y: 0.0 * x), 20.0, tilt_limit_deg=4.0)
    assert result.outcome == 'driven' and result.tilted >= 1


def test_what_is_stuck_backs_up_and_goes_another_way():
    # A slope of 35 degrees all round, 1 m away; rocks are none, so ways lead through.
    world = world_of(lambda x, y: 0.7 * np.maximum(np.hypot(x, y) - 1.0, 0.0))
    result = drive(world, 28.0, speed_mps=0.2)
    # It tilts too far on the slope, or gets no farther: either way it is stopped.
    assert result.outcome == 'driven' and result.stuck + result.tilted >= 1
    assert result.waypoints == 0
    assert np.abs(result.path_m[:, :2]).max() < 1.5
    # It has been at the slope, and away from it again.
    nearest = int(np.argmax(np.abs(result.path_m[:, :2]).max(axis=1)))
    away = np.linalg.norm(result.path_m[nearest:, :2] - result.path_m[nearest, :2], axis=1)
    assert away.max() > 0.2


def test_who_stays_in_one_place_for_long_is_stranded():
    time_s = np.arange(0.0, 100.0, 0.2)
    ahead, there = 0.1 * np.minimum(time_s, 35.0), 0.2 * np.sin(time_s)
    assert is_stranded(np.c_[ahead, there, 0.0 * time_s])
    assert not is_stranded(np.c_[0.1 * time_s, there, 0.0 * time_s])
    # So long a time must have passed.
    assert not is_stranded(np.zeros((250, 3)))
    assert not is_stranded(np.zeros((0, 3)))


def result_of(seed, outcome='driven'):
    path = np.c_[np.linspace(0.0, 5.0, 50), np.zeros(50), np.zeros(50)]
    return Traverse(seed, outcome, 60.0, 5.0, 1, 0, 0, 0.1, 1.0, 1.3, 5.0, 10.0, 20.0, 1.5, 0.005,
                    path)


def test_one_drive_in_twenty_may_tip_over():
    assert acceptable([result_of(k) for k in range(19)] + [result_of(19, 'tipped over')])
    assert not acceptable([result_of(k, 'tipped over') for k in range(2)])
    assert not acceptable([result_of(1), result_of(2, 'the simulation diverged')])
    assert not acceptable([result_of(1, 'tipped over'), result_of(2, 'stranded')])
