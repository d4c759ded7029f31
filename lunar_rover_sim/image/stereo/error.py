"""Disparity against truth: density, bad pixels, bias, end-point error; why pixels are missing.

Shares of bad pixels and end-point error are those of the Middlebury benchmark (Scharstein and
Szeliski, "A Taxonomy and Evaluation of Dense Two-Frame Stereo Correspondence Algorithms", Int. J.
Computer Vision 47, 2002).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.stereo.depth import DisparityMap

F32 = NDArray[np.float32]

# The signed errors are counted in bins, so that the median of many frames needs no list of all.
_BIN_PX = 1.0 / 64.0
_LARGEST_BINNED_PX = 4.0
_BINS = round(2.0 * _LARGEST_BINNED_PX / _BIN_PX)


@dataclasses.dataclass(frozen=True)
class StereoErrors:
    """Counts of pixels, and sums, of one or more frames; add them up with `+`.

    Attributes:
        ground: Pixels with finite true depth whose true match lies within the search range and the
            other image; only these are judged.
        matched: Of these, pixels with a disparity.
        bad1: Matched pixels that are wrong by more than 1 px.
        bad2: Matched pixels that are wrong by more than 2 px.
        error_sum_px: Sum of the absolute error of matched pixels [px].
        error_squared_px: Sum of the squared error of matched pixels [px^2].
        signed_sum_px: Sum of disparity minus true disparity of matched pixels [px].
        signed_counts: Matched pixels by that difference, in equal bins from -4 to 4 px; the
            outermost hold all that lie beyond. Empty while there are none.
        lit: Judged pixels that are not in shadow.
        lit_matched: Those of them that are matched.
        margin: Unmatched pixels outside the part that the matcher looks at. Of this and the
            following causes the first that applies counts.
        occluded: Unmatched pixels that the other camera does not see.
        shadowed: Unmatched pixels in shadow.
        saturated: Unmatched pixels at full scale.
        flat: Unmatched pixels in surroundings that hardly vary.
    """

    ground: int = 0
    matched: int = 0
    bad1: int = 0
    bad2: int = 0
    error_sum_px: float = 0.0
    error_squared_px: float = 0.0
    lit: int = 0
    lit_matched: int = 0
    margin: int = 0
    occluded: int = 0
    shadowed: int = 0
    saturated: int = 0
    flat: int = 0
    signed_sum_px: float = 0.0
    signed_counts: tuple[int, ...] = ()

    def __add__(self, other: StereoErrors) -> StereoErrors:
        def total(name: str) -> Any:
            a, b = getattr(self, name), getattr(other, name)
            if name != 'signed_counts':
                return a + b
            return tuple(map(sum, zip(a, b))) if a and b else a or b
        return StereoErrors(*(total(field.name) for field in dataclasses.fields(self)))

    @property
    def median_px(self) -> float:
        """Median of disparity minus true disparity, interpolated in a bin of 1/64 px [px]."""
        below = np.cumsum(self.signed_counts)
        if not len(below) or below[-1] == 0:
            return float('nan')
        k = int(np.searchsorted(below, 0.5 * below[-1]))
        share = (0.5 * below[-1] - (below[k] - self.signed_counts[k])) / self.signed_counts[k]
        return float((k + share) * _BIN_PX - _LARGEST_BINNED_PX)

    def summary(self) -> dict[str, float]:
        """Return shares, 0 to 1, and errors [px]; NaN where nothing was counted."""
        unmatched = self.ground - self.matched

        def share(part: float, whole: float) -> float:
            return part / whole if whole else float('nan')
        return {
            'density': share(self.matched, self.ground),
            'density on lit ground': share(self.lit_matched, self.lit),
            'bad-1': share(self.bad1, self.matched),
            'bad-2': share(self.bad2, self.matched),
            'median signed error [px]': self.median_px,
            'mean signed error [px]': share(self.signed_sum_px, self.matched),
            'end-point error [px]': share(self.error_sum_px, self.matched),
            'RMS error [px]': float(np.sqrt(share(self.error_squared_px, self.matched))),
            'invalid: margin of search': share(self.margin, unmatched),
            'invalid: occluded': share(self.occluded, unmatched),
            'invalid: in shadow': share(self.shadowed, unmatched),
            'invalid: saturated': share(self.saturated, unmatched),
            'invalid: low texture': share(self.flat, unmatched),
            'invalid: other': share(unmatched - self.margin - self.occluded - self.shadowed
                                    - self.saturated - self.flat, unmatched),
        }


def disparity_errors_px(disparity: DisparityMap, truth_px: F32,
                        where: NDArray[np.bool_]) -> F32:
    """Return (n,) disparity minus true disparity of the pixels `where` (h, w) is true [px].

    Args:
        truth_px: (h, w) as `disparity_from_depth` gives it. All measures of stereo error are made
            from this one.
    """
    return disparity.disparity_px[where] - truth_px[where]


def stereo_errors(disparity: DisparityMap, truth_px: F32, right_truth_px: F32 | None,
                  left: NDArray[Any], *, shadow_level: float = 0.08,
                  texture_level: float = 0.012, block_px: int = 7) -> StereoErrors:
    """Judge a disparity map.

    Args:
        truth_px: (h, w) true disparity of the left image, 0 for sky [px].
        right_truth_px: That of the right image, to find occluded pixels; None finds none.
        left: The left image, (h, w) or (h, w, 3), unsigned integers.
        shadow_level: Mean of a block, as a share of full scale, below which it is in shadow.
        texture_level: Standard deviation within a block, as a share of full scale, below which it
            is low in texture.
        block_px: Side of a block; one with more than a third of its pixels at full scale is
            saturated.
    """
    height, width = truth_px.shape
    image = left.astype(np.float32) / np.iinfo(left.dtype).max
    if image.ndim == 3:
        image = image.mean(axis=2)
    column = np.arange(width, dtype=np.float32)[None, :]
    ground = (truth_px > 0.0) & (truth_px <= disparity.max_disparity_px) \
        & (column - truth_px >= 0.0) & (truth_px >= max(disparity.min_disparity_px, 0.25))
    matched = ground & disparity.valid
    signed = disparity_errors_px(disparity, truth_px, matched).astype(float)
    error = np.abs(signed)
    place = np.floor((signed + _LARGEST_BINNED_PX) / _BIN_PX)
    counts = np.bincount(np.clip(place, 0, _BINS - 1).astype(int), minlength=_BINS)
    mean = cv2.blur(image, (block_px, block_px))
    deviation = np.sqrt(np.maximum(cv2.blur(image * image, (block_px, block_px)) - mean**2, 0.0))
    dark = mean < shadow_level
    missing = ground & ~disparity.valid
    x, y, w, h = disparity.valid_window
    margin = missing.copy()
    margin[y:y + h, x:x + w] = False
    rest = missing & ~margin
    occluded = np.zeros_like(missing)
    if right_truth_px is not None:
        rows, columns = np.nonzero(rest)
        there = np.clip(np.rint(columns - truth_px[rest]), 0, width - 1).astype(int)
        occluded[rows, columns] = right_truth_px[rows, there] > truth_px[rest] + 1.0
    rest &= ~occluded
    shadowed = rest & dark
    rest &= ~dark
    full = cv2.blur((image >= 1.0).astype(np.float32), (block_px, block_px)) > 1 / 3
    saturated = rest & full
    flat = rest & ~full & (deviation < texture_level)
    lit = ground & ~dark
    return StereoErrors(int(ground.sum()), int(matched.sum()), int((error > 1.0).sum()),
                        int((error > 2.0).sum()), float(error.sum()),
                        float((error**2).sum()), int(lit.sum()),
                        int((lit & matched).sum()), int(margin.sum()), int(occluded.sum()),
                        int(shadowed.sum()), int(saturated.sum()), int(flat.sum()),
                        float(signed.sum()), tuple(counts.tolist()))
