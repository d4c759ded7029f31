"""What commands say of their results: how it went, where the files are, what to try."""

import dataclasses
import json
from pathlib import Path

from command_line import unfolded
import numpy as np
import pytest
import synthetic_bag

from lunar_rover_sim import evaluate, Trajectory
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.cli.terminal import print_table
from lunar_rover_sim.judge.evaluation.trajectory_files import trajectory_of_topic, write_tum


@pytest.fixture(scope='module', name='bag')
def _bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('results') / 'bag'
    synthetic_bag.write(path, synthetic_bag.drive(1.0))
    return path


def test_slam_run_ends_with_the_result(bag: Path, tmp_path: Path,
                                       capsys: pytest.CaptureFixture[str]) -> None:
    """The frame of its poses, success, error, and where the figure is."""
    folder = tmp_path / 'slam'
    assert main(['slam', 'run', str(bag), '-o', str(folder), '--quiet']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert f'{folder}/estimate.txt (TUM) has the poses of the frame left' in said
    assert 'done: ATE ' in said and said.endswith(f'figure: {folder}/top_view.png')
    assert (folder / 'top_view.png').is_file()
    assert json.loads((folder / 'result.json').read_text())['estimate_frame'] == 'left'


@pytest.mark.parametrize(('scale', 'words'), [(1.0, False), (1.05, False), (1.86, True)])
def test_another_scale_is_noted(scale: float, words: bool, bag: Path, tmp_path: Path,
                                capsys: pytest.CaptureFixture[str]) -> None:
    with open_bag(bag) as opened:
        truth = trajectory_of_topic(opened)
    estimate = Trajectory(truth.stamps_ns, truth.positions_m / scale, truth.orientations_wxyz)
    write_tum(tmp_path / 'estimate.txt', estimate)
    assert main(['evaluate', str(bag), str(tmp_path / 'estimate.txt')]) == 0
    assert ('--align sim3' in capsys.readouterr().out) == words
    assert main(['evaluate', str(bag), str(tmp_path / 'estimate.txt'), '--align', 'sim3']) == 0
    assert '--align sim3' not in capsys.readouterr().out


def test_tables_show_what_is_in_brackets_and_between_colons(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Units, and names of other programs: to the library that prints they are styles and signs."""
    print_table(('over', 'error [m]', '[deg]'), 1, [('1 m', '0.1', '2')])
    printed = capsys.readouterr().out
    assert 'error [m]' in printed and '[deg]' in printed
    odd = dataclasses.replace(synthetic_bag.latched_items()[0], topic='a[/b]:dog:[m]')
    synthetic_bag.write(tmp_path / 'odd', [*synthetic_bag.drive(0.1), odd])
    assert main(['bag', 'info', str(tmp_path / 'odd')]) == 0
    assert 'a[/b]:dog:[m]' in capsys.readouterr().out


def test_pictures_do_not_go_into_the_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(bag.iterdir())
    assert main(['bag', 'preview', str(bag), '-o', str(bag / '..' / bag.name)]) == 1
    assert 'is the bag itself; name another folder' in unfolded(capsys.readouterr().err)
    assert sorted(bag.iterdir()) == before


def test_missing_tf_is_said(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not where tf is recorded, and not where there are no poses."""
    def said(items: list[synthetic_bag.Item]) -> bool:
        path = tmp_path / str(len(list(tmp_path.iterdir())))
        synthetic_bag.write(path, items)
        assert main(['bag', 'info', str(path)]) == 0
        return 'no tf: it was not to be recorded' in capsys.readouterr().out

    items = synthetic_bag.drive(0.2, only=(topics.ODOM, topics.TF, topics.IMU_RAW))
    assert not said(items)
    items = [item for item in items if item.topic != topics.TF.name]
    assert said(items)
    assert not said([item for item in items if item.topic != topics.ODOM.name])


def test_an_evaluation_in_a_notebook() -> None:
    """A line, and a figure with both paths."""
    t = np.linspace(0.0, 10.0, 51)
    positions = np.stack([t, np.sin(t), 0.0 * t], axis=1)
    truth = Trajectory((t * 1e9).astype(np.int64), positions,
                       np.tile([1.0, 0.0, 0.0, 0.0], (51, 1)))
    result = evaluate(truth, truth)
    assert len(repr(result)) < 120 and 'ATE 0.0000 m' in repr(result)
    shown = result._repr_html_()
    assert shown.startswith('<div><svg') and 'ATE 0.0000 m' in shown and len(shown) < 60_000


@pytest.mark.parametrize(('options', 'words'), [
    ([], ''), (['--max-ate', '0.1', '--min-tracked', '0.7'], ''),
    (['--max-ate', '0.01'], 'at most 0.01 m'), (['--min-tracked', '1'], 'at least 1')])
def test_a_bound_decides_the_exit(options: list[str], words: str, bag: Path, tmp_path: Path,
                                  capsys: pytest.CaptureFixture[str]) -> None:
    """Poses that jump to and fro by 4 cm, of all but the last fifth of the drive."""
    with open_bag(bag) as opened:
        truth = trajectory_of_topic(opened)
    count = len(truth.stamps_ns) * 4 // 5
    shaken = truth.positions_m[:count].copy()
    shaken[::2, 1] += 0.04
    write_tum(tmp_path / 'estimate.txt', Trajectory(truth.stamps_ns[:count], shaken,
                                                    truth.orientations_wxyz[:count]))
    status = main(['evaluate', str(bag), str(tmp_path / 'estimate.txt'), *options])
    assert status == (1 if words else 0)
    assert words in unfolded(capsys.readouterr().err)
