"""Trajectories of a rover that wanders, true and estimated."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.base.seconds import in_seconds
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz


def wander(n: int, seed: int, period_ns: int = 50_000_000) -> Trajectory:
    """Return a smooth random walk of 5 cm steps with turning attitude."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.1 * rng.standard_normal(n))
    climb = 0.2 * np.sin(np.linspace(0.0, 9.0, n))
    steps = 0.05 * np.stack([np.cos(heading), np.sin(heading), climb], axis=1)
    rotations = Rotation.from_euler('ZYX', np.stack(
        [heading, climb, 0.1 * rng.standard_normal(n)], axis=1))
    return Trajectory(period_ns * np.arange(1, n + 1), np.cumsum(steps, axis=0),
                      wxyz(rotations), 'truth')


def noisy(truth: Trajectory, seed: int, scale: float = 1.0) -> Trajectory:
    """Return the truth with noise, gaps, another scale and another frame."""
    rng = np.random.default_rng(seed)
    n = len(truth)
    positions = (truth.positions_m + 0.01 * rng.standard_normal((n, 3))) / scale
    rotations = truth.rotations * Rotation.from_rotvec(0.01 * rng.standard_normal((n, 3)))
    keep = np.ones(n, dtype=bool)
    keep[n // 3:n // 3 + n // 20] = False
    keep[rng.choice(n, n // 10, replace=False)] = False
    moved = Trajectory(truth.stamps_ns, positions, wxyz(rotations), 'estimate').moved(
        Rotation.random(random_state=seed).as_matrix(), rng.standard_normal(3))
    return moved.select(keep)


def files_of_others(euroc: Path, kitti: Path, times: Path, walk: Trajectory) -> None:
    """Write a trajectory as EuRoC and KITTI have it, the latter with its stamps."""
    poses = np.hstack([walk.positions_m, walk.orientations_wxyz])
    euroc.write_text('#timestamp [ns], position, orientation wxyz\n' + ''.join(
        f'{ns},{",".join(map(repr, pose))}\n' for ns, pose in zip(walk.stamps_ns, poses.tolist())))
    np.savetxt(kitti, np.dstack([matrix_from_wxyz(walk.orientations_wxyz),
                                 walk.positions_m[..., None]]).reshape(-1, 12), '%.17g')
    times.write_text(''.join(f'{in_seconds(ns)}\n' for ns in walk.stamps_ns.tolist()))
