"""Pictures in files.

OpenCV writes them, several times as fast as Pillow. Pillow reads them: libpng in OpenCV prints its
own errors on the terminal.
"""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import Any
import warnings

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lunar_rover_sim.base.errors import LunarRoverSimError, one_line
from lunar_rover_sim.base.files.paths import check_regular

_PNG, _PNG_DEPTH = b'\x89PNG\r\n\x1a\n', slice(24, 25)   # how a file begins; bits of its samples
_GREY = ('1', 'L', 'LA', 'F')       # of Pillow's modes


def read_picture(path: Path, error: type[LunarRoverSimError],
                 colour: bool = False) -> NDArray[np.uint8]:
    """Return the (h, w) grey or (h, w, 3) RGB pixels of a picture; 16 bits become 8.

    Raises `error` if the file is missing, damaged or no picture.
    """
    pixels = _read(path, error, 'RGB' if colour else 'L')
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
        return np.repeat(pixels[..., None], 3, axis=2) if colour else pixels
    return pixels


def read_pixels(path: Path, error: type[LunarRoverSimError]) -> NDArray[Any]:
    """Return the (h, w) grey or (h, w, 3) RGB pixels of a picture, uint8 or uint16 as they are.

    Raises `error` if the file is missing, damaged or no picture.
    """
    pixels = _read(path, error)
    with path.open('rb') as file:
        start = file.read(_PNG_DEPTH.stop)
    if pixels.ndim == 3 and start.startswith(_PNG) and start[_PNG_DEPTH] == b'\x10':
        # Pillow keeps the upper 8 of 16 bits in colour; it has found the file undamaged.
        deep = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if deep is None:
            raise error(f'{path}: cannot be read as a picture')
        return np.ascontiguousarray(deep[..., 2::-1])
    return pixels


def _read(path: Path, error: type[LunarRoverSimError], mode: str = '') -> NDArray[Any]:
    """Return the pixels in a mode of Pillow with 8 bits, '': L or RGB as they are.

    16-bit levels are (h, w) uint16 in any mode.
    """
    check_regular(path, error)
    try:
        with warnings.catch_warnings():
            # Pillow prints one for a damaged EXIF, which says nothing of the pixels.
            warnings.simplefilter('ignore')
            with Image.open(path) as picture:
                if picture.mode.startswith('I'):
                    return np.asarray(picture).astype(np.uint16)
                own = 'L' if picture.mode in _GREY else 'RGB'
                return np.asarray(picture.convert(mode or own), dtype=np.uint8)
    except Exception as reason:  # Pillow's readers raise errors of many classes on a damaged file
        words = one_line(reason)
        raise error(f'{path}: cannot be read as a picture: {words}') from None


def write_png(path: Path, pixels: NDArray[Any], compression: int = 3) -> None:
    """Write (h, w) or RGB (h, w, 3) pixels, 8 or 16 bits; compression: 0 to 9.

    Raises:
        OSError: If the file cannot be written.
    """
    data = png_bytes(pixels, compression)
    try:
        path.write_bytes(data)
    except OSError:
        path.unlink(missing_ok=True)    # half a picture is none
        raise


def notebook_html(text: str, pixels: NDArray[Any] | None = None) -> str:
    """Return a text, below a picture as `png_bytes` takes it, as HTML for a notebook."""
    picture = '' if pixels is None else (
        '<img style="max-width: 320px" src="data:image/png;base64,'
        f'{base64.b64encode(png_bytes(pixels)).decode()}"/>')
    return f'<div>{picture}<pre>{html.escape(text)}</pre></div>'


def png_bytes(pixels: NDArray[Any], compression: int = 3) -> bytes:
    """Return (h, w) or RGB (h, w, 3) pixels, 8 or 16 bits, as a PNG file; compression: 0 to 9.

    Raises:
        OSError: If they cannot be encoded.
    """
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[..., 2::-1])
    ok, data = cv2.imencode('.png', pixels, [cv2.IMWRITE_PNG_COMPRESSION, compression])
    if not ok:
        raise OSError('a picture cannot be encoded')
    return bytes(data.tobytes())
