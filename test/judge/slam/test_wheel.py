"""ORB-SLAM3 as a wheel: resource/orb_slam3/wheel.py with a stand-in for its interface."""

from importlib.util import find_spec
from pathlib import Path
import runpy
import subprocess
import sys

import cv2
from judge.slam.fed_frames import feed, LEFT, VOCABULARY
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic
from waiting import LIMIT_S

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.paths import program_path
from lunar_rover_sim.judge.slam import protocol
from lunar_rover_sim.judge.slam.estimators import Estimator, is_python
from lunar_rover_sim.judge.slam.program import SlamProgram, WHEEL_PROGRAM
from lunar_rover_sim.judge.slam.run_on_bag import run_on_bag

STUB = Path(__file__).parent / 'pyorbslam3_stub'
TURN = Rotation.from_rotvec([0.0, 3.1, 0.02])       # of the stand-in


@pytest.fixture
def wheel(monkeypatch, tmp_path) -> list[str]:
    """Return the command that starts the program, with the stand-in, and a settings file."""
    monkeypatch.setenv('PYTHONPATH', str(STUB))
    (tmp_path / 'orb.yaml').write_text('%YAML:1.0\n')
    return [sys.executable, str(program_path(WHEEL_PROGRAM))]


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    items = synthetic.drive(0.6, state_hz=100, only=synthetic.FOR_ESTIMATORS)
    return synthetic.write(tmp_path_factory.mktemp('wheel') / 'bag', items)


@pytest.mark.parametrize(('sensor', 'count'), [('mono', 1), ('stereo', 2), ('stereo-inertial', 2)])
def test_behind_pipes(wheel, tmp_path, sensor: str, count: int) -> None:
    """What ORB-SLAM3 prints is not between the answers; poses are those of the wheel.

    With an IMU those of a map that is not yet turned to gravity are none, nor is that of the frame
    during which it was turned, nor of the fifth one, at which the stand-in gives its map up.
    """
    program = SlamProgram([*wheel, 'voc.txt', str(tmp_path / 'orb.yaml'), sensor], {}, 20.0, 20.0)
    inertial = sensor == 'stereo-inertial'
    try:
        answers = feed(program, range(2_000_000_000, 2_000_007_000, 1000), (LEFT,) * count,
                       inertial)
    finally:
        program.close()
    no, yes, lost = protocol.INITIALISING, protocol.TRACKING, protocol.LOST
    assert [a.state for a in answers] == (
        [no, no, no, yes, lost, lost, yes] if inertial else [no] + [yes] * 6)
    assert [a.stamp_ns for a in answers] == [2_000_000_000 + 1000 * k for k in range(7)]
    assert answers[3].position_m == pytest.approx(
        (4.0, 11.0 * count, 2.000002999 if inertial else 0.0), abs=1e-9)
    w, x, y, z = answers[3].wxyz
    assert (Rotation.from_quat([x, y, z, w]) * TURN.inv()).magnitude() < 1e-6


@pytest.mark.parametrize(('words', 'said'), [
    (['voc', 'orb.yaml', 'stereo-inertail'], 'sensors are mono, stereo, stereo-inertial'),
    (['voc', 'orb.yaml', 'sequence', 'times', 'run'], 'sensors are mono'),
    (['voc', 'missing.yaml', 'stereo'], 'missing.yaml')])
def test_what_is_wrong_is_named_in_a_line(wheel, words: list[str], said: str, tmp_path) -> None:
    ended = subprocess.run([*wheel, *words], capture_output=True, text=True, timeout=LIMIT_S,
                           cwd=tmp_path)
    assert ended.returncode != 0
    assert said in ended.stderr.splitlines()[-1] and 'Traceback' not in ended.stderr


@pytest.mark.skipif(find_spec('pyorbslam3') is not None, reason='this Python has the wheel')
def test_a_python_without_the_wheel_is_named(monkeypatch, tmp_path) -> None:
    monkeypatch.delenv('PYTHONPATH', raising=False)
    ended = subprocess.run([sys.executable, str(program_path(WHEEL_PROGRAM)), 'v', 's', 'mono'],
                           capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 1
    assert f'pyorbslam3 cannot be imported by {sys.executable}' in ended.stderr


@pytest.mark.parametrize('sensor', ['mono', 'stereo', 'stereo-inertial'])
def test_in_place_of_the_example_programs(wheel, bag, tmp_path, sensor: str) -> None:
    """`--executable PYTHON`: every frame but the first has the pose that the stand-in gave it."""
    (tmp_path / 'voc.txt').write_text(VOCABULARY)
    (tmp_path / 'out').mkdir()
    estimator = Estimator('orbslam3', sensor, Path(sys.executable), tmp_path / 'voc.txt')
    result = run_on_bag(bag, estimator, tmp_path / 'out')
    assert result.reason == ''
    assert result.tracked_share == pytest.approx(1.0 - 1.0 / result.frames)
    log = (tmp_path / 'out/log.txt').read_text()
    assert f'reads {tmp_path}/voc.txt' in log
    rows = np.loadtxt(tmp_path / 'out/f_run.txt')
    assert len(rows) == result.frames - 1 and (tmp_path / 'out/kf_run.txt').exists()
    assert rows[:, 1].tolist() == list(range(2, result.frames + 1))
    # Samples of the IMU come up to the frame, not beyond.
    after_s = rows[:, 3] - 1e-9 * rows[:, 0]
    assert (np.abs(after_s) < 1e-6).all() if sensor == 'stereo-inertial' else not rows[:, 3].any()


def test_under_the_name_of_an_example(wheel, bag, tmp_path) -> None:
    """A link called mono_euroc is one; where no frame is tracked there is no trajectory."""
    link = tmp_path / 'mono_euroc'
    link.symlink_to(wheel[1])
    folder = tmp_path / 'sequence/mav0/cam0/data'
    folder.mkdir(parents=True)
    (tmp_path / 'times.txt').write_text('1000000000\n')
    synthetic_png(folder / '1000000000.png')
    ended = subprocess.run([wheel[0], str(link), 'voc', 'orb.yaml', 'sequence', 'times.txt', 'a'],
                           capture_output=True, text=True, timeout=LIMIT_S, cwd=tmp_path)
    assert (ended.returncode, ended.stderr) == (0, '')
    assert 'no frame was tracked' in ended.stdout and not (tmp_path / 'f_a.txt').exists()


def synthetic_png(path: Path) -> None:
    assert cv2.imwrite(str(path), LEFT)


def test_which_programs_are_a_python(tmp_path) -> None:
    assert [is_python(Path(name)) for name in ('/x/bin/python', 'python3', 'python3.11')] == [
        True] * 3
    assert not any(is_python(Path(name)) for name in ('stereo_euroc', 'python-slam', 'python3.x'))
    (tmp_path / 'voc').write_text('')
    with pytest.raises(SlamError, match="'rgbd' is not valid for the wheel of ORB-SLAM3"):
        Estimator('orbslam3', 'rgbd', Path(sys.executable), tmp_path / 'voc')


SETTINGS = """%YAML:1.0
Stereo.T_c1_c2: !!opencv-matrix
   data: [1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
IMU.Gravity: 1.635
IMU.T_b_c1: !!opencv-matrix
   data: [0.0, 0.0, 1.0, 0.12, -1.0, 0.0, 0.0, 0.05, 0.0, -1.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0]
IMU.NoiseGyro: 0.0002
IMU.NoiseAcc: 0.002
IMU.AccWalk: 0.003
"""


def test_settings_in_the_unit_in_which_gravity_is_that_of_the_earth(tmp_path) -> None:
    """Lengths and accelerations are six times as many; turns and rates stay. OpenCV reads it."""
    program = runpy.run_path(str(program_path(WHEEL_PROGRAM)))
    assert program['units_per_m'](SETTINGS) == pytest.approx(6.0)
    assert program['units_per_m']('IMU.NoiseAcc: 0.002\n') == 1.0
    text = program['in_units'](SETTINGS, 6.0)
    there = text.replace('   data', '   rows: 4\n   cols: 4\n   dt: f\n   data')
    storage = cv2.FileStorage(there, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    assert storage.getNode('Stereo.T_c1_c2').mat()[:, 3] == pytest.approx([0.6, 0.0, 0.0, 1.0])
    T = storage.getNode('IMU.T_b_c1').mat()
    assert T[:, 3] == pytest.approx([0.72, 0.3, 1.2, 1.0])
    assert T[:3, :3].tolist() == [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    assert [storage.getNode(f'IMU.{name}').real() for name in ('NoiseAcc', 'AccWalk', 'NoiseGyro')
            ] == pytest.approx([0.012, 0.018, 0.0002])


@pytest.mark.parametrize(('text', 'said'), [
    (SETTINGS.replace('1.635', '0.0'), 'IMU.Gravity: 0 is not valid; valid is > 0 [m/s^2]'),
    (SETTINGS.replace('IMU.T_b_c1', 'Tbc'), 'the settings hold no IMU.T_b_c1: with IMU.Gravity')])
def test_gravity_that_cannot_be_heeded_is_named(wheel, tmp_path, text: str, said: str) -> None:
    (tmp_path / 'orb.yaml').write_text(text)
    ended = subprocess.run([*wheel, 'voc', 'orb.yaml', 'stereo-inertial'], capture_output=True,
                           text=True, timeout=LIMIT_S, cwd=tmp_path, stdin=subprocess.DEVNULL)
    assert ended.returncode == 1
    assert said in ended.stderr.splitlines()[-1] and 'Traceback' not in ended.stderr
