"""Compressed images as compressed_image_transport makes them: same bytes, format and parameters.

Source: compressed_publisher.cpp of the repository image_transport_plugins. TIFF is left out.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.image.camera.config import CompressionConfig
from lunar_rover_sim.image.camera.encoding import encoding_of


def compressed(pixels: NDArray[Any], config: CompressionConfig) -> tuple[str, bytes]:
    """Return the `format` of a sensor_msgs/CompressedImage, and the file.

    JPEG has 8 bits: 16 bits are multiplied by 255 / 65535, as cv_bridge does.

    Args:
        pixels: (h, w) or (h, w, 3), in the order red, green, blue, uint8 or uint16.

    Raises:
        RenderError: If OpenCV cannot compress the image.
    """
    encoding, colour = encoding_of(pixels), pixels.ndim == 3
    if colour:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    if config.format == 'jpeg':
        target = 'bgr8' if colour else 'mono8'
        if pixels.dtype == np.uint16:
            pixels = cv2.convertScaleAbs(pixels, alpha=255.0 / 65535.0)
        ok, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, config.jpeg_quality])
    else:
        # image_transport names no target for grey images, and leaves the blank before it.
        target = f'bgr{8 * pixels.itemsize}' if colour else ''
        ok, data = cv2.imencode('.png', pixels, [cv2.IMWRITE_PNG_COMPRESSION, config.png_level])
    if not ok:
        raise RenderError(f'{config.format}: an image of shape {pixels.shape} and type '
                          f'{pixels.dtype} cannot be compressed')
    return f'{encoding}; {config.format} compressed {target}', data.tobytes()
