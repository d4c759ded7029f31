"""Images of any camera on one scale of grey, so that their statistics can be compared."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.errors import EvaluationError

F32 = NDArray[np.float32]
T = TypeVar('T')


class GreyPair(NamedTuple):
    """A rectified pair, or a single image: (h, w) grey from 0 to 1, the root of the signal.

    right: None of a single camera
    truth_px: true disparity of the left image, 0 for the sky, NaN where unknown; None without
    """

    name: str
    left: F32
    right: F32 | None = None
    truth_px: F32 | None = None

    def narrowed(self, width: int) -> GreyPair:
        """Return the pair scaled down to a width [px]; a narrower one is returned as it is."""
        height_px, width_px = self.left.shape
        if width_px <= width:
            return self
        factor = width / width_px
        size = width, max(round(height_px * factor), 1)

        def scaled(image: F32 | None, method: int) -> F32 | None:
            return None if image is None else np.asarray(
                cv2.resize(image, size, interpolation=method), np.float32)

        left = scaled(self.left, cv2.INTER_AREA)
        assert left is not None
        # The mean over an edge of depth would be the disparity of nothing.
        truth = scaled(self.truth_px, cv2.INTER_NEAREST)
        return GreyPair(self.name, left, scaled(self.right, cv2.INTER_AREA),
                        None if truth is None else truth * np.float32(factor))


def check_sizes(pair: GreyPair, path: Path) -> None:
    """Raise EvaluationError if right image or truth are not as large as the left image."""
    for what, other in (('right image', pair.right), ('true depth', pair.truth_px)):
        if other is not None and other.shape != pair.left.shape:
            sizes = [' x '.join(map(str, image.shape[::-1])) for image in (other, pair.left)]
            raise EvaluationError(f'{path}: the {what} has {sizes[0]} px, the left image '
                                  f'{sizes[1]} px')


def levels_of(pixels: NDArray[Any], linear: bool, black: float = 0.0, full: float = 0.0) -> F32:
    """Return (h, w) or (h, w, 3) pixels as the root of the signal, 0 to 1.

    linear: whether the pixels are proportional to the signal; else they are its root already,
        which the curve of most 8-bit cameras comes near to
    black, full: levels of no light and of full scale; by default those of the type
    """
    grey = pixels[..., :3].mean(axis=-1) if pixels.ndim == 3 else pixels
    full = full or float(np.iinfo(pixels.dtype).max)
    levels = np.clip((grey.astype(np.float32) - black) / (full - black), 0.0, 1.0)
    return np.asarray(np.sqrt(levels) if linear else levels, np.float32)


def chosen(items: list[T], most: int) -> list[T]:
    """Return at most so many items, evenly over the list, its ends included."""
    places = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[k] for k in places]
