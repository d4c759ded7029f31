"""Pictures in files. Pillow reads them: libpng in OpenCV prints its own errors on the terminal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lunar_rover_sim.errors import LunarRoverSimError
from lunar_rover_sim.files.regular_file import check_regular


def read_picture(path: Path, error: type[LunarRoverSimError],
                 colour: bool = False) -> NDArray[np.uint8]:
    """Return the (h, w) grey or (h, w, 3) RGB pixels of a picture; 16 bits become 8.

    Raises `error` if the file is missing, damaged or no picture.
    """
    check_regular(path, error)
    try:
        with Image.open(path) as picture:
            if picture.mode.startswith('I'):
                grey = (np.asarray(picture) >> 8).astype(np.uint8)
                return np.repeat(grey[..., None], 3, axis=2) if colour else grey
            return np.asarray(picture.convert('RGB' if colour else 'L'), dtype=np.uint8)
    except Exception as reason:  # Pillow's readers raise errors of many classes on a damaged file
        words = ' '.join(str(reason).split()) or type(reason).__name__
        raise error(f'{path}: cannot be read as a picture: {words}') from None
