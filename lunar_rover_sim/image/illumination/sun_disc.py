"""The sun as a camera sees it: a disc that is darker towards its limb.

The law is I(mu) = I(1) mu^a, mu being the cosine of the angle at which light leaves the sun, with
a = -0.023 + 0.292 um / wavelength (Hestroffer & Magnan, 1998, Astron. Astrophys. 333, 338; the
numbers were compared with a program that cites the paper). A further factor of their law is 1
here, which is a choice. At 0.6 um, about the middle of what a silicon sensor makes of sunlight, a
is 0.464 and the mean of the disc is 2 / (2 + a) = 0.812 of its centre; Neckel & Labs (1994, Solar
Physics 153, 91) measured 0.81 at 590 to 600 nm.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.illumination.config import SunConfig

LIMB_EXPONENT = 0.464
MEAN_OVER_CENTRE = 2.0 / (2.0 + LIMB_EXPONENT)


def central_radiance(sun: SunConfig) -> float:
    """Return the radiance of the middle of the disc [W m-2 sr-1].

    The disc as a whole has the normal irradiance of the sun.
    """
    radius = math.radians(0.5 * sun.angular_diameter_deg)
    return sun.irradiance / (math.pi * math.sin(radius)**2 * MEAN_OVER_CENTRE)


def limb_darkening(distance: ArrayLike) -> Array:
    """Return radiance over that of the middle; 0 beyond the limb.

    Args:
        distance: From the middle of the disc, over its radius.
    """
    square = np.asarray(distance, dtype=float)**2
    return np.where(square < 1.0, np.maximum(1.0 - square, 0.0)**(0.5 * LIMB_EXPONENT), 0.0)


def disc_radiance(rays: ArrayLike, direction: ArrayLike, sun: SunConfig) -> Array:
    """Return the radiance (...,) that comes along (..., 3) rays of any length [W m-2 sr-1].

    Args:
        direction: (3,) unit vector to the sun in the same axes.
    """
    rays = np.asarray(rays, dtype=float)
    across = np.cross(rays, np.asarray(direction, dtype=float))
    sine = np.linalg.norm(across, axis=-1) / np.linalg.norm(rays, axis=-1)
    radius = math.sin(math.radians(0.5 * sun.angular_diameter_deg))
    ahead = rays @ np.asarray(direction, dtype=float) > 0.0
    return np.where(ahead, central_radiance(sun) * limb_darkening(sine / radius), 0.0)
