"""Rocks and craters of one image as instances: boxes and masks."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK

ROCK, CRATER = 'rock', 'crater'
CATEGORIES = (ROCK, CRATER)
LEAST_PX = 10       # instances that show fewer pixels are left out

Mask = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Instance:
    """What an image shows of a rock or a crater.

    Attributes:
        number: In the image of labels or of craters.
        x, y: Column and row of the upper left pixel of its box.
        mask: (h, w) within the box.
    """

    category: str
    number: int
    x: int
    y: int
    mask: Mask

    @property
    def area(self) -> int:
        """Pixels that it covers."""
        return int(self.mask.sum())


def instances(label: NDArray[Any], crater: NDArray[Any] | None = None) -> list[Instance]:
    """Return the instances of (h, w) labels, and of (h, w) numbers of craters where given."""
    label = label.astype(np.int32)
    found = list(_found(ROCK, np.where(label >= LABEL_FIRST_ROCK, label, 0)))
    if crater is not None:
        found += _found(CRATER, crater.astype(np.int32))
    return found


def _found(category: str, numbers: NDArray[np.int32]) -> Iterator[Instance]:
    # Here, because SciPy takes time to import, and few programs look for instances.
    from scipy.ndimage import find_objects
    for index, place in enumerate(find_objects(numbers)):
        if place is not None:
            mask = numbers[place] == index + 1
            if mask.sum() >= LEAST_PX:
                rows, columns = place
                yield Instance(category, index + 1, columns.start, rows.start, mask)
