"""Compressed images: what image_transport writes, bit by bit where that can be said."""

import cv2
import numpy as np

from lunar_rover_sim.image.camera.compression import compressed
from lunar_rover_sim.image.camera.config import CompressionConfig

RNG = np.random.default_rng(3)
GREY = np.clip(cv2.GaussianBlur(RNG.normal(110.0, 60.0, (60, 80)), (5, 5), 1.5), 0,
               255).astype(np.uint8)


def decoded(data: bytes) -> np.ndarray:
    """Return the pixels of a file as it is."""
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def test_png_is_lossless() -> None:
    """Grey, 16 bits and colour come back as they were."""
    png = CompressionConfig(format='png')
    wide = (GREY.astype(np.uint16) * 200 + 7).astype(np.uint16)
    colour = np.stack([GREY, GREY // 2, 255 - GREY], axis=-1)
    for pixels, description in ((GREY, 'mono8; png compressed '),
                                (wide, 'mono16; png compressed '),
                                (colour, 'rgb8; png compressed bgr8'),
                                (colour * np.uint16(257), 'rgb16; png compressed bgr16')):
        told, data = compressed(pixels, png)
        assert told == description
        found = decoded(data)
        assert np.array_equal(found if found.ndim == 2 else found[..., ::-1], pixels)
        assert found.dtype == pixels.dtype


def test_jpeg_follows_its_quality() -> None:
    """Quality changes size and error; the default is near the image."""
    told, data = compressed(GREY, CompressionConfig())
    assert told == 'mono8; jpeg compressed mono8'
    assert data[:2] == b'\xff\xd8'
    error = np.abs(decoded(data).astype(int) - GREY).mean()
    _, poor = compressed(GREY, CompressionConfig(jpeg_quality=20))
    assert len(poor) < 0.6 * len(data)
    assert error < 2.0 < np.abs(decoded(poor).astype(int) - GREY).mean()


def test_jpeg_has_eight_bits() -> None:
    """Of 16 bits the upper ones stay; red stays red."""
    told, data = compressed(np.full((16, 16), 65535 // 2, np.uint16), CompressionConfig())
    assert told == 'mono16; jpeg compressed mono8'
    assert np.abs(decoded(data).astype(int) - 127).max() <= 1
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 200
    for pixels, encoding in ((red, 'rgb8'), (red * np.uint16(257), 'rgb16')):
        told, data = compressed(pixels, CompressionConfig())
        assert told == f'{encoding}; jpeg compressed bgr8'
        blue, _, strong = decoded(data).reshape(-1, 3).mean(axis=0)
        assert strong > 190 and blue < 10
