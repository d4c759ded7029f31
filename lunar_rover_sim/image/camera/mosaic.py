"""The mosaic of colour filters of an image sensor: electrons behind it, and interpolation.

Apart from `encoding`, which is read by those that have no use for OpenCV and Numba.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, vectorised
from lunar_rover_sim.image.camera.encoding import is_bayer

TINT_ONE = 0.25     # of full scale: how a drawn tint stores a ratio of 1

_ZERO, _HALF, _ONE, _TWO, _FOUR, _FIVE, _SIX = (np.float32(x) for x in (0, 0.5, 1, 2, 4, 5, 6))
_EIGHTH, _THREE_HALVES, _LEAST = np.float32(0.125), np.float32(1.5), np.float32(1e-9)
_PER_CODE = np.float32(1.0 / (TINT_ONE * 65535.0))


def interpolated(mosaic: NDArray[Any]) -> NDArray[Any]:
    """Return the (h, w, 3) red, green, blue of an (h, w) mosaic, uint8 or uint16.

    Colours are interpolated linearly, and corrected by the curvature of the one that a pixel has
    (Malvar, He and Cutler, 2004, High-quality linear interpolation for demosaicing of
    Bayer-patterned color images, ICASSP), as drivers of cameras do it.
    """
    planes = np.empty((3, *mosaic.shape), mosaic.dtype)
    # The border mirrors the image: colours keep their order.
    _demosaiced(cv2.copyMakeBorder(mosaic, 2, 2, 2, 2, cv2.BORDER_REFLECT_101),
                np.float32(np.iinfo(mosaic.dtype).max), planes)
    return np.asarray(cv2.merge(list(planes)))


def shown(pixels: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Return pixels of a sensor as a picture: a mosaic as red, green, blue, others as they are."""
    return interpolated(pixels) if is_bayer(encoding) else pixels


@vectorised
def _demosaiced(mosaic, most, planes):  # type: ignore[no-untyped-def]
    """Fill in the (3, h, w) colours of an (h + 4, w + 4) mosaic; most: largest number.

    Sums of such numbers are exact.
    """
    h, w = planes.shape[1:]
    # A row; sums of the pixels above and below it, and of those two rows away; odd columns.
    rows = np.empty((4, w + 4), np.float32)
    row, beside, beyond, odd = rows[0], rows[1], rows[2], rows[3]
    own, west, east = row[2:w + 2], row[1:w + 1], row[3:w + 3]
    far_west, far_east = row[:w], row[4:]
    above, left, right, far = beside[2:w + 2], beside[1:w + 1], beside[3:w + 3], beyond[2:w + 2]
    for c in range(w + 4):
        odd[c] = np.float32(c & 1)
    for r in range(h):
        nn, n, middle, s, ss = (mosaic[r], mosaic[r + 1], mosaic[r + 2], mosaic[r + 3],
                                mosaic[r + 4])
        for c in range(w + 4):
            row[c] = middle[c]
        for c in range(w + 4):
            beside[c] = np.float32(n[c]) + np.float32(s[c])
        for c in range(w + 4):
            beyond[c] = np.float32(nn[c]) + np.float32(ss[c])
        # Red and green pixels lie in even rows, green and blue ones in odd rows.
        k = r & 1
        coloured = odd[1 - k:]
        same, green, other = planes[2 * k, r], planes[1, r], planes[2 - 2 * k, r]
        for c in range(w):
            value = _EIGHTH * (_FOUR * own[c] + _TWO * (above[c] + (west[c] + east[c]))
                               - ((far_west[c] + far_east[c]) + far[c]))
            value = value if coloured[c] > _HALF else own[c]
            green[c] = np.int32(min(max(value + _HALF, _ZERO), most))
        for c in range(w):
            value = _EIGHTH * (_FIVE * own[c] + _FOUR * (west[c] + east[c]) - (left[c] + right[c])
                               - (far_west[c] + far_east[c]) + _HALF * far[c])
            value = own[c] if coloured[c] > _HALF else value
            same[c] = np.int32(min(max(value + _HALF, _ZERO), most))
        for c in range(w):
            diagonal, along = left[c] + right[c], far_west[c] + far_east[c]
            value = _EIGHTH * (_FIVE * own[c] + _FOUR * above[c] - diagonal - far[c]
                               + _HALF * along)
            opposite = _EIGHTH * (_SIX * own[c] + _TWO * diagonal
                                  - _THREE_HALVES * (far[c] + along))
            value = opposite if coloured[c] > _HALF else value
            other[c] = np.int32(min(max(value + _HALF, _ZERO), most))


@compiled
def filtered(first, last, red, green, blue, tint, own, whole,  # type: ignore[no-untyped-def]
             source, sensitivity, power, dark, result):
    """Fill in rows of the (h, w) electrons behind the filters of a mosaic.

    What a lens veils over the image is light of the sun: only the share of `own` has the tint.

    Args:
        red: (h, w) light of the red image, as electrons of a green pixel.
        green: That of the green one.
        blue: That of the blue one.
        tint: (H, W) as `sensor.Tint`; 0 is the sky, whose lights are white.
        own, whole: (H, W) radiance that comes from what is drawn, and all of it.
        source: (h, w, 2) column and row in `tint` of each pixel; (0, 0, 2): they are the same.
        sensitivity: (2,) electrons of red and blue pixels over those of green ones.
        power: (2,) of the ratios in `tint`, for responses that are not the default ones.
        dark: Dark signal of each pixel [e-].
    """
    w, moved = green.shape[1], len(source) > 0
    codes, rows = np.empty(w, np.uint32), np.empty((5, w + 1), np.float32)
    owns, wholes, ratio, share, odd = rows[0, :w], rows[1, :w], rows[2, :w], rows[3, :w], rows[4]
    for c in range(w + 1):
        odd[c] = np.float32(c & 1)
    for r in range(first, last):
        if moved:
            for c in range(w):
                x, y = int(source[r, c, 0] + 0.5), int(source[r, c, 1] + 0.5)
                codes[c], owns[c], wholes[c] = tint[y, x], own[y, x], whole[y, x]
            code, light, total = codes, owns, wholes
        else:
            code, light, total = tint[r], own[r], whole[r]
        k = r & 1
        shift = np.uint32(16 * k)
        for c in range(w):
            ratio[c] = np.float32(np.int32((code[c] >> shift) & np.uint32(0xffff))) * _PER_CODE
        if power[k] != _ONE:
            for c in range(w):
                ratio[c] = ratio[c]**power[k]
        for c in range(w):
            share[c] = light[c] / max(total[c], _LEAST)
        for c in range(w):
            ratio[c] = _ONE + (ratio[c] - _ONE) * share[c] if ratio[c] > _ZERO else _ONE
        mine, others, out, coloured = blue[r] if k else red[r], green[r], result[r], odd[1 - k:]
        sensitive = sensitivity[k]
        for c in range(w):
            seen = mine[c] * ratio[c] * sensitive
            out[c] = (seen if coloured[c] > _HALF else others[c]) + dark
