"""A share of `portability.py`: the same tests pass as on a processor of 2008."""

import os
import subprocess
import sys

import numpy as np
from portability import outcome, PARTS, run, switches, TEST
import pytest

CHOSEN = 'regression', 'ground/world/test_same_everywhere.py'


def test_chosen_tests_pass_with_all_switches():
    """Code of NumPy, the C library, OpenCV, Numba and OpenBLAS for old processors, all at once."""
    found, said = run([str(TEST / name) for name in CHOSEN], switches()['all of these'], [], 500.0)
    assert found.isdigit() and int(found) > 25, said


def test_code_of_another_vector_width_is_not_drawn_with(tmp_path):
    """Mesa's cache of shaders does not tell widths apart: code for 256 bit corrupts the heap."""
    test = [str(TEST / 'image/rendering/test_rock_looks.py::test_rocks_are_drawn_to_300_m')]
    for width in ({}, {'LP_NATIVE_VECTOR_WIDTH': '128'}):
        found, said = run(test, {'MESA_SHADER_CACHE_DIR': str(tmp_path), **width}, [], 500.0)
        assert found == '1', said


def test_a_drive_is_the_same_bit_by_bit_on_other_processors(tmp_path):
    """On ground that gives, from a slope, with a noisy IMU: whatever BLAS, NumPy and Numba choose.

    Not so where the C library has no FMA, for which it has another sine.
    """
    program = """
import hashlib, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
import physics_scene
from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise
said = hashlib.sha256()
imu = ImuNoise(ImuConfig(), 200.0, np.random.default_rng(3))
world = physics_scene.make_world(physics_scene.rough_heights())
config = PhysicsConfig(ground=GroundConfig(model='regolith'), start=StartPose(yaw_deg=33.0))
def observe(state):
    sample = imu.measure(state.specific_force_mps2, state.imu_rate_radps)
    foot = simulation.foot_motion
    for values in (*vars(state).values(), sample.specific_force, sample.rate,
                   foot.sweep_mps, foot.slip_mps):
        said.update(np.asarray(values).tobytes())
with Simulation(world, physics_scene.ROVER, config) as simulation:
    physics_scene.trot(simulation, 1.0, observe=observe)
print(said.hexdigest())
"""
    known = switches()
    ways = [{}, {**known['OpenBLAS of Nehalem'], **known['Numba generic'],
                 **known['NumPy without AVX2']}]
    found = [subprocess.run([sys.executable, '-c', program, str(TEST)], capture_output=True,
                            text=True, check=True, env={
                                **os.environ, 'PYTHONPATH': os.pathsep.join(sys.path), **way}
                            ).stdout for way in ways]
    assert len(found[0].strip()) == 64 and len(set(found)) == 1


def test_what_is_switched_off_is_there():
    """NumPy refuses names that it does not know, and those that it cannot do without."""
    core = np._core if hasattr(np, '_core') else np.core
    named = switches()['NumPy without AVX2']['NPY_DISABLE_CPU_FEATURES'].split()
    assert set(named) <= set(core._multiarray_umath.__cpu_dispatch__)
    newest = switches()['NumPy without AVX-512']['NPY_DISABLE_CPU_FEATURES'].split()
    assert set(newest) <= set(named) and not {'AVX2', 'X86_V3'} & set(newest)
    if os.uname().machine == 'x86_64' and core._multiarray_umath.__cpu_features__.get('AVX2'):
        assert named


def test_parts_are_folders_of_tests():
    assert all((TEST / folder).is_dir() for folders in PARTS.values() for folder in folders)


@pytest.mark.parametrize(('said', 'status', 'expected'), [
    ('..\n5 passed in 3.1s\n', 0, '5'), ('2 failed, 3 passed, 1 error in 9s', 1, '3, 3 failed'),
    ('', -4, 'signal 4'), ('no tests ran in 0.1s', 5, 'status 5')])
def test_outcome_of_a_part(said, status, expected):
    assert outcome(said, status) == expected
