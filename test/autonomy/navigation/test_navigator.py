"""The navigator on maps that a point rover drives over: it arrives, or says why not."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.command import Failure, Status
from lunar_rover_sim.autonomy.navigation.config import NavigatorConfig
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.planner import Planner
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.frames import wxyz_from_rpy

PERIOD_NS = 100_000_000
N, CELL = 160, 0.05     # 8 m
RADIUS_M = 0.163


def ground(*walls, value=100):
    cost = np.zeros((N, N), np.int8)
    for x0, x1, y0, y1 in walls:
        r0, r1, c0, c1 = (max(0, round((v + 4.0) / CELL)) for v in (y0, y1, x0, x1))
        cost[r0:r1, c0:c1] = value
    return cost


class Rover:
    """A point that does what it is told, unless a wall or a test holds it."""

    def __init__(self, navigator, cost, x=-2.0, y=0.0):
        self.navigator, self.cost = navigator, cost
        self.x, self.y, self.yaw, self.pitch, self.roll = x, y, 0.0, 0.0, 0.0
        self.now_ns, self.held, self.commands, self.way_m = 0, False, [], 0.0

    def step(self, **changes):
        if len(self.commands) % 4 == 0 or self.cost is not self.seen.cost:
            self.seen = Traversability(self.now_ns, np.array([-4.0, -4.0]), CELL, self.cost)
        said = {'pose_ns': self.now_ns, 'grid': self.seen, **changes}
        command = self.navigator.update(
            self.now_ns, said['pose_ns'], (self.x, self.y, 0.1),
            wxyz_from_rpy(self.roll, self.pitch, self.yaw), said['grid'])
        dt = PERIOD_NS * 1e-9
        if not self.held:
            self.yaw += dt * command.yaw_rate_radps
            self.x += dt * command.forward_mps * np.cos(self.yaw)
            self.y += dt * command.forward_mps * np.sin(self.yaw)
            self.way_m += dt * abs(command.forward_mps)
        self.now_ns += PERIOD_NS
        self.commands.append(command)
        return command

    def drive(self, seconds=200.0, **changes):
        for _ in range(round(seconds * 10)):
            if self.step(**changes).status.is_end:
                break
        return self.commands[-1]


def made(cost, goal=(2.0, 0.0), x=-2.0, **values):
    config = NavigatorConfig(**{'has_goal': True, 'goal_x_m': goal[0], 'goal_y_m': goal[1],
                                'start_delay_s': 0.0, **values})
    return Rover(Navigator(config, RADIUS_M, 25.6), cost, x)


def test_it_arrives_around_a_wall():
    rover = made(ground((-0.2, 0.0, -4.0, 0.8)))
    assert rover.drive().status == Status.ARRIVED
    assert np.hypot(rover.x - 2.0, rover.y) <= 0.2
    assert rover.way_m < 5.5
    assert rover.step().forward_mps == 0.0 and rover.navigator.plan is not None


def test_the_same_calls_give_the_same_commands():
    runs = [made(ground((-0.2, 0.0, -4.0, 0.8))) for _ in range(2)]
    for rover in runs:
        rover.drive()
    assert runs[0].commands == runs[1].commands


def test_waypoints_are_driven_in_their_order():
    rover = made(ground(), waypoints_x_m=(-1.0, 1.0), waypoints_y_m=(1.5, -1.5))
    passed = []
    for _ in range(2500):
        rover.step()
        passed.append((rover.x, rover.y))
        if rover.commands[-1].status == Status.ARRIVED:
            break
    nearest = [np.hypot(*(np.array(passed) - p).T) for p in ((-1.0, 1.5), (1.0, -1.5))]
    assert all(d.min() < 0.4 for d in nearest)
    assert nearest[0].argmin() < nearest[1].argmin()
    assert rover.commands[-1].status == Status.ARRIVED


@pytest.mark.parametrize('heading_deg', [90.0, -150.0])
def test_it_turns_to_a_final_heading(heading_deg):
    rover = made(ground())
    rover.navigator.set_goals(np.array([(1.0, 0.5)]), np.radians(heading_deg))
    assert rover.drive().status == Status.ARRIVED
    assert any(command.status == Status.TURNING for command in rover.commands)
    off = (np.degrees(rover.yaw) - heading_deg + 180.0) % 360.0 - 180.0
    assert abs(off) < 10.0 and np.hypot(rover.x - 1.0, rover.y - 0.5) < 0.3


def test_a_new_obstacle_changes_the_plan_at_once():
    rover = made(ground())
    for _ in range(100):
        rover.step()
    before = rover.navigator.plan
    rover.cost = ground((rover.x + 0.7, rover.x + 0.9, -1.0, 0.7))
    rover.step()
    assert rover.navigator.plan is not before
    assert rover.drive().status == Status.ARRIVED


def test_it_looks_where_it_does_not_know_and_then_goes_on():
    """A corridor of a metre with a strip of unknown ground, on a map of 4 m."""
    def before_the_unknown(**values):
        rover = made(ground((-2.0, -1.5, -4.0, 4.0), value=-1), goal=(-0.4, -2.0), **values)
        rover.cost[:30] = rover.cost[50:] = 100
        rover.cost, rover.x, rover.y = rover.cost[:80, :80], -3.0, -2.0
        return rover

    rover = before_the_unknown()
    for _ in range(60):
        rover.step()
    stood = [c for c in rover.commands if c.status == Status.LOOKING and c.forward_mps == 0.0]
    assert len(stood) >= 14      # look_s
    # It stays unknown: the rover does not set foot on it, unless it is told to creep.
    assert rover.drive(400.0).failure is Failure.BLOCKED
    assert rover.x < -2.0
    creeping = before_the_unknown(creep=True)
    assert creeping.drive(400.0).status == Status.ARRIVED
    speeds = {round(c.forward_mps, 3) for c in creeping.commands}
    assert 0.05 in speeds and 0.12 in speeds


def test_it_cuts_no_corner_at_a_rock_that_it_sees_late():
    """The plan winds around the rock; the straight line to the lookahead passes too near."""
    rover = made(ground((-1.75, -1.6, -0.1, 0.1)))
    rover.yaw = np.radians(30.0)
    apart = []
    while len(apart) < 1000 and rover.step().status != Status.ARRIVED:
        apart.append(np.hypot(max(-1.75 - rover.x, rover.x + 1.6, 0.0),
                              max(abs(rover.y) - 0.1, 0.0)))
    assert rover.commands[-1].status == Status.ARRIVED
    assert min(apart) > RADIUS_M - 0.5 * CELL


@pytest.mark.parametrize('ahead_m', [0.05, 0.1])
def test_where_no_arc_is_clear_it_stands_and_then_backs_off(ahead_m):
    """All that leads on is a gap right before it, which is narrower than its circle."""
    rover = made(ground())
    for _ in range(25):
        rover.step()
    x, near, far = rover.x, rover.x + ahead_m, rover.x + ahead_m + 0.05
    rover.cost = ground((near, far, 0.1, 4.0), (near, far, -4.0, -0.1))
    places = []
    while not rover.navigator.backed_off and len(rover.commands) < 200:
        rover.step()
        places.append(rover.x)
    stood = rover.commands[25:-1]
    assert 'no arc along the plan is clear' in {command.reason for command in stood}
    assert not any(command.forward_mps for command in stood)
    assert rover.commands[-1].forward_mps < 0.0
    for _ in range(100):
        rover.step()
        places.append(rover.x)
    assert max(places) <= x and rover.x < x - 0.2


def test_a_goal_that_is_enclosed_is_given_up_after_a_look_around():
    box = [(1.0, 3.0, -1.0, -0.8), (1.0, 3.0, 0.8, 1.0), (1.0, 1.2, -1.0, 1.0),
           (2.8, 3.0, -1.0, 1.0)]
    rover = made(ground(*box))
    turned = 0.0
    while rover.commands[-1:] == [] or rover.commands[-1].status != Status.FAILED:
        before = rover.yaw
        rover.step()
        turned += abs(rover.yaw - before)
    assert rover.commands[-1].failure is Failure.BLOCKED
    assert turned > 4.5
    assert np.hypot(rover.x + 2.0, rover.y) < 1e-9


@pytest.mark.parametrize('off_m', [0.0, 0.012])
def test_it_may_stand_already_at_the_place_nearest_to_a_goal_inside_a_rock(off_m):
    """The way there has no length: a drive of 500 m ended with an error half a metre off."""
    rock = ground((1.8, 2.2, -0.2, 0.2))
    there = Planner(Traversability(0, np.array([-4.0, -4.0]), CELL, rock), NavigatorConfig().plan,
                    RADIUS_M, (-2.0, 0.0)).plan((2.0, 0.0)).points_m[-1]
    rover = made(rock, x=there[0] + off_m)
    rover.y = there[1]
    command = rover.drive()
    assert command.failure is Failure.BLOCKED and 'on an obstacle' in command.reason
    assert np.hypot(rover.x - there[0], rover.y - there[1]) < 0.1


def test_a_goal_inside_a_rock_is_blocked_at_the_nearest_place():
    rover = made(ground((1.8, 2.2, -0.2, 0.2)))
    command = rover.drive()
    assert command.failure is Failure.BLOCKED and 'on an obstacle' in command.reason
    assert 0.25 < np.hypot(rover.x - 2.0, rover.y) < 0.75


def test_a_rover_that_does_not_move_backs_off_and_gives_up_as_stuck():
    rover = made(ground(), recoveries=2)
    rover.held = True
    command = rover.drive(400.0)
    assert command.failure is Failure.STUCK
    assert sum(c.forward_mps < 0.0 for c in rover.commands) > 100


def test_what_it_bumped_into_is_driven_around():
    rover = made(ground())
    for _ in range(1500):
        # A rock that nobody sees, at 0.
        ahead = rover.x + 0.25 * np.cos(rover.yaw), rover.y + 0.25 * np.sin(rover.yaw)
        rover.held = (np.hypot(*ahead) < 0.2
                      and bool(rover.commands) and rover.commands[-1].forward_mps >= 0.0)
        if rover.step().status.is_end:
            break
    assert rover.commands[-1].status == Status.ARRIVED
    assert any(c.forward_mps < 0.0 for c in rover.commands)


def test_tilt_backs_off_and_a_rover_on_its_side_gives_up():
    rover = made(ground())
    rover.step()
    rover.pitch = np.radians(35.0)
    assert rover.step().status is not Status.BACKING    # a step rocks the body
    assert Status.BACKING in {rover.step().status for _ in range(10)}
    rover.pitch = np.radians(80.0)
    assert rover.step().failure is Failure.TILT


def test_a_body_that_rears_up_is_let_down_before_it_backs_off():
    """It undoes its last motion at once, and stands half a second when the body is down."""
    rover = made(ground())
    for _ in range(20):
        before = rover.step()
    rover.pitch = -0.6
    reared = [rover.step() for _ in range(3)]
    rover.pitch = 0.0
    after = [rover.step() for _ in range(8)]
    assert {command.status for command in reared} == {Status.LETTING_DOWN}
    assert before.forward_mps > 0.1
    assert all(-before.forward_mps < c.forward_mps < 0.0 for c in reared)
    assert not any(c.forward_mps or c.yaw_rate_radps for c in after[:4])
    assert [c.status for c in after] == [Status.LETTING_DOWN] * 4 + [Status.FOLLOWING] * 4
    assert rover.navigator.backed_off == 0
    assert rover.drive().status == Status.ARRIVED


def test_a_body_that_stays_up_is_let_down_by_going_back_not_by_standing():
    """One stood at 33 deg, with no room behind it, until it gave up."""
    rover = made(ground((-2.6, -2.45, -1.0, 1.0)))
    for _ in range(10):
        rover.step()
    rover.pitch = -0.6
    commands = [rover.step() for _ in range(30)]
    assert sum(c.forward_mps < 0.0 for c in commands) > 20


@pytest.mark.parametrize('yaw_deg', [100.0, -100.0, 20.0])
def test_where_it_cannot_back_off_straight_it_takes_its_trail(yaw_deg):
    """It has turned on a slope that it cannot leave straight back, and nowhere else is a way."""
    rover = made(ground())
    while rover.x < 0.0:
        rover.step()
    rover.yaw = np.radians(yaw_deg)
    behind = rover.x - 0.4 * np.cos(rover.yaw), rover.y - 0.4 * np.sin(rover.yaw)
    rover.cost = ground((behind[0] - 0.1, behind[0] + 0.1, behind[1] - 0.1, behind[1] + 0.1))
    rover.held = True
    for _ in range(11):     # it plans on that map
        rover.step()
    rover.held = False
    backing = []
    for _ in range(300):
        rover.pitch = np.radians(32.0 if np.hypot(rover.x - 0.05, rover.y) < 0.25 else 5.0)
        backing.append(rover.step())
        if np.hypot(rover.x - 0.05, rover.y) > 0.28:
            break
    assert np.hypot(rover.x - 0.05, rover.y) > 0.28
    assert any('on its trail' in note for note in rover.navigator.notes)
    assert max(abs(c.yaw_rate_radps) for c in backing) <= 0.35
    rover.pitch = 0.0
    assert rover.drive().status == Status.ARRIVED


def test_it_does_not_back_off_down_a_slope_on_which_it_has_turned():
    """On the rim of a crater it faced the way out, and backed into the crater until it rolled."""
    rover = made(ground(), goal=(-2.0, 3.0))
    rover.x = -1.0
    for _ in range(60):
        rover.step()
        rover.x, rover.y, rover.yaw = rover.x + 0.02, 0.0, 0.0
    edge = rover.x - 0.1
    rover.cost, rover.yaw = ground((edge, edge + 1.0, -1.0, 1.0)), np.pi
    deepest, rover.held = rover.x, True
    for _ in range(11):     # it plans on that map
        rover.step()
    rover.held = False
    for _ in range(400):
        into_m = rover.x - edge
        rover.pitch = -np.radians(30.0 + 40.0 * into_m) if into_m > 0.0 else 0.0
        rover.step()
        deepest = max(deepest, rover.x)
    assert rover.navigator.backed_off
    assert deepest < edge + 0.2 and rover.x < edge - 0.1


@pytest.mark.parametrize('aside_m', [0.0, 0.2, -0.3])
def test_it_keeps_clear_of_the_rim_of_a_crater_that_it_does_not_see(aside_m):
    """It backed off by 0.3 m, turned on an arc that led ahead, and slid in again, to 47 deg."""
    crater, radius, slip = np.array([0.0, aside_m]), 0.4, 0.06
    rover, apart = made(ground(), lookahead_m=0.4), []
    while not rover.commands or not rover.commands[-1].status.is_end:
        off = crater - (rover.x, rover.y)
        apart.append(np.linalg.norm(off) - radius - RADIUS_M)
        # Its legs slide in at the edge, and the ground falls more and more.
        tilt = np.radians(14.0 + 400.0 * (-apart[-1] - slip)) if apart[-1] < -slip else 0.2
        towards = np.arctan2(off[1], off[0]) - rover.yaw
        rover.pitch, rover.roll = tilt * np.cos(towards), -tilt * np.sin(towards)
        rover.step()
    assert rover.commands[-1].status == Status.ARRIVED
    assert rover.navigator.backed_off
    first = next(k for k, c in enumerate(rover.commands) if c.status == Status.BACKING)
    clear = first + next(k for k, far in enumerate(apart[first:]) if far > 0.0)
    assert min(apart[clear:]) > -slip
    assert rover.navigator.backed_off == 1


def on_a_rim():
    """Return a rover that has begun to back off, since the ground tilts it by 32 deg."""
    rover = made(ground())
    for k in range(40):
        rover.roll = np.radians(32.0 if k >= 20 else 0.0)
        if rover.step().status is Status.BACKING:
            break
    return rover


def test_backing_off_from_a_rim_is_not_undone():
    """Steps rock it about the limit: it was let down into the crater, until it rolled over."""
    rover = on_a_rim()
    rim, begun = rover.x, len(rover.commands)
    while rim - rover.x < 0.25 and len(rover.commands) < begun + 60:
        rover.roll = np.radians(29.0 + 3.0 * np.sin(1.5 * len(rover.commands)))
        rover.step()
    assert rim - rover.x >= 0.25
    assert all(c.forward_mps < 0.0 for c in rover.commands[begun:])
    rover.roll = 0.1
    assert rover.drive().status == Status.ARRIVED


def test_backing_off_is_undone_where_legs_dig_in_and_the_body_rises_further():
    rover = on_a_rim()
    assert rover.step().forward_mps < 0.0
    rover.roll = np.radians(42.0)
    assert rover.step().forward_mps > 0.0


def test_a_body_that_rocks_is_let_alone():
    rover = made(ground())
    for k in range(100):
        rover.pitch = -np.radians(11.0 + 10.0 * np.sin(0.4 * k))
        assert rover.step().status in (Status.FOLLOWING, Status.LOOKING)


def test_a_body_that_rears_up_in_the_dark_is_let_down_too():
    rover = made(ground())
    for _ in range(20):
        rover.step()
    seen = rover.seen
    for _ in range(20):
        before = rover.step(grid=seen)
    assert before.status is Status.WAITING
    rover.pitch = -0.6
    assert rover.step(grid=seen).status is Status.LETTING_DOWN


@pytest.mark.parametrize('pitch, walls, on_the_spot', [
    (0.0, (), True), (-0.23, (), False), (-0.23, ((0.4, 0.6, -1.5, 1.5),), True)])
def test_on_a_slope_it_turns_on_an_arc_where_there_is_room(pitch, walls, on_the_spot):
    """Turning on the spot, on 13 deg of soft ground, raised the body to 45 deg."""
    rover = made(ground(*walls), goal=(-3.0, 0.0), x=0.0, border_m=0.0, start_delay_s=5.0)
    rover.pitch = pitch
    assert rover.drive(100.0).status == Status.ARRIVED
    spot = [c for c in rover.commands if c.yaw_rate_radps and not c.forward_mps]
    assert (len(spot) > 20) == on_the_spot


def test_without_a_pose_it_stands_at_once_and_gives_up_as_lost():
    rover = made(ground())
    for _ in range(50):
        rover.step()
    assert rover.commands[-1].forward_mps > 0.0
    died = rover.now_ns - PERIOD_NS
    stopped = next(k for k in range(100) if rover.step(pose_ns=died).forward_mps == 0.0)
    assert stopped * PERIOD_NS <= 0.5e9
    assert rover.commands[-1].status == Status.WAITING and 'no pose' in rover.commands[-1].reason
    command = rover.drive(20.0, pose_ns=died)
    assert command.failure is Failure.LOST and 'no pose' in command.reason
    # Given back in time, the drive goes on.
    again = made(ground())
    for _ in range(60):
        again.step(pose_ns=None)
    assert again.drive().status == Status.ARRIVED


def test_without_maps_it_waits_and_gives_up():
    rover = made(ground())
    assert rover.step(grid=None).reason == 'no map yet'
    old = Traversability(1, np.array([-4.0, -4.0]), CELL, ground())
    command = rover.drive(90.0, grid=old)
    assert command.failure is Failure.LOST and 'no depth' in command.reason


def test_in_the_dark_it_turns_back_and_where_nothing_is_left_to_see_looks_around():
    """Only behind it is light: neither where it looks, nor where it saw something last."""
    rover = made(ground())
    for _ in range(50):
        rover.step()
    old = Traversability(rover.now_ns, np.array([-4.0, -4.0]), CELL, rover.cost)
    rover.step(grid=old)
    begun, x = rover.yaw, rover.x
    rover.yaw += 1.0
    back = [(rover.step(grid=old), rover.yaw)[1] for _ in range(200)]
    assert abs(back[-1] - begun) < 0.1 and rover.x < x + 0.3
    while abs(np.remainder(rover.yaw - begun, 2.0 * np.pi) - np.pi) > 0.5:
        command = rover.step(grid=old)
        assert command.status == Status.WAITING and command.forward_mps == 0.0
    assert rover.drive().status == Status.ARRIVED


def test_depth_that_stops_stops_the_rover_until_it_comes_again():
    rover = made(ground())
    for _ in range(50):
        rover.step()
    old = Traversability(rover.now_ns, np.array([-4.0, -4.0]), CELL, rover.cost)
    said = [rover.step(grid=old) for _ in range(80)]
    moved = [command.forward_mps > 0.0 for command in said]
    assert all(moved[:15]) and not any(moved[17:])      # map_age_s
    assert said[-1].status == Status.WAITING and said[-1].reason.startswith('no depth for ')
    assert rover.drive().status == Status.ARRIVED


def test_a_pose_that_jumps_by_a_metre_is_driven_on_from():
    """As by a SLAM program that closes a loop: what counts is the goal by the new pose."""
    rover = made(ground((0.5, 0.7, -0.5, 0.5)))
    for _ in range(100):
        rover.step()
    rover.y += 1.0
    rover.step()
    assert rover.commands[-1].status != Status.FAILED
    assert rover.drive().status == Status.ARRIVED
    assert np.hypot(rover.x - 2.0, rover.y) <= 0.2


@pytest.mark.parametrize('goal', [(np.nan, 0.0), (30.0, 0.0), (0.0, -25.0), (1.0,), 'there'])
def test_goals_that_are_none_are_refused_and_the_old_one_stays(goal):
    rover = made(ground())
    with pytest.raises(NavigationError, match='goal: .*valid'):
        rover.navigator.set_goals([goal])
    assert rover.navigator.goals_m[0] == pytest.approx((2.0, 0.0))


def test_without_a_goal_it_stands_and_new_goals_are_taken():
    rover = Rover(Navigator(NavigatorConfig(start_delay_s=0.0), 0.113), ground())
    assert rover.step().status == Status.IDLE
    rover.navigator.set_goals([(0.0, 1.0)])
    assert rover.drive().status == Status.ARRIVED
    rover.navigator.set_goals([(-1.0, -1.0)])
    assert rover.drive().status == Status.ARRIVED
    rover.navigator.set_goals([])
    assert rover.step().status == Status.IDLE


def test_time_that_goes_back_begins_the_drive_again():
    rover = made(ground())
    rover.drive()
    rover.now_ns, rover.x, rover.y = 0, -2.0, 0.0
    assert rover.drive().status == Status.ARRIVED


def test_a_goal_beside_a_rock_is_reached_from_the_next_place():
    """Its cell is too near to a rock; places within the tolerance of it are not."""
    rover = made(ground((2.16, 2.5, -0.5, 0.5)))
    assert rover.drive().status == Status.ARRIVED
    assert rover.x < 2.16 - 0.1


def test_it_looks_at_a_goal_that_seems_to_lie_on_an_obstacle():
    """What was a wrong match is gone when it has looked."""
    rover = made(ground((1.8, 2.2, -0.2, 0.2)))
    while rover.step().status != Status.LOOKING:
        assert rover.commands[-1].status not in (Status.ARRIVED, Status.FAILED)
    assert 'obstacle' in rover.commands[-1].reason
    rover.cost = ground()
    assert rover.drive().status == Status.ARRIVED


def test_stop_and_look_stands_until_a_frame_taken_at_rest():
    rover = made(ground(), stop_every_m=0.5)
    assert rover.drive().status == Status.ARRIVED
    looks = [k for k, c in enumerate(rover.commands) if c.reason == 'stops and looks']
    begins = [k for k in looks if k - 1 not in looks]
    # 3.8 m to the tolerance of the goal, one stop at the start.
    assert 7 <= len(begins) <= 9
    assert all(rover.commands[k].forward_mps == 0.0 for k in looks)
    for begin in begins:
        stood = next(k for k in range(begin, len(rover.commands)) if k not in looks) - begin
        assert 10 <= stood <= 14        # a second, and up to four steps to the next map
    walking = made(ground())
    walking.drive()
    assert not any(c.reason == 'stops and looks' for c in walking.commands)
