"""Meaning of the numbers in the label image, and a vocabulary of them for readers.

Labels are 16 bits, so that an image of them is `mono16`. Rocks have one each: 16 + their index in
the catalogue of the world, and after those the far rocks (`world.far_rocks`). Craters have an
image of their own, since a rock may lie in one: 1 + their index in the catalogue, 0 outside all.
Whatever is beyond 65535 shares that number. In the next window of a site rocks and craters keep
their numbers, and new ones take those that are free, see `Numbers`.

`instances` finds boxes and masks of rocks and craters in one image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import dataclasses
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.rocks import Rocks

LABEL_SKY, LABEL_GROUND, LABEL_ROVER, LABEL_DISTURBED, LABEL_FIRST_LEG = range(5)
LABEL_FIRST_ROCK = 16
LAST_LABEL = 65535
FIRST_CRATER = 1

METHOD = 'drawn by the renderer'
_DIGITS = 4         # of metres in the vocabulary


class Numbers:
    """Gives rocks, or craters, numbers of 16 bits that stay theirs over the windows of a site.

    When none is free, new ones take the numbers of those that are out of the window for longest.
    """

    def __init__(self, first: int) -> None:
        self._first = first
        # Those not in the present window come first, the one that left first before all.
        self._keys, self._numbers = np.zeros(0, np.uint64), np.zeros(0, np.int64)

    def of(self, keys: NDArray[np.uint64]) -> NDArray[np.uint16]:
        """Return the (m,) numbers of what has these keys and is in the window from now on."""
        present = _distinct(keys)
        stays = np.isin(self._keys, present)
        known, left = (self._keys[which] for which in (stays, ~stays))
        left_numbers = self._numbers[~stays]
        new = present[~np.isin(present, known)]
        free = np.setdiff1d(np.arange(self._first, LAST_LABEL + 1), self._numbers)
        taken = max(min(len(new) - len(free), len(left)), 0)
        numbers = np.concatenate([free, left_numbers[:taken]])[:len(new)]
        self._numbers = np.concatenate([left_numbers[taken:], self._numbers[stays], numbers])
        self._keys = np.concatenate([left[taken:], known, new[:len(numbers)]])
        result = np.full(len(keys), LAST_LABEL, np.uint16)
        order = np.argsort(present)
        found = np.isin(self._keys, present)
        result[order[np.searchsorted(present, self._keys[found], sorter=order)]] = (
            self._numbers[found])
        return result


def _distinct(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return keys that differ, also where two of (m,) are the same by chance."""
    order = np.argsort(keys, kind='stable')
    ordered = keys[order]
    starts = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1])[:len(keys)])
    again = np.arange(len(keys)) - np.repeat(starts, np.diff(np.append(starts, len(keys))))
    result = keys.astype(np.uint64)
    result[order] += again.astype(np.uint64) << np.uint64(52)
    return result


def rover_links(label: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    """Return where any part of the rover is seen."""
    legs = (label >= LABEL_FIRST_LEG) & (label < LABEL_FIRST_ROCK)
    return np.asarray(legs | (label == LABEL_ROVER))


def link_label(link: int) -> int:
    """Return the label of a link of the rover: 0 is base_link with mast and head, then legs."""
    return LABEL_ROVER if link == 0 else LABEL_FIRST_LEG + link - 1


def class_names(rock_count: int, legs: Sequence[str],
                labels: NDArray[np.uint16] | None = None) -> dict[int, str]:
    """Return the name of each label.

    Args:
        rock_count: Near and far rocks.
        legs: Their names.
        labels: (m,) of the rocks; None: in the order of the catalogue.
    """
    names = {LABEL_SKY: 'sky', LABEL_GROUND: 'ground', LABEL_ROVER: 'rover body',
             LABEL_DISTURBED: 'disturbed ground'}
    names.update({LABEL_FIRST_LEG + k: f'rover {leg} leg'.replace('_', ' ')
                  for k, leg in enumerate(legs)})
    last = min(LABEL_FIRST_ROCK + rock_count, LAST_LABEL)
    known = range(LABEL_FIRST_ROCK, last) if labels is None else np.unique(labels).tolist()
    names.update({label: f'rock {label - LABEL_FIRST_ROCK}' for label in known})
    if LABEL_FIRST_ROCK + rock_count > LAST_LABEL:
        names[LAST_LABEL] = f'rock {LAST_LABEL - LABEL_FIRST_ROCK} or any later one'
    return names


def vocabulary(rocks: Rocks, craters: Craters, world_hash: str, legs: Sequence[str],
               labels: NDArray[np.uint16] | None = None,
               numbers: NDArray[np.uint16] | None = None) -> str:
    """Return what the numbers mean, as JSON with the fields of two messages of vision_msgs.

    `class_map` is that of LabelInfo, `method`, `database_location` and `database_version` those
    of VisionInfo. Besides, `rocks` and `craters` are catalogues as columns; the row of number n
    is n - `first_id`. Where numbers are not in that order, in later windows of a site, they are
    the column `id`.

    Args:
        rocks: Near and far ones.
        world_hash: Of the world they are in.
        legs: Names of those of the rover.
        labels: (m,) of the rocks; None: in their order.
        numbers: (m,) of the craters in their image; None: in their order.
    """
    def column_of(own: NDArray[np.uint16] | None, first: int) -> dict[str, Any]:
        if own is None or np.array_equal(own, np.minimum(np.arange(len(own)) + first, LAST_LABEL)):
            return {}
        return {'id': own.tolist()}

    def column(values: Any) -> list[Any]:
        return np.round(np.asarray(values, float), _DIGITS).tolist()

    names = class_names(len(rocks), legs, labels)
    return json.dumps({
        'class_map': [{'class_id': label, 'class_name': name} for label, name in names.items()],
        'threshold': 0.0,
        'method': METHOD,
        'database_location': '',
        'database_version': world_hash,
        'rocks': {'first_id': LABEL_FIRST_ROCK, **column_of(labels, LABEL_FIRST_ROCK),
                  'position_m': column(rocks.position_m),
                  'diameter_m': column(rocks.diameter_m)},
        'craters': {'first_id': FIRST_CRATER, **column_of(numbers, FIRST_CRATER),
                    'position_m': column(craters.position_m),
                    'diameter_m': column(craters.diameter_m), 'age': column(craters.age)},
    }, separators=(',', ':'))


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
