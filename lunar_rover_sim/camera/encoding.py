"""Encodings of images, as sensor_msgs names them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_ENCODINGS = {('uint8', 2): 'mono8', ('uint16', 2): 'mono16', ('uint8', 3): 'rgb8',
              ('float32', 2): '32FC1'}


def encoding_of(pixels: NDArray[Any]) -> str:
    """Return the encoding of (h, w) uint8, uint16, (h, w, 3) uint8 or (h, w) or (h, w, c) float32.
    """
    if pixels.dtype == np.float32 and pixels.ndim == 3:
        return f'32FC{pixels.shape[2]}'
    return _ENCODINGS[str(pixels.dtype), pixels.ndim]
