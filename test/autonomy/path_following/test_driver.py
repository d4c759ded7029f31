"""The driver on a kinematic unicycle: profiles, routes, and the reasons to stop."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.autonomy.path_following.config import DriveConfig
from lunar_rover_sim.autonomy.path_following.driver import DONE, Driver, DRIVING, STOPPED, WAITING
from lunar_rover_sim.autonomy.path_following.route import make_route
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import wxyz_from_rpy

DT_NS = 50_000_000
DT = DT_NS * 1e-9


class Unicycle:
    """Does what it is told; `grip` is the share of the velocity that becomes motion."""

    def __init__(self, driver, x=0.0, y=0.0, heading=0.0):
        self.driver = driver
        self.x, self.y, self.heading = x, y, heading
        self.stamp_ns = 0
        self.grip = 1.0
        self.path, self.commands = [], []

    def run(self, seconds, roll=0.0, pitch=0.0):
        for _ in range(round(seconds / DT)):
            command = self.driver.update(self.stamp_ns, (self.x, self.y, 0.3),
                                         wxyz_from_rpy(roll, pitch, self.heading))
            self.heading += self.grip * command.yaw_rate_radps * DT
            self.x += self.grip * command.forward_mps * DT * math.cos(self.heading)
            self.y += self.grip * command.forward_mps * DT * math.sin(self.heading)
            self.stamp_ns += DT_NS
            self.commands.append(command)
            self.path.append((self.x, self.y))
            if command.status in (DONE, STOPPED):
                break
        return command


def far_from(route, path):
    """Return the distance of each point of a path from a route [m]."""
    dense = route.at(np.arange(0.0, route.length_m, 0.02))
    return np.array([np.min(np.linalg.norm(dense - p, axis=1)) for p in path])


def test_waypoints_outside_the_world_are_refused():
    route = DriveConfig(mode='waypoints', waypoints_x_m=(1.0, 9.8), waypoints_y_m=(0.0, 0.0))
    with pytest.raises(ConfigError, match=r'waypoints_x_m: 9.8 is not valid; valid is within'):
        Driver(route, 10.0)
    Driver(route, 100.0)
    Driver(dataclasses.replace(route, relative=True), 10.0)     # the start is not known yet


def test_nothing_drives_nowhere_even_upside_down():
    command = Unicycle(Driver(DriveConfig(), 10.0)).run(20.0, roll=3.0)
    assert (command.forward_mps, command.yaw_rate_radps, command.status) == (0.0, 0.0, WAITING)


def test_profile_begins_each_velocity_at_its_time():
    config = DriveConfig(mode='profile', start_delay_s=1.0, profile_times_s=(0.0, 2.0, 4.0),
                         profile_forward_mps=(0.1, 0.2, 0.0),
                         profile_yaw_rate_radps=(0.0, -0.1, 0.0))
    rover = Unicycle(Driver(config, 100.0))
    command = rover.run(10.0)
    assert command.status == DONE and 'profile' in command.reason
    speeds = [c.forward_mps for c in rover.commands]
    assert speeds == [0.0] * 20 + [0.1] * 40 + [0.2] * 40 + [0.0]
    assert [c.yaw_rate_radps for c in rover.commands[60:100]] == [-0.1] * 40
    assert rover.commands[0].status == WAITING and rover.commands[20].status == DRIVING
    assert rover.commands[0].reason.startswith('until start_delay_s ')


@pytest.mark.parametrize('offset', [0.0, 0.6, -1.0])
def test_pursuit_converges_on_a_line(offset):
    config = DriveConfig(mode='waypoints', waypoints_x_m=(0.0, 10.0), waypoints_y_m=(0.0, 0.0))
    rover = Unicycle(Driver(config), 0.0, offset, 0.3)
    command = rover.run(200.0)
    assert command.status == DONE
    later = np.array(rover.path)[len(rover.path) // 2:]
    assert np.abs(later[:, 1]).max() < 0.02
    assert math.hypot(rover.x - 10.0, rover.y) <= config.goal_tolerance_m


@pytest.mark.parametrize('radius', [0.9, 2.0])
def test_pursuit_converges_on_a_circle(radius):
    config = DriveConfig(mode='waypoints', shape='circle', shape_size_m=2.0 * radius, laps=2)
    rover = Unicycle(Driver(config), 1.0, -2.0, 0.7)
    assert rover.run(1500.0).status == DONE
    centre = np.array([1.0 - radius * math.sin(0.7), -2.0 + radius * math.cos(0.7)])
    distance = np.linalg.norm(np.array(rover.path) - centre, axis=1)
    # A chord of the lookahead d cuts the circle by d^2 / (8 r) at most.
    assert np.abs(distance - radius).max() < 0.5 ** 2 / (8.0 * radius) + 0.01
    length = np.sum(np.linalg.norm(np.diff(rover.path, axis=0), axis=1))
    assert length == pytest.approx(2.0 * 2.0 * math.pi * radius, rel=0.05)


@pytest.mark.parametrize('shape, mode', [('square', 'waypoints'), ('figure_eight', 'spline'),
                                         ('out_and_back', 'waypoints')])
def test_every_shape_is_driven_to_its_end(shape, mode):
    config = DriveConfig(mode=mode, shape=shape)
    rover = Unicycle(Driver(config, 100.0), heading=-2.0)
    command = rover.run(400.0)
    assert command.status == DONE
    route = make_route(config, (0.0, 0.0), -2.0)
    # Corners are cut at the lookahead distance, no more.
    assert far_from(route, rover.path).max() < 0.3
    reached = [np.min(np.linalg.norm(np.array(rover.path) - p, axis=1)) for p in route.points_m]
    assert max(reached) < 0.3
    # All of these come back.
    assert math.hypot(rover.x, rover.y) < 0.3


def test_a_figure_eight_is_driven_left_then_right():
    rover = Unicycle(Driver(DriveConfig(mode='spline', shape='figure_eight', shape_size_m=3.0)))
    rover.run(400.0)
    y = np.array(rover.path)[:, 1]
    assert y.max() > 2.8 and y.min() < -2.8
    assert np.argmax(y) < np.argmin(y)


def test_a_spline_passes_its_waypoints_and_does_not_stray():
    x, y = (2.0, 4.0, 3.0, 0.0), (1.0, -1.0, -3.0, -3.0)
    config = DriveConfig(mode='spline', waypoints_x_m=x, waypoints_y_m=y)
    rover = Unicycle(Driver(config))
    assert rover.run(300.0).status == DONE
    for point in zip(x, y):
        assert np.min(np.linalg.norm(np.array(rover.path) - point, axis=1)) < 0.25


def test_relative_waypoints_start_at_the_pose():
    config = DriveConfig(mode='waypoints', relative=True, waypoints_x_m=(3.0,),
                         waypoints_y_m=(0.0,), goal_tolerance_m=0.1)
    rover = Unicycle(Driver(config), 5.0, 5.0, math.pi / 2.0)
    assert rover.run(100.0).status == DONE
    assert math.hypot(rover.x - 5.0, rover.y - 8.0) < 0.1


def test_a_goal_behind_is_turned_to_first():
    config = DriveConfig(mode='waypoints', start_delay_s=0.0, waypoints_x_m=(-3.0,),
                         waypoints_y_m=(0.1,))
    rover = Unicycle(Driver(config))
    rover.run(5.0)
    assert all(c.forward_mps == 0.0 and c.yaw_rate_radps == 0.15 for c in rover.commands)
    assert rover.run(100.0).status == DONE


def test_yaw_rate_is_bounded_and_speed_gives_way():
    config = DriveConfig(mode='waypoints', shape='circle', shape_size_m=1.0, lookahead_m=0.3)
    rover = Unicycle(Driver(config))
    rover.run(200.0)
    commands = [c for c in rover.commands if c.status == DRIVING]
    assert max(abs(c.yaw_rate_radps) for c in commands) <= 0.15 + 1e-12
    assert min(c.forward_mps for c in commands) < 0.1


@pytest.mark.parametrize(('roll', 'pitch'), [(0.95, 0.0), (0.0, -0.95), (0.7, 0.7), (3.1, 0.0)])
def test_stops_when_tilted_and_says_so(roll, pitch):
    config = DriveConfig(mode='profile')
    rover = Unicycle(Driver(config, 10.0))
    rover.run(2.0, 0.4, 0.4)
    assert rover.commands[-1].status == DRIVING
    command = rover.run(1.0, roll, pitch)
    assert command.status == STOPPED and 'tilt' in command.reason
    assert (command.forward_mps, command.yaw_rate_radps) == (0.0, 0.0)
    assert rover.run(1.0).status == STOPPED, 'what has stopped stays stopped'
    rover.driver.reset()
    assert rover.run(5.0).status == DRIVING


def test_stops_at_the_edge_of_the_world():
    rover = Unicycle(Driver(DriveConfig(mode='profile', border_m=2.0), 5.0))
    command = rover.run(60.0)
    assert command.status == STOPPED and 'out of the world' in command.reason
    assert 3.0 < rover.x < 3.02


CASES = [{'mode': 'profile'}, {'mode': 'waypoints', 'waypoints_x_m': (9.0,),
                               'waypoints_y_m': (0.0,)},
         {'mode': 'spline', 'shape': 'figure_eight'},
         {'mode': 'waypoints', 'waypoints_x_m': (-9.0,), 'waypoints_y_m': (0.0,)}]


@pytest.mark.parametrize('values', CASES)
def test_stuck_is_told_after_ten_seconds(values):
    rover = Unicycle(Driver(DriveConfig(start_delay_s=0.0, **values)))
    assert rover.run(6.0).status == DRIVING
    rover.grip = 0.0
    began_ns = rover.stamp_ns
    command = rover.run(30.0)
    assert command.status == STOPPED and 'stuck' in command.reason
    # The ten seconds may begin with the last 0.1 m that count as none: 2.2 s of a turn.
    assert 7.7 <= (rover.stamp_ns - began_ns) * 1e-9 <= 11.0


@pytest.mark.parametrize('values', CASES)
def test_slow_is_not_stuck(values):
    rover = Unicycle(Driver(DriveConfig(**values)))
    rover.grip = 0.4
    assert rover.run(60.0).status == DRIVING


def test_standing_by_profile_is_not_stuck():
    config = DriveConfig(mode='profile', profile_times_s=(0.0, 30.0),
                         profile_forward_mps=(0.0, 0.1), profile_yaw_rate_radps=(0.0, 0.0))
    assert Unicycle(Driver(config)).run(35.0).status == DRIVING


def test_stuck_can_be_switched_off():
    rover = Unicycle(Driver(DriveConfig(mode='profile', stuck_time_s=0.0)))
    rover.grip = 0.0
    assert rover.run(60.0).status == DRIVING


def test_a_pose_that_is_not_finite_stops():
    driver = Driver(DriveConfig(mode='profile'), 10.0)
    command = driver.update(0, (math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    assert command.status == STOPPED and 'finite' in command.reason


def test_time_that_goes_backward_starts_anew():
    rover = Unicycle(Driver(DriveConfig(mode='profile', start_delay_s=1.0)))
    rover.run(3.0)
    rover.stamp_ns = 0
    assert rover.run(DT).status == WAITING


def test_the_same_poses_give_the_same_commands():
    runs = []
    for _ in range(2):
        rover = Unicycle(Driver(DriveConfig(mode='spline', shape='figure_eight')))
        rover.run(60.0)
        runs.append(rover.commands)
    assert runs[0] == runs[1]


@pytest.mark.parametrize(('values', 'message'), [
    ({'mode': 'profil'}, "mode: 'profil' .*profile"),
    ({'mode': 'waypoints'}, 'waypoints_x_m: no elements'),
    ({'mode': 'spline'}, 'waypoints_x_m: no elements'),
    ({'waypoints_x_m': (1.0,)}, 'waypoints_y_m: 0 elements given; valid is 1'),
    ({'profile_forward_mps': (1.0, 2.0)}, 'profile_forward_mps: 2 elements'),
    ({'profile_times_s': (1.0, 1.0), 'profile_forward_mps': (0.0, 0.0),
      'profile_yaw_rate_radps': (0.0, 0.0)}, 'profile_times_s: .*increasing'),
])
def test_configurations_that_do_not_fit_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        DriveConfig(**values)


def test_waypoints_all_on_the_start_are_refused():
    config = DriveConfig(mode='waypoints', start_delay_s=0.0, waypoints_x_m=(0.0,),
                         waypoints_y_m=(0.0,))
    with pytest.raises(ConfigError, match='waypoints: all lie on one spot'):
        Driver(config).update(0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
