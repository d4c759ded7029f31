"""Evaluation: trajectories against truth, and their files and plots."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from references.cases import reference
from references.figures import drawn, instead_of_files
from references.words import said
from scipy.spatial.transform import Rotation

from lunar_rover_sim.evaluation import metrics, trajectory_files
from lunar_rover_sim.evaluation.registration import align, associate, MODES, umeyama
from lunar_rover_sim.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.evaluation.trajectory_plots import save_plots

_START_NS = 1_700_000_000_123_456_789


def _way(count: int, period_ns: int, start_ns: int, seed: int = 0, error: float = 0.0,
         gap: slice = slice(0, 0), name: str = 'way') -> Trajectory:
    """Return a rolling curve; error: how far it drifts and turns away."""
    t = (np.arange(count) * period_ns + start_ns - _START_NS) * 1e-9
    rng = np.random.default_rng(seed)
    positions = np.column_stack([0.4 * t + 0.02 * np.sin(7.0 * t), np.sin(0.5 * t),
                                 0.05 * np.cos(3.0 * t)])
    positions = positions * (1.0 + error) + error * rng.normal(size=(count, 3))
    turns = Rotation.from_euler('ZYX', np.column_stack([
        0.3 * t, 0.1 * np.sin(5.0 * t), 0.05 * np.cos(4.0 * t)])) * Rotation.from_rotvec(
            error * rng.normal(size=(count, 3)))
    keep = np.ones(count, bool)
    keep[gap] = False
    return Trajectory((start_ns + np.arange(count) * period_ns)[keep], positions[keep],
                      wxyz(turns)[keep], name)


def _pair() -> tuple[Trajectory, Trajectory]:
    truth = _way(400, 20_000_000, _START_NS, name='truth')
    estimate = _way(150, 50_000_000, _START_NS + 7_000_001, 3, 0.01, slice(60, 75), 'estimate')
    turned = Rotation.from_euler('xyz', [0.4, -0.2, 1.9]).as_matrix()
    return truth, estimate.moved(turned, [3.0, -2.0, 0.5], 0.8)


@reference
def evaluations() -> dict[str, Any]:
    """Errors by each alignment, with gaps, offsets and other frames."""
    truth, estimate = _pair()
    found: dict[str, Any] = {}
    for mode in MODES:
        found[mode] = evaluate(truth, estimate, align=mode, tolerance_s=0.015, distance_m=0.7,
                               time_s=0.9).to_mapping()
    frames = estimate.stamps_ns[::2] + 11
    found['frames'] = evaluate(truth, estimate, frame_stamps_ns=frames, truth_frame='base',
                               estimate_frame='left').to_mapping()
    found['tight'] = evaluate(truth, estimate, tolerance_s=0.004, align='yaw').to_mapping()
    wrong = estimate.of_frame(np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0],
                                        [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]))
    found['turned'] = [evaluate(truth, one, align='se3').turned_deg for one in (wrong, estimate)]
    still = Trajectory(truth.stamps_ns, 0.0 * truth.positions_m, truth.orientations_wxyz, 'still')
    found['still'] = evaluate(still, truth, align='none').to_mapping()
    found['said'] = [said(evaluate, truth, still), said(evaluate, truth, estimate, align='sim'),
                     said(evaluate, truth, estimate, time_s=0.0),
                     said(evaluate, truth, estimate, tolerance_s=-1.0),
                     said(evaluate, truth, estimate, tolerance_s=0.0),
                     said(evaluate, truth, still, align='yaw')]
    return found


@reference
def associations() -> dict[str, Any]:
    """The truth at the stamps of an estimate: exact, between, single, none."""
    found: dict[str, Any] = {}
    for start in (_START_NS, 0):
        truth = _way(30, 100_000_000, start, gap=slice(10, 13))
        stamps = start + np.array([-30, -10, 0, 40, 100, 130, 960, 985, 1020, 1100, 1290, 1500,
                                   2900, 2911, 2950]) * 1_000_000
        estimate = Trajectory(stamps, np.zeros((15, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (15, 1)))
        for tolerance in (0.0, 0.011, 0.06, 1.0):
            made = associate(truth, estimate, tolerance) if tolerance else None
            if made is not None:
                found[f'{start} {tolerance}'] = {
                    'stamps': made.truth.stamps_ns - start, 'positions': made.truth.positions_m,
                    'turns': made.truth.orientations_wxyz, 'unmatched': made.unmatched}
    return found


@reference
def alignments() -> dict[str, Any]:
    """Transforms between points, mirrored ones included."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(40, 3)) * [3.0, 1.0, 0.2]
    turn = Rotation.from_euler('xyz', [0.3, 0.9, -2.0]).as_matrix()
    found = {'near': umeyama(x, 1.3 * x @ turn.T + [1.0, 2.0, 3.0], True),
             'rigid': umeyama(x, 1.3 * x @ turn.T + 0.1 * rng.normal(size=(40, 3)), False),
             'mirrored': umeyama(x, x * [1.0, 1.0, -1.0], True)}
    truth = _way(20, 10**8, _START_NS)
    line = Trajectory(truth.stamps_ns, np.outer(np.arange(20.0), [1.0, 2.0, 0.5]),
                      truth.orientations_wxyz, 'line')
    return {**found, 'yaw of a line': align(line, line.moved(turn, [0.0, 1.0, 2.0]), 'yaw'),
            'said': [said(align, line, truth, 'se3'), said(align, truth, line, 'sim3'),
                     said(align, Trajectory(truth.stamps_ns, truth.positions_m * [0.0, 0.0, 1.0],
                                            truth.orientations_wxyz, 'up'), truth, 'yaw')]}


@reference
def pairs_of_poses() -> dict[str, Any]:
    """Pairs by distance and by time, relative errors, statistics."""
    truth, estimate = _way(120, 50_000_000, _START_NS), _way(120, 50_000_000, _START_NS, 1, 0.02)
    found: dict[str, Any] = {'length': truth.length_m, 'seconds': truth.seconds - truth.seconds[0],
                             'distances': truth.distances_m}
    for name, pairs in (('0.5 m', metrics.pairs_by_distance(truth, 0.5)),
                        ('tight', metrics.pairs_by_distance(truth, 0.31, 0.01)),
                        ('long', metrics.pairs_by_distance(truth, 99.0)),
                        ('tiny', metrics.pairs_by_distance(truth, 0.001)),
                        ('0.73 s', metrics.pairs_by_time(truth, 0.73)),
                        ('0.01 s', metrics.pairs_by_time(truth, 0.01))):
        found[name] = {'pairs': pairs, 'errors': list(metrics.relative_errors(
            truth, estimate, pairs))}
    found['absolute'] = [metrics.absolute_errors_m(truth, estimate),
                         metrics.absolute_angles_rad(truth, estimate)]
    found['statistics'] = [metrics.Statistics.of(np.array(errors)) for errors in (
        [1.0, 2.0, 7.0, -1.0], [3.0], [])]
    return found


@reference
def files(folder: Path) -> dict[str, Any]:
    """What is written, and what is read of odd files."""
    # Numbers that are the same in all libraries.
    few = Trajectory([_START_NS, _START_NS + 1, _START_NS + 10**9],
                     np.array([[0.5, -0.25, 1.0], [1e-9, 2.0, 3.0], [0.1, 0.2, 0.3]]),
                     np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.5, 0.5, 0.5, 0.5]]))
    trajectory_files.write_tum(folder / 'a.txt', few)
    trajectory_files.write_euroc(folder / 'a.csv', few)
    trajectory_files.write_kitti(folder / 'k.txt', few, folder / 'times.txt')
    found: dict[str, Any] = {path.name: path.read_text() for path in sorted(folder.iterdir())}
    for name, text in (
            ('ns.txt', f'# a comment\n\n{_START_NS} 1 2 3 0 0 0 1\n'
             f'{_START_NS + 5} 1 2 3 0 0 0 1\n'),
            ('float.txt', '1.5e0 1 2 3 0 0 0.6 0.8 # right\n2.25 1 2 3 0 0 0 2\n'),
            ('minus.txt', '-1.5 1 2 3 0 0 0 1\n-.25 1 2 3 0 0 0 1\n+3. 1 2 3 0 0 0 1\n'),
            ('more.csv', '5,1,2,3,1,0,0,0,9,9\n6.0,1,2,3,1,0,0,0,9,9\n')):
        (folder / name).write_text(text)
        read = trajectory_files.read_trajectory(folder / name)
        found[f'read {name}'] = {'stamps': [int(ns) for ns in read.stamps_ns],
                                 'poses': np.hstack([read.positions_m, read.orientations_wxyz])}
    for times in (None, folder / 'times.txt'):
        read = trajectory_files.read_trajectory(folder / 'k.txt', times)
        found[f'kitti {times is None}'] = {'stamps': [int(ns) for ns in read.stamps_ns],
                                           'turns': read.orientations_wxyz}
    refused = {}
    for name, text in (('none.txt', '# only\n'), ('seven.txt', '1 2 3 4 5 6 7\n'),
                       ('back.txt', '2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n'),
                       ('word.txt', '1 0 0 x 0 0 0 1\n'), ('wide.txt', '1 0 0 1e13 0 0 0 1\n'),
                       ('stamp.txt', '1_0 0 0 0 0 0 0 1\n'), ('zero.txt', '1 0 0 0 0 0 0 0.3\n'),
                       ('nan.txt', 'nan 0 0 0 0 0 0 1\n'), ('far.txt', '1e30 0 0 0 0 0 0 1\n'),
                       ('skew.txt', '1 0 0 0 0 1 0.1 0 0 0 1 0\n')):
        (folder / name).write_text(text)
        refused[name] = said(trajectory_files.read_trajectory, folder / name).replace(
            str(folder), 'FOLDER')
    return {**found, 'said': refused}


@reference
def plots(folder: Path) -> dict[str, Any]:
    """What the plots of an evaluation show."""
    truth, estimate = _pair()
    found: dict[str, Any] = {}
    for mode in ('sim3', 'none'):
        with instead_of_files() as figures:
            names = save_plots(evaluate(truth, estimate, align=mode), folder)
        found[mode] = {path.name: drawn(figure) for path, figure in zip(names, figures)}
    short = Trajectory(truth.stamps_ns[:4], truth.positions_m[:4], truth.orientations_wxyz[:4])
    with instead_of_files() as figures:
        save_plots(evaluate(short, short, align='none'), folder)
    found['short'] = [drawn(figure) for figure in figures]
    found['finite'] = math.isfinite(truth.length_m)
    return found
