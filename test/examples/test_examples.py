"""Every example runs, on a small world with small images, and does what it says."""

import os
from pathlib import Path
import struct
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

from conftest import PLAIN, SMALL, SMALL_WORLD
import cv2
import matplotlib
import numpy as np
import pytest
from snippets import module_of
import synthetic_bag

from lunar_rover_sim import open_bag, Scenario
from lunar_rover_sim.products.sequences.export import export

FOLDER = Path(__file__).parents[2] / 'examples'
TESTED = {'step_and_draw', 'record_and_read', 'frames_as_numpy', 'own_scenario', 'own_controller',
          'own_sensor', 'own_estimator', 'sweep_with_dask', 'live_view', 'teleop',
          'table_in_short', 'pytorch_shards'}


def example(name: str) -> ModuleType:
    """Return an example as a module."""
    return module_of(FOLDER / f'{name}.py')


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every scenario a small one; its own settings stay."""
    load = Scenario.load

    def small(name: Any, overrides: Any = (), **options: Any) -> Scenario:
        if Path(str(name)).is_file():
            return load(name, overrides, **options)
        own = ([f'{key}={value}' for key, value in overrides.items()]
               if isinstance(overrides, dict) else list(overrides))
        return load(name, [*SMALL, *PLAIN, *own], **options)

    monkeypatch.setattr(Scenario, 'load', staticmethod(small))


def test_all_are_tested_short_and_on_the_page() -> None:
    page = (FOLDER.parent / 'docs' / 'examples.md').read_text(encoding='utf-8')
    files = sorted(FOLDER.glob('*.py'))
    assert {path.stem for path in files} == TESTED
    for path in files:
        text = path.read_text(encoding='utf-8')
        assert len(text.splitlines()) < 60 and text.startswith('"""'), path.name
        assert path.name in page, path.name
        picture = f'resource/pictures/examples/{path.stem}.webp'
        assert f'../{picture}' in page, path.name
        image = cv2.imread(str(FOLDER.parent / picture))
        assert image is not None and image.std() > 5.0, path.name


def test_step_and_draw(tmp_path: Path) -> None:
    example('step_and_draw').main(tmp_path / 'out')
    left, depth_m = (cv2.imread(str(tmp_path / 'out' / 'left.png'), cv2.IMREAD_UNCHANGED),
                     np.load(tmp_path / 'out' / 'depth_m.npy'))
    assert left.shape == depth_m.shape == (240, 320) and left.std() > 10.0


@pytest.mark.ros
def test_record_and_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example('record_and_read').main(tmp_path / 'run')
    said = capsys.readouterr().out
    assert '/stereo/left/image_raw' in said and 'mean specific force' in said


def test_frames_as_numpy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = synthetic_bag.write(tmp_path / 'bag', synthetic_bag.drive(0.5))
    assert example('frames_as_numpy').main(bag) == 5
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 5 and all('nearest' in line and ', at [' in line for line in said)


def test_own_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example('own_scenario').main(tmp_path / 'own.yaml')
    scenario = Scenario.load(tmp_path / 'own.yaml')
    assert scenario.render_node.sun.elevation_deg == 3.0 and scenario.run.duration_s == 30.0
    assert 'refused: render_node.sun.elevation_deg: 120' in capsys.readouterr().out.replace(
        'overrides: ', '')


def test_own_controller() -> None:
    assert example('own_controller').main(0.3, 0.1) <= 0.05


def test_own_sensor() -> None:
    readings = example('own_sensor').main(1.0)
    assert readings.shape == (10, 2) and 0.05 < readings.std() < 10.0


def test_own_sensor_at_a_rate_that_does_not_divide_the_steps() -> None:
    """30 Hz in steps of 5 ms: each reading comes with the first state at which it is due."""
    sensor = example('own_sensor').Inclinometer(np.random.default_rng(1), 30)
    states = [SimpleNamespace(stamp_ns=5_000_000 * k, orientation_wxyz=(1.0, 0.0, 0.0, 0.0))
              for k in range(201)]
    assert sum(sensor.read(state) is not None for state in states) == 30


def test_own_estimator() -> None:
    """It slips behind the command, by less than it drives."""
    assert 0.0 < example('own_estimator').main(2.0) < 0.1


def test_sweep_with_dask() -> None:
    pytest.importorskip('distributed')
    reached = example('sweep_with_dask').main(1.0, SMALL_WORLD)
    speeds = list(reached.values())
    assert speeds == sorted(speeds) and 0.0 < speeds[0] < speeds[-1] < 0.2


def test_live_view() -> None:
    matplotlib.use('Agg')
    assert example('live_view').main(0.4) == 2


def test_table_in_short(capsys: pytest.CaptureFixture[str]) -> None:
    errors_mm = example('table_in_short').main(0.5)
    assert list(errors_mm) == ['baseline', 'feature_sparse', 'low_albedo']
    assert all(0.0 < error < 20.0 for error in errors_mm.values())
    assert capsys.readouterr().out.count('\n') == 5


def test_pytorch_shards(tmp_path: Path) -> None:
    """Images and depths of one sample come together; without PyTorch, one by one."""
    bag = synthetic_bag.write(tmp_path / 'bag', synthetic_bag.drive(0.5))
    export(bag, tmp_path / 'shards', 'webdataset')
    module = example('pytorch_shards')
    with open_bag(bag) as recorded:
        frames = list(recorded.frames())
    samples = list(module.Shards(tmp_path / 'shards'))
    assert len(samples) == len(frames) == 5
    for (image, depth_m), frame in zip(samples, frames):
        np.testing.assert_array_equal(np.round(255 * image[0]), frame.left)
        known = np.isfinite(frame.depth_m)
        np.testing.assert_array_equal(depth_m[known], frame.depth_m[known])
    with pytest.raises(FileNotFoundError, match='there are no shards'):
        module.main(tmp_path / 'bag')
    assert module.main(tmp_path / 'shards') == (5 if module.DataLoader is None else 2)


@pytest.mark.parametrize('name', ['frames_as_numpy', 'pytorch_shards', 'teleop'])
def test_without_what_they_need_they_say_so(name: str) -> None:
    """In words on stderr; keys of a pipe are none."""
    ended = subprocess.run([sys.executable, FOLDER / f'{name}.py'], stdin=subprocess.DEVNULL,
                           capture_output=True, text=True)
    assert ended.returncode == 1 and ended.stderr and 'Traceback' not in ended.stderr


def test_a_policy_that_does_not_exist_is_refused_before_anything_walks() -> None:
    """It was read after the walks of all that came before it."""
    ended = subprocess.run([sys.executable, FOLDER / 'learning/returns.py', 'nope.onnx'],
                           capture_output=True, text=True)
    assert ended.returncode == 1 and not ended.stdout
    error, = ended.stderr.splitlines()
    assert error.endswith('nope.onnx: cannot be read: no such file')


@pytest.mark.parametrize('name', ['train_gait', 'train_feedback', 'train_walk'])
def test_training_says_in_one_line_what_to_install(name: str) -> None:
    hidden = ('import runpy, sys; sys.modules["cma"] = sys.modules["stable_baselines3"] = None; '
              'runpy.run_path(sys.argv[1], run_name="__main__")')
    path = FOLDER / 'learning' / f'{name}.py'
    ended = subprocess.run([sys.executable, '-c', hidden, path], capture_output=True, text=True,
                           cwd=path.parent)
    assert ended.returncode == 1 and ended.stderr.count('\n') == 1
    assert "install it by pip install -e '.[train]'" in ended.stderr


@pytest.mark.ros
def test_teleop() -> None:
    """Keys and a joystick give velocities, which are published."""
    pytest.importorskip('rclpy')
    module = example('teleop')

    def read_by(source: Any, data: bytes) -> list[tuple[float, float]]:
        out, into = os.pipe()
        os.write(into, data)
        os.close(into)
        return list(source(out))

    assert read_by(module.pressed, b'wxa q') == [(1, 0), (0, 1), (0, 0)]
    events = b''.join(struct.pack('IhBB', 0, value, kind, number) for value, kind, number in (
        (0, 0x82, 0), (-32767, 2, 1), (1, 1, 1), (32767, 2, 0)))
    assert read_by(module.pulled, events) == [(0, 0), (1, 0), (1, -1)]
    module.main(iter([(1, 0)]))
