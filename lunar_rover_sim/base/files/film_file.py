"""Films in files: MP4 by OpenCV's encoder, animated GIF and WebP by Pillow.

The video in an MP4 is VP9, which browsers play. Its encoder, libvpx (BSD), is part of OpenCV's
wheels; those of H.264 are under the GPL, and not in there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lunar_rover_sim.base.errors import ConfigError, LunarRoverSimError
from lunar_rover_sim.base.files.atomic import partial_folder

U8 = NDArray[np.uint8]

SUFFIXES = ('.mp4', '.gif', '.webp')
_CODEC = 'vp09'
_COLOURS, _GIF_HZ = 64, 100.0     # of a GIF: it counts hundredths of a second


def check_suffix(path: Path) -> None:
    """Raise ConfigError unless a film can have this name."""
    if path.suffix not in SUFFIXES:
        raise ConfigError(f'--output: {path} has no suffix of a film; valid are '
                          f'{", ".join(SUFFIXES)}')


def check_rate(path: Path, rate_hz: float) -> None:
    """Raise ConfigError unless a film of this name can have so many frames per second."""
    # Of a shorter one viewers make a tenth of a second.
    ticks = max(round(_GIF_HZ / rate_hz), 2)
    if path.suffix == '.gif' and abs(_GIF_HZ / rate_hz - ticks) > 0.01:
        raise ConfigError(f'--fps: {rate_hz:g} is not valid for a .gif, whose frames last whole '
                          f'hundredths of a second, and two at least; near it is '
                          f'{_GIF_HZ / ticks:.4g}')


def write_film(path: Path, frames: Iterator[U8], rate_hz: float, quality: int = 70) -> int:
    """Write (h, w, 3) RGB frames of one size to a new file; return their number.

    Args:
        quality: Of a WebP, 1 to 100.

    Raises:
        ConfigError: For an unknown suffix, without any frame, and if the file exists or cannot be
            written.
        LunarRoverSimError: If this OpenCV has no encoder.
    """
    check_suffix(path)
    with partial_folder(path, ConfigError) as folder:
        film = folder / path.name
        if path.suffix == '.mp4':
            count = _encode(film, frames, rate_hz)
        else:
            count = _animate(film, frames, rate_hz, quality)
        if path.exists():
            raise ConfigError(f'{path}: exists already')
        film.rename(path)
    return count


def _encode(path: Path, frames: Iterator[U8], rate_hz: float) -> int:
    writer, count = None, 0
    try:
        for frame in frames:
            if writer is None:
                height, width = frame.shape[:2]
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*_CODEC), rate_hz,
                                         (width, height))
                if not writer.isOpened():
                    raise LunarRoverSimError(f'{path.suffix}: this OpenCV has no encoder for VP9; '
                                             'write a .webp or .gif')
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    if not count:
        raise ConfigError('film: 0 frames are not valid; valid is at least one')
    if not _is_whole(path):     # the encoder says nothing of a full disk
        raise OSError('the film is not whole; is the disk full?')
    return count


def _is_whole(path: Path) -> bool:
    """Return whether the boxes of an MP4 (ISO/IEC 14496-12) fill it, the table of frames too."""
    names, at, end = set(), 0, path.stat().st_size
    with path.open('rb') as file:
        while at < end:
            file.seek(at)
            head = file.read(16)
            size = int.from_bytes(head[8:16] if head[:4] == b'\0\0\0\1' else head[:4], 'big')
            if size < 8:
                return False
            names.add(head[4:8])
            at += size
    return at == end and b'moov' in names


def _animate(path: Path, frames: Iterator[U8], rate_hz: float, quality: int) -> int:
    count = 0

    def pictures() -> Iterator[Image.Image]:
        nonlocal count
        for frame in frames:
            count += 1
            picture = Image.fromarray(frame)
            yield picture.quantize(_COLOURS) if path.suffix == '.gif' else picture

    each = pictures()
    first = next(each, None)
    if first is None:
        raise ConfigError('film: 0 frames are not valid; valid is at least one')
    first.save(path, save_all=True, append_images=each, duration=round(1e3 / rate_hz), loop=0,
               quality=quality, method=4)
    return count
