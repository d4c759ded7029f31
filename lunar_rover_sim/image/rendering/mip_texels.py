"""Texels with their mip levels, as compiled loops read them: one array, level after level."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray


class MipTexels(NamedTuple):
    """Square textures, each with the same number of texels and mip levels.

    Attributes:
        words: All texels; those of a level begin at `first`, one texture after the other.
        side: (levels,) texels along a side of a level.
        first: (levels,) where it begins.
    """

    words: NDArray[Any]
    side: NDArray[np.int32]
    first: NDArray[np.int32]


def mip_texels(textures: Sequence[NDArray[Any]], side: int) -> MipTexels:
    """Return textures with their mip levels, each the mean of the one before.

    Args:
        textures: (n, n, 4) float16 or uint8; a smaller one lies in the corner of zeros.
        side: Of all.
    """
    sides = [side]
    while sides[-1] > 1:
        sides.append(sides[-1] // 2)
    kind = textures[0].dtype
    word = np.dtype(f'u{4 * kind.itemsize}')
    count = len(textures)
    first = np.cumsum([0, *(count * n * n for n in sides)])
    words = np.zeros(first[-1], word)

    def fill(k: int) -> None:
        levels = [words[start + k * n * n:start + (k + 1) * n * n].view(kind).reshape(n, n, 4)
                  for start, n in zip(first, sides)]
        m = len(textures[k])
        levels[0][:m, :m] = textures[k]
        for finer, level in pairwise(levels):
            _halve(finer, level)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(fill, range(count)))
    return MipTexels(words, np.array(sides, np.int32), first[:-1].astype(np.int32))


def _halve(finer: NDArray[Any], level: NDArray[Any]) -> None:
    """Fill in the (n, n, 4) texels of a level, interpolated between those of the finer one."""
    n = len(level)
    mean = cv2.resize(finer.astype(np.float32), (n, n), interpolation=cv2.INTER_LINEAR).reshape(
        n, n, 4)
    level[:] = np.rint(mean, out=mean) if level.dtype == np.uint8 else mean


def packed_levels(codes: Sequence[NDArray[np.uint8]]) -> MipTexels:
    """Return a texture whose (n, n, 4) mip levels are given."""
    sides = np.array([len(level) for level in codes], np.int32)
    first = np.cumsum([0, *(len(level)**2 for level in codes)])[:-1].astype(np.int32)
    words = np.concatenate([np.ascontiguousarray(level).view(np.uint32).ravel()
                            for level in codes])
    return MipTexels(words, sides, first)
