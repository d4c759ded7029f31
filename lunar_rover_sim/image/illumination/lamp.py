"""The beam of the rover's lamp: intensity over the angle to its axis."""

from __future__ import annotations

import math

from lunar_rover_sim.image.illumination.config import LampConfig


def beam_exponent(config: LampConfig) -> float:
    """Return the exponent m of the beam, whose intensity falls as cos^m of the angle to its axis.

    The intensity is halved at half of the cone angle.
    """
    return math.log(0.5) / math.log(math.cos(0.5 * math.radians(config.cone_deg)))


def peak_intensity(config: LampConfig) -> float:
    """Return the radiant intensity on the axis [W/sr]; the whole beam has the configured flux."""
    return config.power_w * (beam_exponent(config) + 1.0) / (2.0 * math.pi)
