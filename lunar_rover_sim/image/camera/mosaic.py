"""The mosaic of colour filters of an image sensor: electrons behind it, and interpolation.

Apart from `encoding`, which is read by those that have no use for OpenCV and Numba.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.image.camera.encoding import is_bayer

TINT_ONE = 0.25     # of full scale: how a drawn tint stores a ratio of 1

_ZERO, _HALF, _ONE, _LEAST = (np.float32(x) for x in (0.0, 0.5, 1.0, 1e-9))
_PER_CODE = np.float32(1.0 / (TINT_ONE * 65535.0))
# Green at red and blue pixels; at green ones the colour of the neighbours in the row; red at blue
# ones, and blue at red ones.
_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0],
                   [0, 0, -1, 0, 0]], np.float32) / 8
_BESIDE = np.array([[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0],
                    [0, 0, 1, 0, 0]], np.float32) / 16
_DIAGONAL = np.array([[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0],
                      [0, 0, -3, 0, 0]], np.float32) / 16


def interpolated(mosaic: NDArray[Any]) -> NDArray[Any]:
    """Return the (h, w, 3) red, green, blue of an (h, w) mosaic, uint8 or uint16.

    Colours are interpolated linearly, and corrected by the curvature of the one that a pixel has
    (Malvar, He and Cutler, 2004, High-quality linear interpolation for demosaicing of
    Bayer-patterned color images, ICASSP), as drivers of cameras do it.
    """
    own, most = mosaic.astype(np.float32), np.iinfo(mosaic.dtype).max

    def seen(weights: NDArray[Any]) -> NDArray[Any]:
        # Sums of such numbers are exact. The border mirrors the image: colours keep their order.
        return np.clip(cv2.filter2D(own, -1, weights, delta=0.5,
                                    borderType=cv2.BORDER_REFLECT_101), 0, most).astype(
                                        mosaic.dtype)
    green, beside, over, diagonal = map(seen, (_GREEN, _BESIDE, _BESIDE.T.copy(), _DIAGONAL))
    red, blue = mosaic.copy(), mosaic.copy()
    red[::2, 1::2], red[1::2, ::2] = beside[::2, 1::2], over[1::2, ::2]
    blue[1::2, ::2], blue[::2, 1::2] = beside[1::2, ::2], over[::2, 1::2]
    red[1::2, 1::2], blue[::2, ::2] = diagonal[1::2, 1::2], diagonal[::2, ::2]
    green[::2, 1::2], green[1::2, ::2] = mosaic[::2, 1::2], mosaic[1::2, ::2]
    return np.asarray(cv2.merge([red, green, blue]))


def shown(pixels: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Return pixels of a sensor as a picture: a mosaic as red, green, blue, others as they are."""
    return interpolated(pixels) if is_bayer(encoding) else pixels


@compiled
def filtered(first, last, image, tint, own, whole,  # type: ignore[no-untyped-def]
             source, sensitivity, power, dark, result):
    """Fill in rows of the (h, w) electrons behind the filters of a mosaic.

    What a lens veils over the image is light of the sun: only the share of `own` has the tint.

    Args:
        image: (h, w) light, as electrons of a green pixel.
        tint: (H, W) as `sensor.Tint`; 0 is the sky, whose lights are white.
        own, whole: (H, W) radiance that comes from what is drawn, and all of it.
        source: (h, w, 2) column and row in `tint` of each pixel; (0, 0, 2): they are the same.
        sensitivity: (2,) electrons of red and blue pixels over those of green ones.
        power: (2,) of the ratios in `tint`, for responses that are not the default ones.
        dark: Dark signal of each pixel [e-].
    """
    w, moved = image.shape[1], len(source) > 0
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
        mine, out, coloured = image[r], result[r], odd[1 - k:]
        sensitive = sensitivity[k]
        for c in range(w):
            seen = mine[c] * ratio[c] * sensitive
            out[c] = (seen if coloured[c] > _HALF else mine[c]) + dark
