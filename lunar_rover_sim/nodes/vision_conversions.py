"""Conversions to vision_msgs, a package that may not be installed: nothing here imports it.

`msg` is its module of messages, version 4 (github.com/ros-perception/vision_msgs).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import importlib
from types import ModuleType
from typing import Any

from std_msgs.msg import Header

from lunar_rover_sim.rendering.instances import CRATER, Instance
from lunar_rover_sim.rendering.labels import FIRST_CRATER, LABEL_FIRST_ROCK, METHOD

_FIRST = {CRATER: FIRST_CRATER}     # number of the first one; rocks otherwise


def vision_messages() -> ModuleType | None:
    """Return the module of messages; None where the package is not installed."""
    try:
        return importlib.import_module('vision_msgs.msg')
    except ImportError:
        return None


def detections(msg: ModuleType, instances: Iterable[Instance], header: Header) -> Any:
    """Return instances of an image as Detection2DArray, with the score 1.

    The class is `rock` or `crater`; the id adds the row in the catalogue of label_info. Boxes
    reach from the left edge of their first pixel, whose centre is at (0.5, 0.5) in the upper left
    corner, to the right edge of their last one.
    """
    result = msg.Detection2DArray()
    result.header = header
    for instance in instances:
        box, hypothesis = msg.Detection2D(), msg.ObjectHypothesisWithPose()
        rows, columns = instance.mask.shape
        box.header = header
        box.id = f'{instance.category} {row(instance)}'
        box.bbox.center.position.x = float(instance.x + 0.5 * columns)
        box.bbox.center.position.y = float(instance.y + 0.5 * rows)
        box.bbox.size_x, box.bbox.size_y = float(columns), float(rows)
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = instance.category, 1.0
        box.results = [hypothesis]
        result.detections.append(box)
    return result


def row(instance: Instance) -> int:
    """Return the row of an instance in its catalogue."""
    return instance.number - _FIRST.get(instance.category, LABEL_FIRST_ROCK)


def label_info(msg: ModuleType, names: Mapping[int, str], header: Header) -> Any:
    """Return the names of labels as LabelInfo."""
    result = msg.LabelInfo()
    result.header = header
    for label, name in names.items():
        entry = msg.VisionClass()
        entry.class_id, entry.class_name = label, name
        result.class_map.append(entry)
    return result


def vision_info(msg: ModuleType, world_hash: str, header: Header) -> Any:
    """Return how labels are made as VisionInfo; its version is a number, so the hash is a place.
    """
    result = msg.VisionInfo()
    result.header, result.method = header, METHOD
    result.database_location, result.database_version = world_hash, 0
    return result
