"""Poses of the navigation study: where they begin, how old they are, and when they end."""

import sys

import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.judge.studies.navigation_drives import ARRIVED, drive_to, SEEN
from lunar_rover_sim.judge.studies.navigation_poses import poses_of
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

PROGRAM = """
import numpy as np
from lunar_rover_sim.judge.slam.client import serve

def begin(settings):
    assert settings['sensor'] == 'stereo' and settings['frame_rate_hz'] == 20
    seen = []

    def track(frames, imu):
        seen.append(frames.stamp_ns)
        assert [image.shape for image in frames.images] == [(48, 64)] * 2
        T = np.eye(4)
        T[0, 3] = 0.01 * len(seen)      # to the right of the camera
        return T
    return track

serve(begin)
"""
DIES = """
import sys
from lunar_rover_sim.judge.slam.client import reference, serve

def begin(settings):
    follow = reference(settings)

    def track(frames, imu):
        if frames.stamp_ns > 3_000_000_000:
            sys.exit(3)
        return follow(frames, imu)
    return track

serve(begin)
"""


@pytest.fixture(scope='module')
def plain():
    return worlds.small(1, **worlds.BARE)


def test_poses_of_a_program_begin_at_the_start_and_come_later(tmp_path, plain):
    (tmp_path / 'program.py').write_text(PROGRAM)
    scenario = Scenario.load('flat', [
        'render_node.camera.width=64', 'render_node.camera.height=48',
        'physics_node.start.yaw_deg=90',
        f'slam_node.command={sys.executable} {tmp_path}/program.py'])
    with Simulation(plain, scenario.rover, scenario.physics_node) as simulation, \
            poses_of('slam', scenario, plain, simulation, 1) as poses:
        assert poses.newest(0) is None
        seen = {}
        for _ in range(100):
            state = simulation.advance(round(0.005 / simulation.config.step_s))
            poses.add(state)
            seen[state.stamp_ns] = poses.present(state)
            found = poses.newest(state.stamp_ns)
            if found is not None:
                # What a command knows is of a frame and at least 0.25 s old.
                assert found[0] % 50_000_000 == 0
                assert 250_000_000 <= state.stamp_ns - found[0] < 300_000_000
    known = [T for T in seen.values() if T is not None]
    assert len(known) == 10         # 20 frames a second, of 200 states
    # The rover faces north, and its camera says that it moves to the right: east.
    assert (known[-1] - known[0])[:3, 3] == pytest.approx([0.09, 0.0, 0.0], abs=2e-3)
    assert poses.error_m == pytest.approx(0.09, abs=5e-3)


def test_a_program_that_dies_stops_the_rover_which_says_that_it_is_lost(tmp_path):
    """The built-in odometry, which ends at its 60th frame, at 3 s."""
    (tmp_path / 'dies.py').write_text(DIES)
    scenario = Scenario.load('baseline', [
        'render_node.camera.width=320', 'render_node.camera.height=240',
        'navigator_node.lost_s=1.0', f'slam_node.command={sys.executable} {tmp_path}/dies.py'])
    x = {}
    drive = drive_to(scenario, worlds.small(), (3.0, 0.0), SEEN, 'slam', 20.0, watch=lambda
                     state, *_: x.update({round(state.stamp_ns * 1e-8): state.position_m[0]}))
    # A pose counts for 0.5 s, and 1 s later the navigator gives up.
    assert drive.outcome == 'lost' and drive.time_s == pytest.approx(4.5, abs=0.15)
    assert x[34] - x[30] > 0.02 and abs(x[max(x)] - x[40]) < 0.02     # it settles


def test_a_program_that_cannot_be_used_is_refused_with_a_line(tmp_path, plain):
    scenario = Scenario.load('flat')
    with Simulation(plain, scenario.rover, scenario.physics_node) as simulation, \
            pytest.raises(ConfigError, match="command: '' is not valid"):
        poses_of('slam', scenario, plain, simulation, 1)


def test_the_built_in_odometry_drives_a_rover_to_its_goal():
    scenario = Scenario.load('baseline', ['render_node.camera.width=320',
                                          'render_node.camera.height=240'])
    drive = drive_to(scenario, worlds.small(), (0.5, 0.0), SEEN, 'reference', 30.0)
    assert drive.outcome == ARRIVED
    assert 0.0 < drive.pose_error_m < 0.03 and drive.goal_error_m < 0.25


def test_the_truth_and_what_drifts_from_it_are_known_at_each_state(plain):
    scenario = Scenario.load('flat')
    with Simulation(plain, scenario.rover, scenario.physics_node) as simulation:
        truth, drifting = (poses_of(kind, scenario, plain, simulation, 1)
                           for kind in ('truth', 'drift=0.02'))
        state = simulation.advance(1)
        for poses in (truth, drifting):
            poses.add(state)
            T = poses.present(state)
            assert T is not None and poses.newest(state.stamp_ns)[0] == state.stamp_ns
        assert truth.error_m == 0.0 and np.array_equal(truth.present(state), state.T_world_base)
