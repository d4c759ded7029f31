"""The formats that a bag can be exported to, by the names that users give.

A new format is one file with a subclass of `Sequence`, and one line here.
"""

from __future__ import annotations

from collections.abc import Mapping

from lunar_rover_sim.sequences.coco import CocoSequence
from lunar_rover_sim.sequences.euroc import EurocSequence
from lunar_rover_sim.sequences.kitti import KittiSequence
from lunar_rover_sim.sequences.sequence import Sequence
from lunar_rover_sim.sequences.tartanair import TartanAirSequence
from lunar_rover_sim.sequences.tum import TumSequence
from lunar_rover_sim.sequences.webdataset import WebDatasetSequence
from lunar_rover_sim.sequences.yolo import YoloSequence

WEBDATASET = 'webdataset'

FORMATS: Mapping[str, type[Sequence]] = {
    'euroc': EurocSequence,
    'tum': TumSequence,
    'kitti': KittiSequence,
    'tartanair': TartanAirSequence,
    'coco': CocoSequence,
    'yolo': YoloSequence,
    WEBDATASET: WebDatasetSequence,
}
