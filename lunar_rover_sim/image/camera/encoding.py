"""Encodings of images, as sensor_msgs names them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

BAYER8, BAYER16 = 'bayer_rggb8', 'bayer_rggb16'
EIGHT_BITS = ('mono8', 'rgb8', BAYER8)
ENCODINGS = (*EIGHT_BITS, 'mono16', BAYER16)    # of image sensors
_OF_PIXELS = {('uint8', 2): 'mono8', ('uint16', 2): 'mono16', ('uint8', 3): 'rgb8',
              ('uint16', 3): 'rgb16', ('float32', 2): '32FC1'}


def is_bayer(encoding: str) -> bool:
    """Return whether pixels of an encoding have one colour each."""
    return encoding in (BAYER8, BAYER16)


def has_16_bits(encoding: str) -> bool:
    """Return whether pixels of an encoding of an image sensor have 16 bits."""
    return encoding.endswith('16')


def has_colour(encoding: str) -> bool:
    """Return whether a sensor of this encoding has colour filters."""
    return encoding == 'rgb8' or is_bayer(encoding)


def encoding_of(pixels: NDArray[Any]) -> str:
    """Return the encoding of (h, w) or (h, w, 3) uint8 or uint16, (h, w) or (h, w, c) float32."""
    if pixels.dtype == np.float32 and pixels.ndim == 3:
        return f'32FC{pixels.shape[2]}'
    return _OF_PIXELS[str(pixels.dtype), pixels.ndim]


def eight_bits(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Return pixels of 8 or 16 bits as 8 bits."""
    return np.asarray(pixels >> 8 if pixels.dtype == np.uint16 else pixels, np.uint8)
