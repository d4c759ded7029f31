"""Ways over sites that a navigator has found, to be driven again without it.

A navigator sees by the cameras, and images differ a little from processor to processor, so it
takes another way on each. Along a given way the motion is the same on all of them, under any sun.
"""

from __future__ import annotations

from collections.abc import Iterable
import json
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import read_odometry
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.base.frames import Array, distance_along
from lunar_rover_sim.judge.slam.seal import read_seal, RECORDINGS, Seal

_STEP_M = 0.05      # between the points that are looked at
_JOINED_M = 0.1     # places as near as this are joined, so that what led back is left out
_OFF_M = 0.03       # of the straight pieces from the points

# Settings of a scenario with which drive_node follows a way, and the run ends at its end. It goes
# through craters whose rims a navigator backs off from: it stops only where it lies on its side.
ALONG = ('run.nodes=[physics_node, gait_controller_node, render_node, recorder_node, drive_node]',
         'drive_node.mode=waypoints', 'drive_node.end_after_s=1', 'drive_node.stuck_time_s=60',
         'drive_node.tilt_limit_deg=80')


def way_of(positions_m: Array) -> Array:
    """Return (n, 2) waypoints along (m, 2) or (m, 3) positions, to 1 cm, without the first place.

    It is the shortest way over the places, so it leaves out what led back to one of them.

    Raises:
        SlamError: If it has not moved.
    """
    points = np.asarray(positions_m, float)[:, :2]
    driven = distance_along(points)
    if not driven[-1] > _JOINED_M:
        raise SlamError(f'way: the rover has moved by {driven[-1]:.2f} m only')
    points = points[np.searchsorted(driven, np.arange(0.0, driven[-1], _STEP_M))]
    tree = cKDTree(points)
    before = dijkstra(tree.sparse_distance_matrix(tree, _JOINED_M).tocsr(), indices=0,
                      return_predecessors=True)[1]
    kept = [len(points) - 1]
    while kept[-1] > 0:
        kept.append(before[kept[-1]])
    corners = cv2.approxPolyDP(points[kept[::-1]].astype(np.float32)[:, None], _OFF_M, False)
    return np.round(corners[1:, 0].astype(float), 2)


def settings_of(way_m: Array) -> tuple[str, str]:
    """Return the settings by which drive_node follows (n, 2) waypoints."""
    x, y = (json.dumps([float(value) for value in axis]) for axis in way_m.T)
    return f'drive_node.waypoints_x_m={x}', f'drive_node.waypoints_y_m={y}'


def ways_of(source: Path, seeds: Iterable[int], scenario: str) -> dict[int, Array]:
    """Return seed → (n, 2) waypoints [m].

    Args:
        source: A seal whose drives follow ways, or the folder of a benchmark or of a condition of
            a traverse, whose recordings are followed.

    Raises:
        SlamError: If it holds no way of a seed.
        BagError: If a recording cannot be read.
    """
    seal = None if source.is_dir() else read_seal(source)
    return {seed: _recorded(source, f'{scenario}-seed{seed}') if seal is None
            else _sealed(seal, source, f'{scenario}-seed{seed}') for seed in seeds}


def _recorded(folder: Path, name: str) -> Array:
    if not (bags := sorted(folder.glob(f'**/{RECORDINGS}/{name}/{BAG_FOLDER}'))):
        raise SlamError(f'{folder}: holds no recording of {name}, whose way could be followed')
    with open_bag(bags[0]) as bag:
        return way_of(read_odometry(bag).positions_m)


def _sealed(seal: Seal, path: Path, name: str) -> Array:
    texts = [text.partition('=')[2] for text in seal.own.get(name, ())]
    try:
        way = np.array([json.loads(text) for text in texts], float).T
    except ValueError:
        way = np.zeros(0)
    if way.ndim != 2 or way.shape[1] != 2:
        raise SlamError(f'{path}: holds no way of {name}')
    return way
