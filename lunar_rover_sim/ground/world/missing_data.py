"""Marks of missing data that nobody declared: no such heights stand on any ground."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

# Neighbouring pixels of any ground differ by less: 84 deg up to 30 m of distance and 45 deg
# beyond, or a step of 30 m in a fine model.
_MAX_SLOPE, _MAX_FAR_SLOPE, _NEAR_M, MAX_STEP_M = 10.0, 1.0, 30.0, 30.0
# What is written for missing data, beside the ends of a type of whole numbers.
_MARKS = (0.0, -9999.0, 9999.0, -99999.0, 99999.0, -32768.0, -32767.0, 32767.0, 65535.0)
# A mark stands off the ground by more than 45 deg, or than this many times what neighbours differ
# by elsewhere (their 99th percentile, of so many pairs at least), and more than these units of
# whole numbers. Level ground at 0 is often drawn: there, walls of less than this height are walls.
_TIMES, _LEAST_PAIRS, _UNITS, _WALL_M = 5.0, 100, 3.0, 5.0
ADVICE = ('declare it as missing (`gdal_edit.py -a_nodata`, or NaN in dem.npy), and '
          'world.dem.nodata=fill fills it')


def max_step_m(apart_m: float | NDArray) -> NDArray:
    """Return by how much neighbours at a distance may differ."""
    apart = np.asarray(apart_m, float)
    return np.maximum(_MAX_SLOPE * np.minimum(apart, _NEAR_M)
                      + _MAX_FAR_SLOPE * np.maximum(apart - _NEAR_M, 0.0), MAX_STEP_M)


@dataclasses.dataclass(frozen=True)
class Suspect:
    """Pixels that are no ground.

    Attributes:
        row: Of one of them, in the array.
        column: Of the same.
        text: What is wrong, and what to do.
    """

    row: int
    column: int
    text: str


def steepest(heights: NDArray, known: NDArray, apart_m: float) -> Suspect | None:
    """Return the neighbours that differ most, if they do as no ground does.

    Args:
        heights: (rows, columns) [m].
        known: Where there are data.
        apart_m: The larger distance of neighbours.
    """
    most_m = float(max_step_m(apart_m))
    for axis in (0, 1):
        step = np.abs(np.diff(heights, axis=axis))
        both = known[1:] & known[:-1] if axis == 0 else known[:, 1:] & known[:, :-1]
        step[~both] = 0.0
        if step.size and step.max() > most_m:
            j, i = map(int, np.unravel_index(int(np.argmax(step)), step.shape))
            other = j + (axis == 0), i + (axis == 1)
            high, low = sorted(((j, i), other), key=lambda at: abs(heights[at]), reverse=True)
            return Suspect(*high, f'{heights[high]:g} m beside {heights[low]:g} m; valid are '
                           f'steps of at most {most_m:g} m between pixels; if one of them marks '
                           f'missing data, {ADVICE}')
    return None


def marked(raw: NDArray, heights: NDArray, known: NDArray,
           apart_m: tuple[float, float]) -> Suspect | None:
    """Return pixels of a value that marks missing data and that stands off its neighbours.

    Args:
        raw: (rows, columns) as the file holds them.
        heights: The same in metres.
        known: Where there are data.
        apart_m: Distance between neighbouring rows and columns.
    """
    whole = np.issubdtype(raw.dtype, np.integer)
    ends = (np.iinfo(raw.dtype).min, np.iinfo(raw.dtype).max) if whole else ()
    steps = [np.abs(np.diff(heights, axis=axis)) for axis in (0, 1)]
    pairs = [known[1:] & known[:-1], known[:, 1:] & known[:, :-1]]
    for value in dict.fromkeys([*_MARKS, *map(float, ends)]):
        mask = (raw == value) & known
        if not mask.any():
            continue
        edges = [(mask[1:] != mask[:-1]) & pairs[0], (mask[:, 1:] != mask[:, :-1]) & pairs[1]]
        beside = np.concatenate([step[edge] for step, edge in zip(steps, edges)])
        if not beside.size:
            continue
        others = [step[pair & ~edge & ~(mask[1:] if axis == 0 else mask[:, 1:])]
                  for axis, (step, pair, edge) in enumerate(zip(steps, pairs, edges))]
        least = _units_m(raw, heights) if whole else 0.0
        slope = np.median(np.concatenate([step[edge] / apart for step, edge, apart
                                          in zip(steps, edges, apart_m)]))
        height, rest = float(np.median(beside)), np.concatenate(others)
        usual = float(np.percentile(rest, 99)) if rest.size >= _LEAST_PAIRS else np.inf
        if value == 0.0:
            off = height > _WALL_M and slope > 1.0
        else:
            off = slope > 1.0 or height > _TIMES * usual
        if off and height > least:
            row, column = map(int, np.argwhere(mask)[0])
            count = int(mask.sum())
            return Suspect(row, column, f'{count} pixel{"s" * (count > 1)} of the value {value:g} '
                           f'{"stand" if count > 1 else "stands"} {height:.3g} m off the ground '
                           f'beside them: a mark of missing data; {ADVICE}')
    return None


def _units_m(raw: NDArray, heights: NDArray) -> float:
    """Return the height of a few units of whole numbers."""
    low, high = np.unravel_index(raw.argmin(), raw.shape), np.unravel_index(raw.argmax(),
                                                                            raw.shape)
    span = float(raw[high]) - float(raw[low])
    return _UNITS * abs(float(heights[high] - heights[low])) / span if span else 0.0


def all_marked(raw: NDArray, known: NDArray) -> float | None:
    """Return the mark that all known pixels are, other than 0."""
    values = raw[known]
    first = values.flat[0]
    if (values != first).any() or not first:
        return None
    ends = (np.iinfo(raw.dtype).min, np.iinfo(raw.dtype).max) if raw.dtype.kind in 'iu' else ()
    return float(first) if float(first) in (*_MARKS, *map(float, ends)) else None
