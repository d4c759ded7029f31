"""Instances of rocks and craters as data sets have them: run lengths and outlines."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lunar_rover_sim.errors import SequenceError
from lunar_rover_sim.rendering.instances import Instance
from lunar_rover_sim.sequences.sensors import SensorSuite


def run_lengths(instance: Instance, height: int, width: int) -> list[int]:
    """Return the run lengths of COCO: pixels outside and inside in turn, column by column.

    Args:
        height, width: Of the whole image [px].
    """
    padded = np.zeros((instance.mask.shape[0] + 2, instance.mask.shape[1]), np.int8)
    padded[1:-1] = instance.mask
    change = np.diff(padded, axis=0).T
    column, row = np.nonzero(change > 0)
    starts = (instance.x + column) * height + instance.y + row
    column, row = np.nonzero(change < 0)
    ends = (instance.x + column) * height + instance.y + row
    apart = starts[1:] != ends[:-1]     # a run may go on at the top of the next column
    starts = starts[np.concatenate([[True], apart])]
    ends = ends[np.concatenate([apart, [True]])]
    edges = np.concatenate([[0], np.column_stack([starts, ends]).ravel(), [height * width]])
    return [int(n) for n in np.diff(edges)]


def outline(instance: Instance) -> NDArray[np.int32]:
    """Return the (n, 2) pixels of an outline, x and y in the image: one closed polygon, n >= 3.

    Parts and holes are joined by paths that go forth and back, each where it is near to those
    before, so that a filled polygon, its outline included, covers the mask. A row of pixels goes
    forth and back, too.
    """
    contours, _ = cv2.findContours(instance.mask.astype(np.uint8), cv2.RETR_CCOMP,
                                   cv2.CHAIN_APPROX_SIMPLE)
    line, *parts = (contour[:, 0] for contour in contours)
    for part in parts:
        apart = cdist(line, part)
        i, j = divmod(int(apart.argmin()), len(part))
        line = np.concatenate([line[:i + 1], part[j:], part[:j + 1], line[i:]])
    if len(line) < 3:
        line = np.resize(line, (3, 2))
    return np.asarray(line + (instance.x, instance.y), np.int32)


def check_pinhole(suite: SensorSuite, what: str) -> None:
    """Raise SequenceError where images are distorted: labels are those of the pinhole image."""
    if any(suite.distortion):
        raise SequenceError(f'{what}: images with distortion {suite.distortion} do not fit the '
                            'labels, which are undistorted; valid is '
                            'render_node.camera.distortion: [0, 0, 0, 0, 0]')
