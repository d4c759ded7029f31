"""The map from velocity to stride: inverse, scaled, saturated, read and written."""

import dataclasses
import functools
import math
import os
import subprocess
import sys

import numpy as np
from portability import numpy_features
import pytest

from lunar_rover_sim.base.errors import ConfigError, GaitError
from lunar_rover_sim.base.files.paths import config_folder
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.rover.description import Chassis, Legs, rectangle, RoverDescription
from lunar_rover_sim.rover.gait.calibration import (differences, GaitCalibration,
                                                    ground_conditions, rover_conditions, STAND,
                                                    Stride)
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import ContactConfig, PhysicsConfig

PACKAGED = config_folder() / 'gait_calibrations/rigid.yaml'


def tables():
    return [GaitCalibration.default(), GaitCalibration.load(PACKAGED)]


@pytest.mark.parametrize('table', tables(), ids=['analytic', 'packaged'])
@pytest.mark.parametrize('forward', [0.03, 0.1, 0.17, 0.25])
@pytest.mark.parametrize('yaw_rate', [-0.15, -0.05, 0.0, 0.02, 0.15])
def test_the_map_is_inverted(table, forward, yaw_rate):
    stride, scale = table.stride(forward, yaw_rate)
    assert scale == 1.0
    turn = turn_of(stride)
    back = table.velocity(stride.phase_rate_hz, turn)
    # Linear interpolation both ways, in a table that need not be smooth.
    assert back[0] == pytest.approx(forward, rel=0.02)
    assert back[1] == pytest.approx(yaw_rate, rel=0.02, abs=1e-3)


def test_strides_of_the_table_have_its_velocities():
    table = GaitCalibration.default()
    for rate, speeds, turns in zip(table.phase_rates_hz, table.forward_mps, table.yaw_rate_radps):
        for turn, *velocity in zip(table.turns, speeds, turns):
            assert table.velocity(rate, turn) == pytest.approx(velocity, rel=1e-6, abs=1e-9)


def test_without_slip_a_side_goes_on_by_its_sweep_while_it_stands():
    """0.14 m a cycle of duty 0.6, more where a side stands for a smaller part of the cycle."""
    table = GaitCalibration.default()
    half_track_m = table.forward_mps[0][0] / table.yaw_rate_radps[0][-1]
    for turn, forward, yaw_rate in zip(table.turns, table.forward_mps[0], table.yaw_rate_radps[0]):
        stride = Stride.turning(1.0, turn)
        for sign, sweep in ((-1.0, stride.left_sweep), (1.0, stride.right_sweep)):
            assert forward + sign * yaw_rate * half_track_m == pytest.approx(
                0.14 * sweep * 0.6 / (0.6 - sign * stride.duty_offset))


@functools.cache
def strides():
    """Return turns, (n,), and the duty offset and the sweeps of each, (n, 3)."""
    turns = np.linspace(-1.0, 1.0, 20001)
    return turns, np.array([dataclasses.astuple(Stride.turning(1.0, turn))[1:] for turn in turns])


def turn_of(stride):
    """Return the turn of a forward stride, found by trial."""
    turns, others = strides()
    return turns[np.argmin(np.abs(others - dataclasses.astuple(stride)[1:]).sum(axis=1))]


@pytest.mark.parametrize('table', tables(), ids=['analytic', 'packaged'])
def test_left_and_right_forward_and_backward_are_mirrors(table):
    left, _ = table.stride(0.1, 0.1)
    right, _ = table.stride(0.1, -0.1)
    assert (right.left_sweep, right.right_sweep) == (left.right_sweep, left.left_sweep)
    assert right.duty_offset == -left.duty_offset
    back, _ = table.stride(-0.1, -0.1)
    assert (back.left_sweep, back.right_sweep) == (-left.left_sweep, -left.right_sweep)
    assert back.phase_rate_hz == left.phase_rate_hz


@pytest.mark.parametrize('table', tables(), ids=['analytic', 'packaged'])
def test_on_the_spot_the_sides_turn_against_each_other(table):
    stride, _ = table.stride(0.0, 0.1)
    assert (stride.left_sweep, stride.right_sweep) == pytest.approx((-1.0, 1.0), abs=1e-6)
    stride, _ = table.stride(0.0, -0.1)
    assert (stride.left_sweep, stride.right_sweep) == pytest.approx((1.0, -1.0), abs=1e-6)


@pytest.mark.parametrize('table', tables(), ids=['analytic', 'packaged'])
def test_beyond_reach_the_curvature_is_kept(table):
    for forward, yaw_rate in ((1.0, 0.5), (0.5, 0.1), (-1.0, 0.3), (0.1, 3.0)):
        stride, scale = table.stride(forward, yaw_rate)
        assert scale < 1.0 and abs(scale * yaw_rate) < GaitConfig().max_yaw_rate_radps + 1e-9
        within, factor = table.stride(forward * scale, yaw_rate * scale)
        assert factor == pytest.approx(1.0)
        assert within.phase_rate_hz == pytest.approx(stride.phase_rate_hz, rel=1e-6)
        assert within.duty_offset == pytest.approx(stride.duty_offset, abs=1e-6)
        assert stride.phase_rate_hz <= GaitConfig().max_phase_rate_hz + 1e-9


@pytest.mark.parametrize('table', tables(), ids=['analytic', 'packaged'])
def test_small_velocities_are_continuous_with_standing(table):
    assert table.stride(0.0, 0.0) == (STAND, 1.0)
    assert table.stride(1e-5, 0.0)[0].stands
    slow, _ = table.stride(0.002, 0.0)
    assert 0.0 < slow.phase_rate_hz < 0.03


def test_small_turns_have_an_answer_of_their_own():
    """What hardly turns the rover is skipped: a dead band at small offsets is compensated."""
    rates, turns = (1.0,), (0.0, 0.2, 0.4, 0.7, 1.0)
    table = GaitCalibration(rates, turns, ((0.14, 0.14, 0.13, 0.06, 0.0),),
                            ((0.0, 0.001, 0.1, 0.3, 0.5),))
    stride, _ = table.stride(0.14, 0.02)
    assert stride.duty_offset > 0.1   # the table's 0.2 (an offset of 0.1) makes only 0.001 rad/s


def test_a_table_that_is_not_monotonic_is_still_inverted():
    table = GaitCalibration((0.5, 1.0), (0.0, 0.3, 0.6, 0.8, 1.0),
                            ((0.07, 0.07, 0.05, 0.055, 0.0), (0.14, 0.13, 0.1, 0.08, 0.0)),
                            ((0.0, 0.05, 0.12, 0.11, 0.25), (0.0, 0.1, 0.2, 0.3, 0.5)))
    turns = [1.0 - table.stride(0.05, w)[0].left_sweep for w in np.linspace(0.0, 0.3, 61)]
    assert np.all(np.diff(turns) >= -1e-9)


def test_another_gait_is_scaled_by_its_advance():
    table = GaitCalibration.default()
    wide, _ = table.stride(0.1, 0.0, GaitConfig(foot_width_deg=80.0))
    usual, _ = table.stride(0.1, 0.0)
    ratio = math.sin(math.radians(30.0)) / math.sin(math.radians(40.0))
    assert wide.phase_rate_hz == pytest.approx(usual.phase_rate_hz * ratio)


def test_written_and_read_again(tmp_path):
    table = GaitCalibration.default()
    table.save(tmp_path / 'table.yaml')
    again = GaitCalibration.load(tmp_path / 'table.yaml')
    np.testing.assert_allclose(again.forward_mps, table.forward_mps, atol=1e-5)
    assert again.turns == table.turns and dict(again.conditions) == dict(table.conditions)
    assert list(tmp_path.iterdir()) == [tmp_path / 'table.yaml']
    assert GaitCalibration.load(None) == table
    few = GaitCalibration((1.0,), (0.0, 1.0), ((0.125, 0.0),), ((0.0, 0.5),))
    few.save(tmp_path / 'table.yaml')
    assert GaitCalibration.load(tmp_path / 'table.yaml') == few


def test_a_gait_names_its_map_or_has_the_packaged_one(tmp_path):
    GaitCalibration.default().save(tmp_path / 'table.yaml')
    own = GaitCalibration.of(GaitConfig(calibration=str(tmp_path / 'table.yaml')))
    assert own.turns == GaitCalibration.default().turns
    assert GaitCalibration.of(GaitConfig()) == GaitCalibration.load(PACKAGED)


def test_a_ground_has_its_own_packaged_map_or_that_of_rigid_ground():
    soft = GaitCalibration.of(GaitConfig(), 'highland')
    assert soft.conditions['ground'] == 'highland'
    assert GaitCalibration.of(GaitConfig(), 'poppy_loose') == GaitCalibration.load(PACKAGED)
    assert GaitCalibration.of(GaitConfig(calibration='highland')) == soft
    assert GaitCalibration.of(GaitConfig(calibration='rigid'), 'highland') == \
        GaitCalibration.load(PACKAGED)
    with pytest.raises(ConfigError, match='calibration: highlnd cannot be read: .*, or name a '
                                          'packaged one: hexapod_highland, hexapod_rigid, '
                                          'highland, rigid$'):
        GaitCalibration.of(GaitConfig(calibration='highlnd'))


def test_a_map_that_cannot_be_written_is_an_error(tmp_path):
    with pytest.raises(GaitError, match=r'table.yaml: cannot be written: No such file'):
        GaitCalibration.default().save(tmp_path / 'none' / 'table.yaml')


@pytest.mark.parametrize(('text', 'message'), [
    ('turns: [', 'cannot be read'),
    ('3', 'is not a table'),
    ('speed: 3', 'speed: no such entry'),
    ('turns: [0, 1]', 'phase_rates_hz, forward_mps, yaw_rate_radps missing'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1]], yaw_rate_radps: [[0, 1]]}',
     'forward_mps: not a table of 1 rows'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1, .nan]],'
     ' yaw_rate_radps: [[0, 1]]}', 'finite'),
    ('{phase_rates_hz: [1, 1], turns: [0, 1], forward_mps: [[0.1, 0], [0.1, 0]],'
     ' yaw_rate_radps: [[0, 1], [0, 1]]}', 'phase_rates_hz: .*increasing'),
    ('{phase_rates_hz: [1], turns: [0, 0.9], forward_mps: [[0.1, 0]], yaw_rate_radps: [[0, 1]]}',
     'turns: .*from 0 to 1'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[-0.1, 0]], yaw_rate_radps: [[0, 1]]}',
     'walk forward'),
    ('{phase_rates_hz: [x], turns: [0, 1], forward_mps: [[1, 0]], yaw_rate_radps: [[0, 1]]}',
     'not a table of numbers'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1, -0.04]],'
     ' yaw_rate_radps: [[0, 1]]}', 'forward_mps: -0.04 is not valid; valid is >= -0.03'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1, 0]],'
     ' yaw_rate_radps: [[0, 1.0e+300]]}',
     r'yaw_rate_radps: 1e\+300 is not valid; valid is >= -15 and <= 50'),
    ('{phase_rates_hz: [1.0e+300], turns: [0, 1], forward_mps: [[0.1, 0]],'
     ' yaw_rate_radps: [[0, 1]]}', 'phase_rates_hz: .* <= 50'),
    ('{phase_rates_hz: [1, 2], turns: [0, 1], forward_mps: [[0.2, 0], [0.1, 0]],'
     ' yaw_rate_radps: [[0, 1], [0, 2]]}', 'forward_mps: .*cannot be inverted'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1, 0]], yaw_rate_radps: [[0, 1]],'
     ' duty_factor: 0}', 'duty_factor: 0 is not valid'),
    ('{phase_rates_hz: [1], turns: [0, 1], forward_mps: [[0.1, 0]], yaw_rate_radps: [[0, 1]],'
     ' conditions: [3]}', 'conditions: .*not a mapping'),
])
def test_files_that_are_no_table_are_refused_by_name(tmp_path, text, message):
    path = tmp_path / 'bad.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        GaitCalibration.load(path)
    assert str(path) in str(caught.value) and '\n' not in str(caught.value)


def test_a_missing_file_is_named_with_the_remedy(tmp_path):
    with pytest.raises(ConfigError, match='calibrate gait'):
        GaitCalibration.load(tmp_path / 'none.yaml')


RIGID = GaitCalibration.load(config_folder() / 'gait_calibrations/rigid.yaml').conditions
ANALYTIC = GaitCalibration.default().conditions


def test_other_conditions_are_named():
    assert differences(RIGID, rover_conditions(RoverDescription())) == []
    assert differences(RIGID, ground_conditions(PhysicsConfig())) == []
    heavy = rover_conditions(RoverDescription(chassis=Chassis(mass_kg=4.0)))
    assert differences(RIGID, heavy) == ['rover_mass_kg 2.24, here 4.24']
    legs = RoverDescription(legs=Legs(spokes=4, each=rectangle(x=0.2)))
    assert differences(RIGID, rover_conditions(legs)) == ['spokes 3, here 4',
                                                          'axle_x_m 0.115, here 0.2']
    assert differences(RIGID, ground_conditions(PhysicsConfig(gravity_mps2=9.81))) == \
        ['gravity_mps2 1.62, here 9.81']
    assert differences(ANALYTIC, {**heavy, **ground_conditions(PhysicsConfig())}) == []


def test_a_table_of_another_ground_is_named():
    """The packaged one is of rigid ground; one of soft ground names soil, not contact."""
    soft = PhysicsConfig(ground=GroundConfig(model='regolith', preset='highland_loose'),
                         contact=ContactConfig(stiffness_npm=9000.0))
    here = ground_conditions(soft)
    assert differences(RIGID, here) == ['ground rigid, here highland_loose']
    assert differences({'gravity_mps2': 1.62}, here) == ['ground rigid, here highland_loose']
    assert differences(here, here) == []
    firmer = dataclasses.replace(soft, ground=dataclasses.replace(soft.ground, bearing_mnpm3=0.6))
    assert differences(here, ground_conditions(firmer)) == ['bearing_mnpm3 0.3, here 0.6']
    assert differences(here, ground_conditions(PhysicsConfig())) == \
        ['ground highland_loose, here rigid']
    assert differences(ANALYTIC, here) == []


def test_tables_are_the_same_on_every_processor() -> None:
    """In fresh processes: NumPy computes as on one without AVX-512, where this one has it."""
    program = """if True:
        import hashlib
        from lunar_rover_sim.base.files.paths import config_folder
        from lunar_rover_sim.ground.regolith import resistive_force
        from lunar_rover_sim.rover.gait.calibration import GaitCalibration
        sums = hashlib.sha256()
        for path in sorted(config_folder().glob('gait_calibrations/*.yaml')):
            table = GaitCalibration.load(path)
            strides = [table.stride(0.01 * v, 0.02 * w) for v in range(13) for w in range(8)]
            sums.update(repr(strides).encode())
        for shape in (resistive_force.GENERIC, resistive_force.POPPY_LOOSE):
            sums.update(resistive_force.dig_table(shape).tobytes())
        print(sums.hexdigest())"""
    said = {subprocess.run([sys.executable, '-c', program], check=True, capture_output=True,
                           env={**os.environ, 'NPY_DISABLE_CPU_FEATURES': disabled}).stdout
            for disabled in ('', numpy_features(oldest=False))}
    assert len(said) == 1
