"""Parameters of compressed images."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.parameters import param, Parameters


@dataclasses.dataclass(frozen=True)
class CompressionConfig(Parameters):
    """Parameters of one compressed image, with the names of compressed_image_transport."""

    format: str = param('jpeg', 'compression; png is lossless', choices=('jpeg', 'png'),
                        live=True)
    jpeg_quality: int = param(95, 'quality of jpeg, higher is better', unit='%', low=1, high=100,
                              live=True)
    png_level: int = param(3, 'effort of png; higher is smaller and slower', low=0, high=9,
                           live=True)
