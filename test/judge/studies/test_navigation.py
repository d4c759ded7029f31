"""A rover that sees drives around a rock on which a blind one hangs; cases, store, report."""

import dataclasses

import mujoco
import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.judge.studies.navigation import (ARRIVED, BLIND, Case, cases, Contacts,
                                                      drive_to, DriveStore, goal_of, KNOWN,
                                                      report_text, SEEN, write_all)
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario


def world_with_a_rock():
    """Return a plain with a rock in front of the rover."""
    world = worlds.small(1, **worlds.BARE)
    rocks, shapes = worlds.small(3).rocks, worlds.small(3).rock_shapes
    size = int(np.argmin(np.abs(rocks.size_classes_m - 0.35)))
    one = Rocks(np.zeros(1, np.int32), np.full(1, size, np.int32), np.array([[1.3, 0.0, 0.06]]),
                np.array([[1.0, 0.0, 0.0, 0.0]]), np.ones(1, np.float32), rocks.size_classes_m)
    return dataclasses.replace(world, rocks=one, rock_shapes=shapes)


@pytest.fixture(scope='module')
def drives():
    """Return drives of those who see and who are blind, to a goal behind a rock."""
    scenario, world = Scenario.load('flat', ['render_node.camera.width=320',
                                             'render_node.camera.height=240']), world_with_a_rock()
    return {driver: drive_to(scenario, world, (2.6, 0.0), driver, limit_s=limit_s)
            for driver, limit_s in ((SEEN, 60.0), (BLIND, 30.0))}


def test_who_sees_arrives_and_who_is_blind_does_not(drives):
    seen, blind = drives[SEEN], drives[BLIND]
    assert seen.arrived and seen.belly_contacts == 0 and seen.goal_error_m < 0.3
    assert blind.belly_high <= blind.belly_contacts
    assert 1.0 < seen.way_m / 2.6 < 1.5 and seen.shortest_m > 2.6
    assert np.hypot(*(seen.path_m - (1.3, 0.0)).T).min() > 0.25
    assert not blind.arrived or blind.belly_contacts > 0 or blind.tilt_max_deg > 15.0


@pytest.mark.parametrize('clearance_m, high', [(0.049, 2), (0.5, 0)])
def test_contacts_of_the_belly_are_counted_by_the_height_of_the_rock(clearance_m, high):
    """The chassis is put onto the rock, taken away, and put there again."""
    scenario, world = Scenario.load('flat'), world_with_a_rock()
    around = np.stack(np.meshgrid(np.linspace(0.9, 1.7, 161), np.linspace(-0.4, 0.4, 161)), -1)
    top_m = float(TrueSurface(world).heights(around.reshape(-1, 2))[0].max())
    with Simulation(world, scenario.rover, scenario.physics_node) as simulation:
        model, data = simulation.model, simulation.data
        belly = Contacts(simulation, clearance_m)
        rock = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0])
        assert belly.rise_m(rock) == pytest.approx(top_m, abs=0.02) and top_m > 0.1
        for time_s, x in ((0.0, 1.3), (0.1, 1.3), (1.0, 0.0), (2.0, 1.3)):
            data.qpos[:3] = x, 0.0, top_m
            mujoco.mj_forward(model, data)
            belly.add(time_s)
    assert (belly.rocks, belly.high) == (2, high)


def test_cases_come_seed_by_seed_and_the_sun_is_for_those_who_see():
    found = cases(['baseline'], [3.0, 6.0], [SEEN, KNOWN], [1, 2])
    assert len(found) == 2 * (2 + 1)
    assert [case.seed for case in found] == sorted(case.seed for case in found)


def test_a_finished_drive_comes_back_and_other_settings_do_not(drives, tmp_path):
    case = Case('flat', 6.0, SEEN, 1)
    store = DriveStore(tmp_path / 'study', 'settings', resume=False)
    store.save(case, drives[SEEN])
    again = DriveStore(tmp_path / 'study', 'settings', resume=True).load(case)
    assert again is not None and again.outcome == ARRIVED
    assert np.array_equal(again.path_m, drives[SEEN].path_m)
    assert dataclasses.replace(again, path_m=0) == dataclasses.replace(drives[SEEN], path_m=0)
    with pytest.raises(StudyError, match='was made with other settings'):
        DriveStore(tmp_path / 'study', 'other', resume=True)
    with pytest.raises(StudyError, match='is no study to resume'):
        DriveStore(tmp_path, 'settings', resume=True)
    damaged, = (tmp_path / 'study' / 'drives').iterdir()
    for content in (b'{"seed": 4}', b'\xff', b'[' * 100_000):
        damaged.write_bytes(content)
        with pytest.raises(StudyError, match=f'{damaged.name}: is no drive of this study'):
            store.load(case)


def test_the_report_counts_and_compares(drives, tmp_path):
    many = {}
    for seed in range(1, 7):
        many[Case('flat', 6.0, SEEN, seed)] = drives[SEEN]
        many[Case('flat', 6.0, BLIND, seed)] = dataclasses.replace(
            drives[BLIND], outcome='stuck')
    text = report_text(many, 2.6)
    assert '| flat | 6 | seen | 6 | 100 [61, 100] |' in text
    assert '6 stuck' in text
    assert ('against blind: n = 6, effect -1.00, p = 0.031, q = 0.031: a difference is shown; '
            'alone arrived 6 against 0, q = 0.031 of 2 tests.') in text
    write_all(many, 2.6, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {'navigation.md', 'navigation.csv',
                                                          'navigation.png'}
    assert len((tmp_path / 'navigation.csv').read_text().splitlines()) == 13


def test_goals_are_where_a_way_leads_and_not_beyond_the_world():
    scenario, world = Scenario.load('flat'), world_with_a_rock()
    goal = goal_of(scenario, world, 3.0)
    assert np.hypot(*goal) == pytest.approx(3.0, abs=0.01)
    assert goal == goal_of(scenario, world, 3.0)
    with pytest.raises(StudyError, match='--distance: 30 is not valid'):
        goal_of(scenario, world, 30.0)


def test_goals_are_around_the_start_and_the_own_one_of_a_scenario_counts():
    world = world_with_a_rock()
    away = Scenario.load('flat', ['physics_node.start.x_m=-2', 'physics_node.start.y_m=1'])
    assert np.hypot(*np.subtract(goal_of(away, world, 2.0), (-2.0, 1.0))) == pytest.approx(
        2.0, abs=0.01)
    own = ['navigator_node.has_goal=true', 'navigator_node.goal_x_m=2',
           'navigator_node.goal_y_m=0.5']
    assert goal_of(Scenario.load('flat', own), world, 3.0) == (2.0, 0.5)
    # The way is that from the start: the straight one is free.
    drive = drive_to(away, world, (-2.0, -1.0), KNOWN, limit_s=1.0)
    assert drive.shortest_m == pytest.approx(2.0, abs=0.1)
