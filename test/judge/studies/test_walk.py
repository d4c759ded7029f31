"""The gait on the real simulation, on flat ground: commands followed, stopped with feet down."""

import math

import numpy as np
import pytest

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.paths import config_path
from lunar_rover_sim.judge.studies.gait_measurement import (CommandTracking, measure,
                                                            measure_commands, measure_stride)
from lunar_rover_sim.judge.studies.walking import flat_world, walk, with_physics
from lunar_rover_sim.rover.description import Legs, RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration, Stride
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

FLAT = Scenario.load('flat')


@pytest.fixture(scope='module')
def table():
    return GaitCalibration.load(config_path('gait_calibrations/rigid.yaml'))


@pytest.fixture(scope='module')
def simulation():
    with Simulation(flat_world(8.0), RoverDescription(), PhysicsConfig()) as simulation:
        yield simulation


def test_commands_are_followed():
    # A sparse grid and short walks; `lunar_rover_sim validate locomotion` walks the whole one.
    for each in measure_commands(FLAT, [(0.10, 0.15), (0.25, 0.0)], measure_s=15.0):
        assert abs(each.forward_error) <= 0.10, each
        assert abs(each.yaw_error_radps) <= 0.15 * max(abs(each.commanded[1]), 0.05), each


def test_backward_and_on_the_spot(simulation, table):
    for v, w in ((-0.1, 0.0), (0.0, 0.15)):
        done = walk(simulation, GaitController(GaitConfig(), table), 12.0,
                    lambda controller, stamp_ns: controller.set_velocity(v, w, stamp_ns))
        forward, yaw_rate = done.mean_velocity(5.0, 12.0)
        assert forward == pytest.approx(v, abs=0.012)
        assert yaw_rate == pytest.approx(w, abs=0.0225)


def test_an_old_command_stops_it_with_all_feet_on_the_ground(simulation, table):
    def command(controller, stamp_ns):
        if stamp_ns < 3_000_000_000:
            controller.set_velocity(0.12, 0.05, stamp_ns)

    done = walk(simulation, GaitController(GaitConfig(), table), 7.0, command)
    last = done.time_s > 6.5
    assert np.ptp(done.position_m[last], axis=0).max() < 0.001
    # Each foot bears at least a tenth of the weight of 3.6 N.
    assert done.contact_force_n[last][:, :, 2].min() > 0.36
    pitch = 2.0 * math.pi / 3.0
    off = (done.joint_angle_rad[last] + pitch / 2.0) % pitch - pitch / 2.0
    assert np.abs(off).max() < math.radians(3.0)
    assert np.degrees(np.abs(done.rpy_rad[last, :2])).max() < 1.0


def test_it_stands_where_nothing_is_commanded(simulation, table):
    done = walk(simulation, GaitController(GaitConfig(), table), 2.0, lambda *_: None)
    assert np.ptp(done.position_m, axis=0).max() < 0.002


def test_legs_find_their_phase_from_any_start_angle(table):
    start = StartPose(joint_angle_rad=(0.3, -0.8, 2.0, -3.0))
    with Simulation(flat_world(4.0), RoverDescription(), PhysicsConfig(start=start)) as simulation:
        done = walk(simulation, GaitController(GaitConfig(), table), 8.0,
                    lambda controller, stamp_ns: controller.set_velocity(0.12, 0.0, stamp_ns))
    phase = done.phase[done.time_s > 7.0]
    off = phase - phase[:, :1] - np.array(GaitConfig(gait='trot').offsets(Legs()))
    assert np.abs((off + 0.5) % 1.0 - 0.5).max() < 0.02
    # And the legs are where their phases want them, within what motors lag under load.
    lag = (done.joint_angle_rad - done.reference_rad)[done.time_s > 7.0]
    assert np.degrees(np.abs(lag)).max() < 6.0


def test_a_stride_advances_by_the_sweep_of_the_stance():
    forward, yaw_rate = measure_stride(FLAT, 8.0, Stride(0.5))
    # A foot that stands still: l w / duty per cycle for small angles, l = 8 cm, w = 60 deg.
    assert forward == pytest.approx(0.5 * 0.08 * math.radians(60.0) / 0.6, rel=0.1)
    assert abs(yaw_rate) < 0.005


def test_a_table_is_measured_and_the_workers_do_not_matter():
    one, two = (measure(FLAT, (1.0,), (0.0, 1.0), measure_s=1.0, workers=k) for k in (1, 2))
    assert one == two
    assert one.forward_mps[0][0] == pytest.approx(0.13, rel=0.1)
    assert 0.2 < one.yaw_rate_radps[0][1] < 1.0
    assert one.conditions['gravity_mps2'] == 1.62 and one.conditions['ground'] == 'rigid'


def test_a_table_ends_below_the_phase_rate_at_which_the_rover_tips_over():
    # At a sixteenth of the Moon's gravity the motors throw it on its back.
    light = with_physics(FLAT, gravity_mps2=0.1)
    assert measure(light, (0.5, 2.2), (0.0, 1.0), measure_s=1.0).phase_rates_hz == (0.5,)
    with pytest.raises(StudyError, match='tips over at a phase rate of 2.2 Hz, the slowest'):
        measure(light, (2.2,), (0.0, 1.0), measure_s=1.0)


def test_the_bounds_of_command_tracking():
    assert CommandTracking((0.1, 0.1), (0.109, 0.114)).followed
    assert not CommandTracking((0.1, 0.1), (0.111, 0.1)).followed
    assert not CommandTracking((0.1, 0.1), (0.1, 0.084)).followed
    assert CommandTracking((0.1, 0.0), (0.1, 0.007)).followed
