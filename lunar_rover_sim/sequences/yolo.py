"""YOLO data sets: images, labels and boxes in text files, data.yaml.

A line of `labels` is a class and the outline of an instance, x and y over width and height, as
trainers of segmentation read it; trainers of detection that share their files make boxes of it. A
line of `boxes` is a class and centre x, centre y, width and height, for those that do not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.files.paths import counted
from lunar_rover_sim.rendering.instances import CATEGORIES, Instance, LEAST_PX
from lunar_rover_sim.sequences.instances import outline
from lunar_rover_sim.sequences.labelled import LabelledSequence
from lunar_rover_sim.sequences.sequence import PngWriter

_DIGITS = 6


class YoloSequence(LabelledSequence):
    """Writes a YOLO data set."""

    layout = 'YOLO: images, labels (outlines of rocks and craters), boxes, data.yaml'
    left_images = ('images',)

    def __init__(self, bag: Bag, folder: Path, png: PngWriter) -> None:
        super().__init__(bag, folder, png)
        self._found = 0
        for name in ('images', 'labels', 'boxes'):
            (folder / name).mkdir()
        for text in ('path: .', 'train: images', 'val: images', 'names:',
                     *(f'  {k}: {name}' for k, name in enumerate(CATEGORIES))):
            self.line('data.yaml', text)

    def image(self, number: int, camera: str, stamp_ns: int, image: NDArray[Any],
              found: list[Instance]) -> None:
        """Write an image and a line for each instance."""
        height, width = image.shape[:2]
        name = f'{number:06d}'
        self.png.write(self.folder / 'images' / f'{name}.png', image)
        labels, boxes = [], []
        for instance in found:
            kind = CATEGORIES.index(instance.category)
            rows, columns = instance.mask.shape
            # Outlines go through the centres of pixels.
            corners = (outline(instance) + 0.5) / (width, height)
            labels.append(_line(kind, corners))
            boxes.append(_line(kind, [(instance.x + 0.5 * columns) / width,
                                      (instance.y + 0.5 * rows) / height,
                                      columns / width, rows / height]))
        for folder, lines in (('labels', labels), ('boxes', boxes)):
            (self.folder / folder / f'{name}.txt').write_text(''.join(lines), encoding='ascii')
        self.line('times.txt', f'{name} {stamp_ns} {camera}')
        self._found += len(labels)

    def notes(self) -> list[str]:
        """Return how many instances there are."""
        return [f'{counted(self._found, "instance")}; what shows fewer than {LEAST_PX} pixels '
                'is left out; train and val are the same images, split them by drive']


def _line(kind: int, values: Any) -> str:
    numbers = ' '.join(f'{value:.{_DIGITS}f}' for value in np.ravel(values))
    return f'{kind} {numbers}\n'
