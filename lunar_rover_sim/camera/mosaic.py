"""The mosaic of colour filters of an image sensor: electrons behind it, and interpolation.

Apart from `encoding`, which is read by those that have no use for OpenCV and Numba.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.encoding import is_bayer
from lunar_rover_sim.compiled import compiled

TINT_ONE = 0.25     # of full scale: how a drawn tint stores a ratio of 1


def interpolated(mosaic: NDArray[Any]) -> NDArray[Any]:
    """Return the (h, w, 3) red, green, blue of an (h, w) mosaic, uint8 or uint16.

    It is OpenCV's interpolation by a variable number of gradients (VNG), which `image_proc` has,
    too; of 16 bits, for which there is none, the edge-aware one.
    """
    method = cv2.COLOR_BayerRGGB2RGB_VNG if mosaic.dtype == np.uint8 else \
        cv2.COLOR_BayerRGGB2RGB_EA
    return np.asarray(cv2.demosaicing(np.ascontiguousarray(mosaic), method))


def shown(pixels: NDArray[Any], encoding: str) -> NDArray[Any]:
    """Return pixels of a sensor as a picture: a mosaic as red, green, blue, others as they are."""
    return interpolated(pixels) if is_bayer(encoding) else pixels


@compiled
def filtered(first, last, red, green, blue, tint, own, source,  # type: ignore[no-untyped-def]
             sensitivity, power, dark, result):
    """Fill in rows of the (h, w) electrons behind the filters of a mosaic.

    What a lens veils over the image is light of the sun: only the share `own` has the tint.

    Args:
        red: (h, w) light of the red image, as electrons of a green pixel.
        green: That of the green one.
        blue: That of the blue one.
        tint: (H, W, 2) uint16 red and blue over green of what is drawn, as `TINT_ONE` stores them;
            0 is the sky, whose lights are white.
        own: (H, W) float32 share of the light that comes from what is drawn.
        source: (h, w, 2) column and row in `tint` of each pixel; (0, 0, 2): they are the same.
        sensitivity: (2,) electrons of red and blue pixels over those of green ones.
        power: (2,) of the ratios in `tint`, for responses that are not the default ones.
        dark: Dark signal of each pixel [e-].
    """
    w = green.shape[1]
    moved = len(source) > 0
    scale, one = np.float32(1.0 / (0.25 * 65535.0)), np.float32(1.0)
    for r in range(first, last):
        for c in range(w):
            kind = (r & 1) + (c & 1)
            if kind == 1:
                result[r, c] = green[r, c] + dark
                continue
            k = kind >> 1
            y, x = r, c
            if moved:
                x, y = int(source[r, c, 0] + 0.5), int(source[r, c, 1] + 0.5)
            code = tint[y, x, k]
            ratio = one
            if code > 0:
                ratio = np.float32(code) * scale
                if power[k] != one:
                    ratio = ratio**power[k]
                ratio = one + (ratio - one) * own[y, x]
            light = red[r, c] if k == 0 else blue[r, c]
            result[r, c] = light * ratio * sensitivity[k] + dark
