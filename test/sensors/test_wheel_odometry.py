"""The wheel odometry: ways of rolling feet, and a covariance that says how wrong they are."""

import dataclasses
import math

import numpy as np
from physics_scene import simulate, trot
import pytest
import worlds

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.judge.studies.odometry import judge
from lunar_rover_sim.judge.studies.walking import walk
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.sensors.feet import FootSlip, Sinkage
from lunar_rover_sim.sensors.sensor import Platform
from lunar_rover_sim.sensors.wheel_odometry import (Rolling, RollingFeet, WheelOdometry,
                                                    WheelOdometryConfig)

ROVER = RoverDescription()
FINE = 2**20
COUNTS = WheelOdometryConfig().counts_per_turn
RIGID = Rolling.of(WheelOdometryConfig(), 'rigid')
UNSCALED = dataclasses.replace(RIGID, forward_scale=1.0, yaw_scale=1.0)


def ways(*angles: np.ndarray, counts: int = FINE) -> np.ndarray:
    """Return the summed forward way, turn and way of the legs over rows of angles."""
    feet = RollingFeet(ROVER, counts)
    return sum(np.array(dataclasses.astuple(feet.add(row))) for row in np.stack(angles, axis=-1))


def test_feet_in_step_roll_on_their_tips():
    """From -a to a the axle goes 2 (l - r) sin a over the tip, which itself rolls on by 2 r a."""
    a = 0.7
    swing = np.linspace(-a, a, 400)
    legs = ROVER.legs
    way = 2.0 * (legs.spoke_length_m - legs.tip_radius_m) * math.sin(a) \
        + 2.0 * legs.tip_radius_m * a
    for spoke in (0.0, 7.0 * legs.spoke_pitch_rad):
        forward, turn, rolled = ways(*[swing + spoke] * 4)
        assert (forward, turn, rolled) == pytest.approx((way, 0.0, way), rel=1e-5)
    assert ways(*[swing[::-1]] * 4)[0] == pytest.approx(-way, rel=1e-5)


def test_the_higher_diagonal_carries():
    """Legs of the other one hang in the air, whatever they do."""
    swing, aside = np.linspace(-0.3, 0.3, 400), np.linspace(0.9, 1.0, 400)
    carried = ways(swing, aside, -aside, swing)
    assert carried[0] == pytest.approx(ways(*[swing] * 4)[0], rel=1e-9)
    assert ways(aside, swing, swing, -aside)[0] == pytest.approx(carried[0], rel=1e-9)


def test_the_right_legs_turn_it_to_the_left():
    """By the least squares of what both feet scrape."""
    swing = np.linspace(-0.4, 0.4, 400)
    forward, turn, _ = ways(-swing, swing, -swing, swing)
    one_side = ways(*[swing] * 4)[0]
    x, y, _ = ROVER.legs.axle_positions_m()[0]
    assert forward == pytest.approx(0.0, abs=1e-9)
    assert turn == pytest.approx(one_side * y / (x * x + y * y), rel=1e-9)


def test_ways_come_in_counts_of_the_encoder():
    count_rad = 2.0 * math.pi / (8 * ROVER.motor.gear_ratio)
    angles = np.array([0.0, 0.4, 0.6, 1.4]) * count_rad
    feet = RollingFeet(ROVER, 8)
    rolled = [feet.add([angle] * 4).forward_m for angle in angles]
    assert rolled == pytest.approx([0.0, 0.0, feet.resolution_m, 0.0], rel=1e-3)


def test_the_covariance_is_that_of_random_ways():
    """Of 3000 drives whose errors are drawn as the configuration states them."""
    odometry = WheelOdometry(ROVER, FINE, Rolling(1.0, 1.0, 0.05, 0.03, 0.2))
    rng = np.random.default_rng(1)
    pose = np.zeros((3000, 3))
    feet = RollingFeet(ROVER, FINE)
    for angle in np.linspace(0.0, 60.0, 1500):
        angles = [0.9 * angle, angle, 0.9 * angle, angle]
        odometry.add(angles, 0.01)
        rolled = feet.add(angles)
        along, across, turned = (rng.normal(0.0, s, len(pose)) * math.sqrt(rolled.way_m)
                                 for s in (0.05, 0.03, 0.2))
        middle = pose[:, 2] + 0.5 * (rolled.yaw_rad + turned)
        along = along + rolled.forward_m
        pose += np.column_stack([np.cos(middle) * along - np.sin(middle) * across,
                                 np.sin(middle) * along + np.cos(middle) * across,
                                 rolled.yaw_rad + turned])
    error = pose - odometry.pose
    assert odometry.pose[2] > 0.8, 'a curve'
    # To first order in the error of the heading, which is 0.4 rad at the end.
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)),
                               np.sqrt(np.diag(odometry.covariance)), rtol=0.12)
    stated = odometry.covariance / np.sqrt(np.outer(*[np.diag(odometry.covariance)] * 2))
    np.testing.assert_allclose(np.corrcoef(error.T), stated, atol=0.12)


def test_a_step_adds_its_errors_to_those_of_before():
    """By the derivatives of a pose that goes on along its mean heading, however far it turns."""
    rolling = Rolling(1.1, 0.9, 0.05, 0.03, 0.2)
    odometry, feet = WheelOdometry(ROVER, FINE, rolling), RollingFeet(ROVER, FINE)
    rng = np.random.default_rng(3)
    angles, pose, covariance = np.zeros(4), np.zeros(3), np.zeros((3, 3))
    for _ in range(6):
        angles = angles + rng.uniform(0.2, 2.0, 4)
        odometry.add(angles, 0.01)
        rolled = feet.add(angles)
        ways = np.array([1.1 * rolled.forward_m, 0.0, 0.9 * rolled.yaw_rad])

        def reached(before_and_ways):
            x, y, heading, along, across, turned = before_and_ways
            middle = heading + 0.5 * turned
            return np.array([x + math.cos(middle) * along - math.sin(middle) * across,
                             y + math.sin(middle) * along + math.cos(middle) * across,
                             heading + turned])

        at, apart = np.concatenate([pose, ways]), 1e-6 * np.eye(6)
        slopes = np.column_stack([(reached(at + d) - reached(at - d)) / 2e-6 for d in apart])
        variance = rolled.way_m * np.array([0.05, 0.03, 0.2])**2
        covariance = (slopes[:, :3] @ covariance @ slopes[:, :3].T
                      + slopes[:, 3:] * variance @ slopes[:, 3:].T)
        pose = reached(at)
        np.testing.assert_allclose(odometry.pose, pose, atol=1e-12)
        np.testing.assert_allclose(odometry.covariance, covariance, atol=1e-9)


def test_each_ground_has_its_own_way_to_roll():
    """What is given counts; what is not is that of the ground, and of `highland` elsewhere."""
    highland = Rolling.of(WheelOdometryConfig(), 'highland')
    assert highland.yaw_scale < RIGID.yaw_scale, 'sunken feet turn the rover less'
    assert Rolling.of(WheelOdometryConfig(), 'mare') == highland
    assert Rolling.of(WheelOdometryConfig(), 'rigid', 'one of my own') == RIGID
    given = Rolling.of(WheelOdometryConfig(yaw_scale=0.6, lateral_stddev=0.0), 'rigid')
    assert given == dataclasses.replace(RIGID, yaw_scale=0.6, lateral_stddev=0.0)


@pytest.mark.parametrize('ground', ['rigid', 'highland', 'highland_loose'])
@pytest.mark.parametrize('rover', ['quad', 'hexapod'])
def test_the_packaged_rovers_roll_almost_as_their_feet_do(rover, ground):
    """They slip by a tenth at most, and a metre tells the heading to a quarter of a radian."""
    rolling = Rolling.of(WheelOdometryConfig(), ground, rover)
    assert 0.9 < rolling.forward_scale < 1.1 and 0.4 < rolling.yaw_scale < 1.2
    assert 0.0 < rolling.lateral_stddev < rolling.forward_stddev < 0.1 < rolling.yaw_stddev < 0.3


def test_speed_and_its_variance():
    odometry = WheelOdometry(ROVER, FINE, UNSCALED)
    assert [odometry.twist.tolist(), odometry.twist_variance.tolist()] == [[0.0] * 2, [0.0] * 3]
    odometry.add([0.0] * 4, 0.005)
    # Each of two readings of two legs is wrong by up to half a count; across half the track.
    count_m = 2.0 * math.pi * ROVER.legs.spoke_length_m / (FINE * ROVER.motor.gear_ratio)
    along = 4.0 * 0.25 * count_m**2 / 12.0 / 0.005**2
    half_track_m = ROVER.legs.axle_positions_m()[0][1]
    assert not odometry.twist.any()
    assert odometry.twist_variance == pytest.approx([along, along, along / half_track_m**2],
                                                    rel=1e-9, abs=0.0)
    odometry.add([0.01] * 4, 0.005)
    way = 0.01 * ROVER.legs.spoke_length_m
    assert odometry.twist == pytest.approx([way / 0.005, 0.0], rel=1e-3)
    assert math.sqrt(odometry.twist_variance[0]) == pytest.approx(
        UNSCALED.forward_stddev * math.sqrt(way) / 0.005, rel=1e-2)


@pytest.fixture(scope='module')
def walks():
    """Give four walks on curves over rough ground."""
    found = []
    for seed, (forward, turn) in enumerate([(0.15, 0.1), (0.1, -0.15), (0.2, 0.0), (-0.1, 0.1)]):
        with Simulation(worlds.small(seed + 1), ROVER, PhysicsConfig()) as simulation:
            found.append(walk(simulation, GaitController(), 8.0, lambda controller, stamp_ns:
                              controller.set_velocity(forward, turn, stamp_ns)))
    return found


def test_the_stated_covariance_is_honest(walks):
    """Not on a study of four walks alone: `validate odometry` has more. One promise is seen."""
    result = judge(walks, ROVER, COUNTS, RIGID)
    assert result.consistency < 2.5
    assert 0.8 < result.measured.forward_scale < 1.0 > result.measured.yaw_scale > 0.5
    sure = dataclasses.replace(RIGID, forward_stddev=0.005, lateral_stddev=0.003, yaw_stddev=0.01)
    boasting = judge(walks, ROVER, COUNTS, sure)
    assert not boasting.consistent and boasting.consistency > 10.0
    unscaled = judge(walks, ROVER, COUNTS, UNSCALED)
    assert np.mean(unscaled.errors**2) > np.mean(result.errors**2)


def test_a_drive_that_tips_over_is_named_and_left_out(walks):
    """Encoders see neither the fall nor that legs turn in the air."""
    roll = np.linspace(0.0, math.radians(110.0), len(walks[1].time_s))  # onto its side
    fallen = dataclasses.replace(walks[1], rpy_rad=walks[1].rpy_rad
                                 + np.outer(roll, [1.0, 0.0, 0.0]))
    result = judge([walks[0], fallen, *walks[2:]], ROVER, COUNTS, RIGID)
    assert (result.drives, result.tipped_over) == (3, (1,))
    with pytest.raises(StudyError, match='2 drives in which the rover does not tip over are not'):
        judge([fallen, fallen, *walks[2:]], ROVER, COUNTS, RIGID)


def test_a_rover_that_stands_tells_nothing(walks):
    still = [dataclasses.replace(each, joint_angle_rad=np.zeros_like(each.joint_angle_rad))
             for each in walks]
    with pytest.raises(StudyError, match='did not roll'):
        judge(still, ROVER, COUNTS, RIGID)


def platform(simulation):
    return Platform(simulation, SunConfig(), 1, 0.005)


def test_slip_over_sweep_is_the_slip_ratio():
    """Each foot is on the ground in a good half of the time, as the rover goes on above it."""
    with simulate(ground=GroundConfig(model='regolith')) as simulation:
        slip, sinkage = FootSlip(None, platform(simulation)), Sinkage(None, platform(simulation))
        ways = []
        trot(simulation, 3.0, observe=lambda state: ways.append(
            slip.measure(state, state.stamp_ns)[topics.FOOT_SLIP.name].position))
        slipped, swept = np.reshape(ways[-1], (2, 4))
        went = math.hypot(*simulation.state.position_m[:2])
        assert 0.4 * went < np.mean(swept - slipped) < went
        assert np.all(np.abs(slipped / swept) < 0.5)
        depths = sinkage.measure(simulation.state, 0)[topics.SINKAGE.name]
        assert list(depths.position) == simulation.ground_contact.sinkage_m.tolist()
        slip.restart()
        again = slip.measure(simulation.state, 0)[topics.FOOT_SLIP.name]
        assert max(np.abs(again.position)) < 0.005


def test_on_rigid_ground_nothing_sinks():
    with simulate() as simulation:
        assert Sinkage(None, platform(simulation)).measure(simulation.state, 0) == {}
