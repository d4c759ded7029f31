"""Trajectories in files: what is kept, and what is refused."""

import dataclasses
import json
from pathlib import Path
import re

from command_line import unfolded
from judge.evaluation.wandering import files_of_others, wander
import numpy as np
import pytest

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.judge.evaluation import trajectory_files
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate


def test_files_keep_what_is_written(tmp_path):
    truth = wander(50, 9, period_ns=33_333_333)
    trajectory_files.write_tum(tmp_path / 'a.txt', truth)
    files_of_others(tmp_path / 'data.csv', tmp_path / 'k.txt', tmp_path / 'times.txt', truth)
    for path, times in (('a.txt', None), ('data.csv', None), ('k.txt', tmp_path / 'times.txt')):
        read = trajectory_files.read_trajectory(tmp_path / path, times)
        assert np.array_equal(read.stamps_ns, truth.stamps_ns)
        assert np.allclose(read.positions_m, truth.positions_m, rtol=0, atol=1e-15)
        dots = np.sum(read.orientations_wxyz * truth.orientations_wxyz, axis=1)
        assert np.allclose(np.abs(dots), 1.0, atol=1e-14)
    assert np.array_equal(trajectory_files.read_kitti(tmp_path / 'k.txt').stamps_ns,
                          np.arange(50) * 100_000_000)


def test_stamps_of_orb_slam3_are_ns(tmp_path):
    (tmp_path / 'f.txt').write_text('1403636579763555584.000000 1 2 3 0 0 0 1\n'
                                    f'{(1 << 63) - 1} 1 2 4 0 0 0 1\n')
    read = trajectory_files.read_tum(tmp_path / 'f.txt')
    assert read.stamps_ns.tolist() == [1403636579763555584, (1 << 63) - 1]


BAD_FILES = {
    'empty.txt': ('# nothing\n', 'holds no poses'),
    'nan.txt': ('0.1 0 0 nan 0 0 0 1\n', 'line 1: nan is not valid; valid is finite'),
    'far.txt': ('0.1 0 0 1e300 0 0 0 1\n', 'line 1: 1e300 is not valid; valid is .* 1e[+]12'),
    'digits.txt': ('0.1 0 0 1_0 0 0 0 1\n', "line 1: '1_0' is not a number"),
    'other_digits.txt': ('0.1 0 0 \u0661 0 0 0 1\n', "line 1: '\u0661' is not a number"),
    'digits_of_time.txt': ('1_0 0 0 1 0 0 0 1\n', 'a stamp is not a finite number'),
    'inf_stamp.txt': ('inf 0 0 0 0 0 0 1\n', 'a stamp is not a finite number'),
    'late_stamp.txt': (f'{1 << 63} 0 0 0 0 0 0 1\n', 'stamp .* ns is not valid; valid are 64'),
    'words.txt': ('0.1 0 0 0 0 0 0 1\n0.2 a 0 0 0 0 0 1\n', "line 2: 'a' is not a number"),
    'short.txt': ('0.1 0 0 0 0 0 0 1\n0.2 0 0\n', 'line 2 has 3 columns; valid is 8$'),
    'columns.txt': ('1 2 3 4\n', 'line 1 has 4 columns'),
    'unsorted.txt': ('0.2 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n', 'line 2: stamp'),
    'zero.txt': ('0.1 0 0 0 0 0 0 0\n', 'quaternion of length 0'),
    'long.txt': ('0.1 0 0 0 0 60 0 80\n', 'quaternion of length 100; valid is 1'),
    'mirror.txt': ('1 0 0 0 0 1 0 0 0 0 -1 0\n', 'line 1: the first three columns'),
    'skew.txt': ('1 0 0 0 0 2 0 0 0 0 1 0\n', 'line 1: the first three columns'),
}


@pytest.mark.parametrize('name', BAD_FILES)
def test_bad_files_are_named(tmp_path, name):
    text, words = BAD_FILES[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(EvaluationError, match=words) as error:
        trajectory_files.load(tmp_path / name)
    assert name in str(error.value) and '\n' not in str(error.value)


@pytest.mark.parametrize(('words', 'problem'), [
    ('tum.txt kitti.txt', 'kitti.txt: is a KITTI file, which has no stamps'),
    ('kitti.txt data.csv', 'kitti.txt: is a KITTI file, which has no stamps'),
    ('tum.txt data.csv --times times.txt', 'times.txt is not used'),
    ('kitti.txt short.txt', 'kitti.txt has 50 poses and .*short.txt 49'),
    ('short.txt tum.txt --times times.txt', '49 poses, but 50 stamps')])
def test_files_without_stamps_are_not_given_any_in_silence(tmp_path, monkeypatch, capsys, words,
                                                           problem):
    """KITTI numbered at 10 Hz, against a truth at 20, had an error of its own."""
    monkeypatch.chdir(tmp_path)
    truth = wander(50, 9)
    trajectory_files.write_tum('tum.txt', truth)
    files_of_others(Path('data.csv'), Path('kitti.txt'), Path('times.txt'), truth)
    rows = Path('kitti.txt').read_text().splitlines(keepends=True)
    Path('short.txt').write_text(''.join(rows[1:]))
    assert main(['evaluate', *words.split()]) == 1
    said = unfolded(capsys.readouterr().err)
    assert re.search(problem, said) and said.count('\n') == 1
    for pair in ('kitti.txt kitti.txt', 'tum.txt kitti.txt --times times.txt'):
        assert main(['evaluate', *pair.split(), '--json']) == 0
        assert json.loads(capsys.readouterr().out)['ate_m']['max'] < 1e-9


def test_more_bad_input(tmp_path):
    (tmp_path / 'binary.txt').write_bytes(b'\xff\xfe\x00')
    with pytest.raises(EvaluationError, match='not a text file'):
        trajectory_files.load(tmp_path / 'binary.txt')
    truth = wander(100, 11)
    line = dataclasses.replace(truth, positions_m=np.outer(np.arange(100.0), [0.3, 0.1, 0.2]))
    assert evaluate(line, line, align='yaw').ate_m.max < 1e-12
    still = Trajectory(truth.stamps_ns, np.zeros((100, 3)), truth.orientations_wxyz, 'still')
    with pytest.raises(EvaluationError, match='does not move'):
        evaluate(truth, still)
    with pytest.raises(EvaluationError, match='no horizontal motion'):
        evaluate(truth, still, align='yaw')
    with pytest.raises(EvaluationError, match='pose 3 is not finite'):
        dataclasses.replace(truth, positions_m=np.where(np.arange(100)[:, None] == 3, np.nan, 0.0)
                            * np.ones(3))
    for stamps, pose in (([2, 1], 1), ([1, 2, 2], 2)):
        n = len(stamps)
        with pytest.raises(EvaluationError, match=f'stamps do not increase: pose {pose}'):
            Trajectory(stamps, np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)))


@pytest.mark.parametrize('stamps', [np.array([1.0, 2.5]), np.array([True, False]), ['1', '2']])
def test_stamps_are_whole_nanoseconds(stamps):
    """Seconds would be cut to whole ns; without poses there is no type to refuse."""
    with pytest.raises(EvaluationError, match='^mine: stamps_ns: .* is not valid; valid are whole '
                       'nanoseconds$'):
        Trajectory(stamps, np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), 'mine')
    assert len(Trajectory([], np.zeros((0, 3)), np.zeros((0, 4)))) == 0
    assert Trajectory(np.array([1, 2], np.uint32), np.zeros((2, 3)),
                      np.tile([1.0, 0, 0, 0], (2, 1))).stamps_ns.dtype == np.int64
