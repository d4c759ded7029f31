"""Incidents, unknown ground and stops of recorded drives whose answers are known."""

import json

import numpy as np
import pytest
import synthetic_bag as synthetic
from synthetic_bag import header, item, msg, odometry, quaternion, text
import worlds

from lunar_rover_sim.autonomy.navigation.traversability import belly_clearance_m
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.frames import matrix_from_wxyz, ODOM_FRAME, se3, wxyz_from_rpy
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.judge.evaluation.drive_evaluation import (BELLY, evaluate_drive, HIGH,
                                                               ROLL_OVER, TILT)
from lunar_rover_sim.judge.evaluation.map_evaluation import TrueSurface
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.scenario import Scenario

STEP_NS = 100_000_000


def poses(*placed):
    """Odometry every 0.1 s: x, y, z [m] and roll [deg] each."""
    return [text(topics.SCENARIO, Scenario.load('flat').to_yaml())] + [
        item(topics.ODOM, odometry(k * STEP_NS, ODOM_FRAME, se3(matrix_from_wxyz(
            wxyz_from_rpy(np.radians(roll), 0.0, 0.0)), (x, y, z))))
        for k, (x, y, z, roll) in enumerate(placed, 1)]


def grid(stamp_ns, unknown_from_m):
    """A map of 10 m around the origin, unknown east of a place."""
    cost = np.zeros((100, 100), np.int8)
    cost[:, round((unknown_from_m + 5.0) / 0.1):] = -1
    origin = msg('geometry_msgs/Pose', position=msg('geometry_msgs/Point', x=-5.0, y=-5.0, z=0.0),
                 orientation=quaternion((1.0, 0.0, 0.0, 0.0)))
    info = msg('nav_msgs/MapMetaData', map_load_time=synthetic.time(0), resolution=0.1, width=100,
               height=100, origin=origin)
    return item(topics.TRAVERSABILITY, msg('nav_msgs/OccupancyGrid', info=info,
                                           header=header(stamp_ns, ODOM_FRAME), data=cost.ravel()))


def said(stamp_ns, state, reason=''):
    values = [msg('diagnostic_msgs/KeyValue', key='reason', value=reason)]
    status = msg('diagnostic_msgs/DiagnosticStatus', level=0, name='', message=state,
                 hardware_id='', values=values)
    return item(topics.NAVIGATOR_STATUS, msg('diagnostic_msgs/DiagnosticArray', status=[status],
                                             header=header(stamp_ns, '')))


def test_a_tilt_is_counted_once_until_the_rover_is_level(tmp_path):
    rolls = [0, 50, 40, 50, 10, 46, 20, 80, 60, 80, 0]
    bag = synthetic.write(tmp_path / 'bag', poses(*((0.1 * k, 0.0, 9.0, roll)
                                                    for k, roll in enumerate(rolls))))
    found = evaluate_drive(bag)
    assert found.incidents == {TILT: 3, ROLL_OVER: 1}
    assert found.distance_m == pytest.approx(1.0) and found.per_km(TILT) == pytest.approx(3000.0)
    assert np.isnan(found.unknown_m) and found.seen_m == 0.0


def test_unknown_ground_counts_by_the_newest_map(tmp_path):
    way = [(0.1 * k, 0.0, 9.0, 0.0) for k in range(21)]
    bag = synthetic.write(tmp_path / 'bag', [*poses(*way), grid(STEP_NS, 0.55),
                                             grid(11 * STEP_NS, 1.55)])
    # Steps to 0.6 ... 0.9 m by the first map, and to 1.6 ... 2 m by the second.
    assert evaluate_drive(bag).unknown_m == pytest.approx(0.4 + 0.5, abs=0.11)


def test_stops_and_the_end_are_told(tmp_path, capsys):
    told = [said(k * STEP_NS, state, 'why' if state == 'failed' else '') for k, state in
            enumerate(('waiting', 'following', 'looking', 'following', 'backing off', 'following',
                       'looking', 'failed'), 1)]
    bag = synthetic.write(tmp_path / 'bag', poses(*[(0.0, 0.0, 9.0, 0.0)] * 10) + told)
    found = evaluate_drive(bag)
    assert found.stops == {'looking': 2, 'backing off': 1} and found.end == 'failed why'
    assert found.standing_s == pytest.approx(0.3)
    assert execute(['evaluate', 'drive', str(bag), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['stops'] == {'looking': 2, 'backing off': 1}
    assert execute(['evaluate', 'drive', str(bag)]) == 0
    assert 'stops: 2 x looking, 1 x backing off' in capsys.readouterr().out


def test_messages_of_other_programs_that_are_none_are_named(tmp_path):
    way, none = poses(*[(0.0, 0.0, 9.0, 0.0)] * 4), said(STEP_NS, 'waiting')
    none.message.status = []
    cut, flat = grid(STEP_NS, 1.0), grid(STEP_NS, 1.0)
    cut.message.info.width = 99
    flat.message.info.resolution = 0.0
    for name, wrong, why in (('none', none, 'navigator/status: it has no status'),
                             ('cut', cut, 'map/traversability: .* 10000 cells, not 99 x 100'),
                             ('flat', flat, 'map/traversability: cells of 0 m')):
        with pytest.raises(EvaluationError, match=why):
            evaluate_drive(synthetic.write(tmp_path / name, [*way, wrong]))


def test_contacts_of_the_body_are_those_with_the_ground_and_with_high_rocks(tmp_path):
    world, rover = worlds.small(rocks={'abundance': 0.1}), RoverDescription()
    folder, clearance = save_world(world, tmp_path / 'world'), belly_clearance_m(rover)
    surface, rocks = TrueSurface(world), world.rocks.position_m[:, :2]
    inside = rocks[np.abs(rocks).max(axis=1) < 5.0]
    height, rise = surface.heights(inside)
    k = int(np.argmax(rise))
    assert rise[k] > 1.5 * clearance
    half = 0.5 * rover.chassis.height_m
    top, bare = (*inside[k], height[k] + half), (0.0, 0.0)
    side = np.linspace(-4.0, 4.0, 81)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    apart = np.linalg.norm(places[:, None] - rocks, axis=2).min(axis=1)
    bare = places[int(np.argmax(apart))]
    low = (*bare, float(surface.heights(bare)[0]) + half)
    far = (0.0, 0.0, 9.0, 0.0)
    placed = [far, (top[0], top[1], top[2] - 0.02, 0.0), (top[0], top[1], top[2] - 0.02, 0.0), far,
              far, far, far, far, (*low, 0.0), far]
    bag = synthetic.write(tmp_path / 'bag', poses(*placed))
    found = evaluate_drive(bag, folder)
    assert (found.incidents[HIGH], found.incidents[BELLY]) == (1, 1)
    assert found.seen_m == pytest.approx(found.distance_m)


def test_a_bag_without_odometry_is_refused(tmp_path):
    bag = synthetic.write(tmp_path / 'bag', [said(STEP_NS, 'waiting')])
    with pytest.raises(EvaluationError, match='holds no true odometry'):
        evaluate_drive(bag)
