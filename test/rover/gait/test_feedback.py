"""The terms of the leg command: feedforward, angle and velocity feedback, limits, blending."""

import math

import numpy as np
import pytest

from lunar_rover_sim.rover.gait.calibration import Stride
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController

DT_NS = 5_000_000
DT = DT_NS * 1e-9
PITCH = 2.0 * math.pi / 3.0
LONG = 1e6   # no command of these tests grows old
UNBOUND = 100.0     # lead in flight: the terms of the command alone


def walking(config, seconds=3.0, stride=Stride(1.0)):
    """Return a controller in steady walk on ideal motors, its angles, and the next stamp."""
    controller = GaitController(config)
    angle, velocity = np.zeros(4), np.zeros(4)
    stamps = range(0, round(seconds / DT) * DT_NS, DT_NS)
    controller.set_stride(stride, 0)
    for stamp in stamps:
        velocity = controller.update(stamp, angle, velocity).velocity_radps
        angle = angle + velocity * DT
    return controller, angle, velocity, len(stamps) * DT_NS


def answer(config, d_angle=0.0, d_velocity=0.0):
    """Return the command of a steady walk where one measurement differs."""
    controller, angle, velocity, stamp = walking(config)
    return controller.update(stamp, angle + d_angle, velocity + d_velocity)


def test_a_motor_that_is_slow_is_driven_faster_by_the_velocity_gain():
    config = GaitConfig(velocity_gain=0.7, cmd_timeout_s=LONG, max_flight_lead_radps=UNBOUND)
    usual, slow, fast = (answer(config, d_velocity=d).velocity_radps for d in (0.0, -0.5, 0.5))
    np.testing.assert_allclose(slow - usual, 0.7 * 0.5, atol=1e-9)
    np.testing.assert_allclose(fast - usual, -0.7 * 0.5, atol=1e-9)


def test_a_leg_that_is_behind_is_driven_faster_by_the_position_gain():
    config = GaitConfig(position_gain=5.0, cmd_timeout_s=LONG)
    usual, behind, ahead = (answer(config, d_angle=d).velocity_radps for d in (0.0, -0.02, 0.02))
    np.testing.assert_allclose(behind - usual, 5.0 * 0.02, atol=1e-9)
    np.testing.assert_allclose(ahead - usual, -5.0 * 0.02, atol=1e-9)


def test_without_gains_the_command_is_the_speed_of_the_reference():
    """Feedforward alone: the phase rate times the slope, which is how fast the reference moves."""
    config = GaitConfig(position_gain=0.0, velocity_gain=0.0, cmd_timeout_s=LONG,
                        max_flight_lead_radps=UNBOUND)
    controller, angle, velocity, stamp = walking(config)
    commands = []
    for i in range(400):
        command = controller.update(stamp + i * DT_NS, angle, velocity)
        commands.append(command)
        angle = angle + command.velocity_radps * DT
    told = np.array([command.velocity_radps for command in commands])
    moved = np.gradient(np.array([command.angle_rad for command in commands]), DT, axis=0)
    # Differences over 10 ms of a curve whose acceleration changes by 1e3 rad/s3 or less.
    np.testing.assert_allclose(told[1:-1], moved[1:-1], atol=0.12)
    assert np.ptp(told) > 1.0


def test_at_the_reference_and_its_speed_feedback_adds_nothing():
    plain = GaitConfig(position_gain=0.0, velocity_gain=0.0, cmd_timeout_s=LONG)
    _, angle, velocity, stamp = walking(plain)
    gains = GaitConfig(position_gain=8.0, velocity_gain=0.2, cmd_timeout_s=LONG)
    forward = walking(plain)[0].update(stamp, angle, velocity).velocity_radps
    controller, angle, velocity, _ = walking(gains)
    onto = walking(gains)[0].update(stamp, angle, velocity).angle_rad
    command = controller.update(stamp, onto, forward)
    np.testing.assert_allclose(command.velocity_radps, forward, atol=1e-9)


def test_commands_stay_within_the_joint_velocity():
    config = GaitConfig(max_joint_velocity_radps=3.0, cmd_timeout_s=LONG, position_gain=50.0,
                        max_flight_lead_radps=UNBOUND)
    controller, angle, velocity, stamp = walking(config)
    for lead in (0.9, -0.9):
        command = controller.update(stamp, angle - lead, velocity)
        np.testing.assert_allclose(command.velocity_radps, math.copysign(3.0, lead))


def test_a_reference_waits_for_a_leg_that_is_blocked_and_for_no_other():
    config = GaitConfig(max_angle_lead_deg=20.0, cmd_timeout_s=LONG)
    controller, angle, velocity, stamp = walking(config)
    velocity = velocity * [0.0, 1.0, 1.0, 1.0]
    leads = []
    for i in range(600):
        command = controller.update(stamp + i * DT_NS, angle, velocity)
        leads.append(command.angle_rad[0] - angle[0])
        velocity = command.velocity_radps * [0.0, 1.0, 1.0, 1.0]
        angle = angle + velocity * DT
    # It leads up to 20 deg, and by what it moves in a period at most beyond (15 rad/s).
    assert math.radians(20.0) - 0.08 < max(leads[200:]) <= math.radians(20.0) + 0.08
    # A leg may be ahead of its reference by any amount: nothing waits then.
    moved = np.array(leads) + angle[0]
    assert np.all(np.diff(moved) >= -1e-12)


@pytest.mark.parametrize(('turning', 'told'), [(0.0, 0.5), (15.0, 14.5)])
def test_a_leg_in_flight_is_driven_by_little_more_or_less_than_it_turns(turning, told):
    """One that strikes a rock is not pushed on; those in stance are driven as ever."""
    config = GaitConfig(cmd_timeout_s=LONG, max_flight_lead_radps=0.5)
    controller, angle, _, stamp = walking(config)
    command = controller.update(stamp, angle - 0.3, np.full(4, turning))
    in_flight = np.abs(command.phase - np.round(command.phase)) > 0.5 * config.duty_factor
    assert 0 < np.count_nonzero(in_flight) < 4
    np.testing.assert_allclose(command.velocity_radps[in_flight], told)
    assert (np.abs(command.velocity_radps[~in_flight] - turning) > 1.0).all()


def references(controller, seconds, stamp, angle):
    velocity = np.zeros(4)
    phases, angles = [], []
    for i in range(round(seconds / DT)):
        command = controller.update(stamp + i * DT_NS, angle, velocity)
        velocity = command.velocity_radps
        angle = angle + velocity * DT
        phases.append(command.phase)
        angles.append(command.angle_rad)
    return np.array(phases), np.array(angles)


def test_a_new_shape_takes_half_of_its_effect_in_half_of_the_blend_time():
    """A smooth step: the foot width in between is halfway at half time, 5/32 at a quarter."""
    before, after = GaitConfig(foot_width_deg=50.0), GaitConfig(foot_width_deg=70.0)
    values = {'blend_time_s': 0.8, 'cmd_timeout_s': LONG, 'stance_smoothing': 0.0}
    for share, part in ((0.25, 5.0 / 32.0), (0.5, 0.5), (0.75, 27.0 / 32.0), (1.0, 1.0)):
        controller, angle, velocity, stamp = walking(GaitConfig(foot_width_deg=50.0, **values))
        controller.configure(GaitConfig(foot_width_deg=70.0, **values))
        # Time goes on in one step: the reference is then shaped with the blended width.
        command = controller.update(stamp - DT_NS + round(share * 0.8e9), angle, velocity)
        width = before.foot_width_deg + part * (after.foot_width_deg - before.foot_width_deg)
        shape = GaitConfig(foot_width_deg=width, stance_smoothing=0.0).shaping()
        np.testing.assert_allclose(command.angle_rad, shape.angle(command.phase), atol=1e-9)


def swept(controller, stamp, angle):
    """Return how wide the left and the right feet sweep in one cycle's stance [rad]."""
    phases, angles = references(controller, 1.6, stamp, angle)
    widths = []
    for leg in (0, 1):
        # In the middle of stance the slope is width / duty.
        near = np.abs((phases[:, leg] + 0.5) % 1.0 - 0.5) < 0.1
        phase = (phases[near, leg] + 0.5) % 1.0
        widths.append(np.polyfit(phase, (angles[near, leg] + PITCH / 2) % PITCH, 1)[0])
    return widths


def test_sweeps_turn_to_the_stride_within_the_blend_time():
    config = GaitConfig(blend_time_s=0.5, stance_smoothing=0.0, cmd_timeout_s=LONG)
    controller, angle, _, stamp = walking(config)
    full = swept(controller, stamp, angle)
    assert full == pytest.approx([config.shaping().slope_at(0.0)] * 2, rel=0.02)
    # Half the sweep on the left: half the width there, and all of it on the right.
    controller, angle, _, stamp = walking(config, stride=Stride(1.0, 0.0, 0.5, 1.0))
    left, right = swept(controller, stamp, angle)
    assert left == pytest.approx(0.5 * full[0], rel=0.02)
    assert right == pytest.approx(full[1], rel=0.02)
    # A sweep of nothing is still a little one: the shape of a leg without stance has no slope.
    controller, angle, _, stamp = walking(config, stride=Stride(1.0, 0.0, 1.0, 0.0))
    left, right = swept(controller, stamp, angle)
    assert 0.0 < right < 0.1 * full[1] and left == pytest.approx(full[0], rel=0.02)


def test_the_sweep_changes_evenly_over_the_blend_time():
    """From a whole sweep towards none: after half the blend time, half of the width is left."""
    config = GaitConfig(blend_time_s=0.8, stance_smoothing=0.0, cmd_timeout_s=LONG)
    controller, angle, velocity, stamp = walking(config)
    controller.set_stride(Stride(1.0, 0.0, 0.0, 1.0), stamp)
    command = controller.update(stamp - DT_NS + 400_000_000, angle, velocity)
    left = GaitConfig(foot_width_deg=30.0, stance_smoothing=0.0).shaping()
    right = config.shaping()
    np.testing.assert_allclose(command.angle_rad[[0, 2]], left.angle(command.phase[[0, 2]]),
                               atol=1e-9)
    np.testing.assert_allclose(command.angle_rad[[1, 3]], right.angle(command.phase[[1, 3]]),
                               atol=1e-9)


def test_the_duty_factor_keeps_its_bounds_whatever_the_turn():
    """An offset beyond what a leg can do leaves 10 % of stance, or of flight."""
    config = GaitConfig(duty_factor=0.8, stance_smoothing=0.0, cmd_timeout_s=LONG,
                        blend_time_s=0.2)
    controller, angle, velocity, stamp = walking(config, stride=Stride(1.0, 0.75, 1.0, 1.0))
    command = controller.update(stamp, angle, velocity)
    for legs, duty in (([0, 2], 0.9), ([1, 3], 0.1)):
        shape = GaitConfig(duty_factor=duty, stance_smoothing=0.0).shaping()
        np.testing.assert_allclose(command.angle_rad[legs], shape.angle(command.phase[legs]),
                                   atol=1e-9)


def test_a_command_holds_to_the_end_of_its_time_and_no_longer():
    config = GaitConfig(cmd_timeout_s=0.5)
    controller = GaitController(config)
    controller.set_stride(Stride(1.0), 1_000_000_000)
    controller.update(1_500_000_000, np.zeros(4), np.zeros(4))
    assert not controller.stride.stands
    controller.update(1_500_000_001, np.zeros(4), np.zeros(4))
    assert controller.stride.stands
