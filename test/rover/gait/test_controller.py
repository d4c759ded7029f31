"""The leg controller on ideal motors: phases found, blocks survived, commands checked."""

import math

import numpy as np
import pytest

from lunar_rover_sim.base.errors import ConfigError, GaitError
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import Stride
from lunar_rover_sim.rover.gait.config import GaitConfig, GAITS
from lunar_rover_sim.rover.gait.controller import GaitController

DT_NS = 5_000_000
DT = DT_NS * 1e-9
PITCH = 2.0 * math.pi / 3.0


def offsets(gait: str = 'trot') -> tuple[float, ...]:
    """Return the phase offsets of a gait of the default rover."""
    return GaitConfig(gait=gait).offsets(RoverDescription().legs)


class Legs:
    """Four motors that turn exactly as told, unless held, and what they were told."""

    def __init__(self, controller, angle=(0.0, 0.0, 0.0, 0.0)):
        self.controller = controller
        self.angle = np.array(angle, dtype=float)
        self.velocity = np.zeros(4)
        self.stamp_ns = 0
        self.held = np.zeros(4, dtype=bool)
        self.commands, self.angles = [], []

    def run(self, seconds, velocity=None, stride=None):
        for _ in range(round(seconds / DT)):
            if velocity is not None:
                self.controller.set_velocity(*velocity, self.stamp_ns)
            if stride is not None:
                self.controller.set_stride(stride, self.stamp_ns)
            command = self.controller.update(self.stamp_ns, self.angle, self.velocity)
            self.velocity = np.where(self.held, 0.0, command.velocity_radps)
            self.angle = self.angle + self.velocity * DT
            self.stamp_ns += DT_NS
            self.commands.append(command)
            self.angles.append(self.angle)
        return self

    def references(self, last=None):
        chosen = self.commands if last is None else self.commands[-round(last / DT):]
        return np.array([command.angle_rad for command in chosen])

    def phases(self, last):
        return np.array([command.phase for command in self.commands[-round(last / DT):]])


def wrapped(phase):
    return (phase + 0.5) % 1.0 - 0.5


def phase_errors(legs, last, offsets, direction=(1, 1, 1, 1)):
    """Return each leg's phase against the first leg's, less the gait array."""
    phase = legs.phases(last) * np.array(direction)
    relative = phase - phase[:, :1]
    return wrapped(relative - (np.array(offsets) - offsets[0]))


@pytest.mark.parametrize('gait', sorted(GAITS))
@pytest.mark.parametrize('seed', range(4))
def test_phase_offsets_are_reached_from_random_start_angles(gait, seed):
    rng = np.random.default_rng(seed)
    legs = Legs(GaitController(GaitConfig(gait=gait)), rng.uniform(-10.0, 10.0, 4))
    legs.run(8.0, (0.14, 0.0))
    assert np.abs(phase_errors(legs, 2.0, offsets(gait))).max() < 0.01


def test_any_gait_array_by_list():
    offsets = (0.1, 0.35, 0.6, 0.85)
    legs = Legs(GaitController(GaitConfig(gait='custom', phase_offsets=offsets)))
    legs.run(8.0, (0.14, 0.0))
    assert np.abs(phase_errors(legs, 2.0, offsets)).max() < 0.01


def test_legs_follow_their_reference_and_walk_one_pitch_a_cycle():
    legs = Legs(GaitController()).run(5.0, stride=Stride(1.0))
    before = legs.angle.copy()
    legs.run(4.0, stride=Stride(1.0))
    np.testing.assert_allclose(legs.angle - before, 4.0 * PITCH, atol=0.02)
    # One period late at most: 5 rad/s times 5 ms.
    lag = np.abs(legs.references(4.0) - np.array(legs.angles[-round(4.0 / DT):])).max()
    assert lag < 0.03


def test_the_commanded_angle_never_jumps():
    rng = np.random.default_rng(3)
    controller = GaitController()
    legs = Legs(controller, rng.uniform(-3.0, 3.0, 4))
    for velocity in ((0.2, 0.0), (0.2, 0.15), (-0.1, 0.1), (0.0, -0.3), (0.0, 0.0), (0.05, -0.15)):
        legs.run(2.0, velocity)
    controller.configure(GaitConfig(duty_factor=0.75, foot_width_deg=40.0, gait='crawl',
                                    stance_smoothing=0.9))
    legs.run(1.0, (0.1, 0.0))
    controller.configure(GaitConfig(duty_factor=0.5, foot_width_deg=80.0))
    legs.run(0.1, (0.1, 0.0))
    controller.configure(GaitConfig())
    legs.run(2.0, (0.1, 0.0))
    # No reference moves faster than motors turn: 20 rad/s.
    assert np.abs(np.diff(legs.references(), axis=0)).max() < 20.0 * DT


def test_new_parameters_take_full_effect_after_the_blend_time():
    controller = GaitController()
    legs = Legs(controller).run(3.0, stride=Stride(1.0))
    before = legs.references(DT)
    controller.configure(GaitConfig(foot_width_deg=30.0, duty_factor=0.7))
    command = controller.update(legs.stamp_ns, legs.angle, legs.velocity)
    assert np.abs(command.angle_rad - before).max() < 6.0 * DT
    legs.run(3.0, stride=Stride(1.0))
    shape = GaitConfig(foot_width_deg=30.0, duty_factor=0.7).shaping()
    last = legs.commands[-1]
    np.testing.assert_allclose(last.angle_rad, shape.angle(last.phase), atol=1e-9)


def test_a_blocked_leg_is_pushed_gently_and_finds_its_phase_again():
    controller = GaitController()
    legs = Legs(controller).run(4.0, stride=Stride(1.0))
    legs.held[1] = True
    legs.run(3.3, stride=Stride(1.0))
    blocked = [command.velocity_radps[1] for command in legs.commands[-round(2.0 / DT):]]
    config = controller.config
    lead = legs.references(2.0)[:, 1] - legs.angle[1]
    assert np.abs(lead).max() <= math.radians(config.max_angle_lead_deg) + 0.05
    # Feedforward of a cycle a second, more for the drawing, and feedback of the bounded lead.
    assert 0.0 < max(blocked) < 2.0 * 1.5 * 5.0 + config.position_gain * max(lead) + 1.0
    assert np.abs(phase_errors(legs, DT, offsets()))[0, 1] > 0.02
    legs.held[1] = False
    legs.run(5.0, stride=Stride(1.0))
    assert np.abs(phase_errors(legs, 1.0, offsets())).max() < 0.01


def test_a_leg_turned_by_hand_takes_the_nearest_spoke():
    legs = Legs(GaitController()).run(4.0, stride=Stride(1.0))
    legs.angle[2] += 5.0 * PITCH + 0.3
    command = legs.controller.update(legs.stamp_ns, legs.angle, legs.velocity)
    assert abs(command.angle_rad[2] - legs.angle[2]) <= PITCH / 2.0
    legs.run(4.0, stride=Stride(1.0))
    assert np.abs(phase_errors(legs, 1.0, offsets())).max() < 0.01


def test_without_a_command_the_legs_settle_straight_down_and_stand():
    legs = Legs(GaitController(), (0.4, -0.9, 1.0, 8.0)).run(4.0)
    assert np.abs(wrapped(legs.angle / PITCH)).max() < 0.01
    before = legs.angle.copy()
    legs.run(2.0)
    np.testing.assert_allclose(legs.angle, before, atol=0.01)


def test_zero_command_stands_still():
    legs = Legs(GaitController()).run(2.0, (0.0, 0.0))
    np.testing.assert_allclose(legs.angle, np.zeros(4), atol=1e-12)


def test_an_old_command_stops_with_feet_down():
    controller = GaitController()
    legs = Legs(controller).run(3.0, (0.14, 0.0))
    legs.run(controller.config.cmd_timeout_s - 2 * DT)
    assert not controller.stride.stands
    legs.run(4 * DT)
    assert controller.stride.stands
    legs.run(4.0)
    assert np.abs(wrapped(legs.angle / PITCH)).max() < 0.01
    assert np.abs(legs.velocity).max() < 0.02
    legs.run(2.0, (0.14, 0.0))
    assert not controller.stride.stands


def test_a_command_without_a_stamp_holds_until_the_next():
    controller = GaitController()
    controller.set_velocity(0.1, 0.0)
    Legs(controller).run(3.0)
    assert not controller.stride.stands
    controller.set_velocity(0.0, 0.0)
    controller.update(4_000_000_000, np.zeros(4), np.zeros(4))
    assert controller.stride.stands


@pytest.mark.parametrize('bad', [(math.nan, 0.0), (0.1, math.inf), (-math.inf, math.nan),
                                 ('a', 0.0), (0.1, None), (10**400, 0.0), (99.0, 0.0)])
def test_a_velocity_that_is_none_is_refused(bad):
    controller = GaitController()
    controller.set_velocity(0.1, 0.0, 0)
    stride = controller.update(0, np.zeros(4), np.zeros(4)) and controller.stride
    with pytest.raises(GaitError, match=r'^velocity: .* rad/s is not valid; valid is -10 to 10$'):
        controller.set_velocity(*bad, 1000)
    controller.update(3000, np.zeros(4), np.zeros(4))
    assert controller.stride == stride


def test_a_refused_command_does_not_keep_the_rover_going():
    controller = GaitController()
    controller.set_velocity(0.1, 0.0, 0)
    with pytest.raises(GaitError):
        controller.set_velocity(math.nan, 0.0, 400_000_000)
    controller.update(600_000_000, np.zeros(4), np.zeros(4))
    assert controller.stride.stands


def test_backward_turns_the_legs_backward():
    legs = Legs(GaitController()).run(4.0, (-0.1, 0.0))
    before = legs.angle.copy()
    legs.run(2.0, (-0.1, 0.0))
    assert np.all(legs.angle - before < -1.0)


def test_turning_on_the_spot_turns_the_sides_against_each_other_in_step():
    legs = Legs(GaitController()).run(6.0, (0.0, 0.15))
    moved = legs.angle - legs.angles[-round(4.0 / DT)]
    assert np.all(moved[[0, 2]] < -1.0) and np.all(moved[[1, 3]] > 1.0)
    errors = phase_errors(legs, 2.0, offsets(), (-1, 1, -1, 1))
    assert np.abs(errors).max() < 0.01


def test_the_duty_offset_makes_the_inner_side_stand_longer():
    stride = Stride.turning(1.0, 0.2)
    legs = Legs(GaitController()).run(6.0, stride=stride)
    width = math.radians(30.0)
    references = legs.references(4.0)
    stance = np.mean(np.abs((references + PITCH / 2) % PITCH - PITCH / 2) <= width, axis=0)
    np.testing.assert_allclose(stance, 0.6 + stride.duty_offset * np.array([1, -1, 1, -1]),
                               atol=0.01)


def test_beyond_reach_is_scaled_and_said_once():
    controller = GaitController()
    controller.set_velocity(2.0, 0.5, 0)
    assert controller.saturated
    reports = controller.take_reports()
    assert len(reports) == 1 and '2.000 m/s' in reports[0] and 'curvature kept' in reports[0]
    controller.set_velocity(3.0, 0.5, 1)
    assert controller.saturated and controller.take_reports() == []
    controller.set_velocity(0.1, 0.0, 2)
    assert not controller.saturated


def test_the_same_calls_give_the_same_commands_and_reset_starts_anew():
    def commands(controller):
        legs = Legs(controller, (0.1, 0.5, -0.2, 3.0)).run(3.0, (0.12, 0.1))
        return np.array([command.velocity_radps for command in legs.commands])

    controller = GaitController()
    first = commands(controller)
    np.testing.assert_array_equal(first, commands(GaitController()))
    controller.reset()
    np.testing.assert_array_equal(first, commands(controller))


def test_time_that_goes_backward_starts_anew():
    controller = GaitController()
    Legs(controller).run(3.0, (0.14, 0.0))
    command = controller.update(0, np.zeros(4), np.zeros(4))
    np.testing.assert_allclose(command.velocity_radps, 0.0, atol=1e-9)
    assert controller.stride.stands


@pytest.mark.parametrize(('values', 'message'), [
    ({'foot_width_deg': 100.0, 'spokes': 4}, 'foot_width_deg: 100 .*90'),
    ({'phase_offsets': (0.0, 0.5, 0.5, 1.0)}, 'phase_offsets: 1'),
    ({'gait': 'gallop'}, "gait: 'gallop'"),
])
def test_parameters_that_do_not_fit_are_refused(values, message):
    with pytest.raises(ConfigError, match=message):
        GaitConfig(**values)


def test_custom_offsets_are_one_for_each_leg():
    few = GaitConfig(gait='custom', phase_offsets=(0.0, 0.5, 0.5))
    with pytest.raises(ConfigError, match='phase_offsets: 3 elements given; .* one for each leg'):
        GaitController(few)
    controller = GaitController()
    with pytest.raises(ConfigError, match='phase_offsets: 3 elements'):
        controller.configure(few)


def test_the_number_of_spokes_cannot_change_while_walking():
    with pytest.raises(ConfigError, match='spokes: 5'):
        GaitController().configure(GaitConfig(spokes=5))


def test_the_gait_must_have_the_spokes_of_the_rover():
    six = RoverDescription.from_mapping({'legs': {'spokes': 6}})
    assert GaitConfig(foot_width_deg=40.0).for_rover(six).spokes == 6
    with pytest.raises(ConfigError, match='spokes: 3 is not valid for the gait; valid is 6'):
        GaitConfig(spokes=3).for_rover(six)
    with pytest.raises(ConfigError, match='foot_width_deg: 60 .*60'):
        GaitConfig().for_rover(six)
    with pytest.raises(ConfigError, match='spokes: 1 is not valid'):
        GaitConfig(spokes=1)


@pytest.mark.parametrize('bad', [[0.0, math.nan, 0.0, 0.0], [0.0] * 3, [math.inf] * 4, 'none'])
def test_joint_states_that_are_none_are_refused(bad):
    with pytest.raises(GaitError, match='joint angle: .*4 finite'):
        GaitController().update(0, bad, np.zeros(4))
    with pytest.raises(GaitError, match='joint velocity'):
        GaitController().update(0, np.zeros(4), bad)
