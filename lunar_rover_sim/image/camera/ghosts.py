"""Ghosts of the sun: light that two surfaces of a lens reflect, and gather near the sensor.

A ghost is a defocused image of the aperture, on the line from the sun through the middle of the
image. Of a lens with known surfaces it follows by tracing rays (Hullin et al., 2011, ACM Trans.
Graph. 30, 108). The lens here is a wide-angle one of six parts (Nakamura; Smith, Modern Lens
Design, p. 360), scaled to the focal length of the camera and stopped down to f/4. Of its pairs of
surfaces these four gather their light so that it stands out of the veil; all others are counted
with the veil.

Ghosts are as white as the veil. Coatings colour them: by thin-film optics (Macleod, Thin-Film
Optical Filters) red and blue over green of a pair are 1.1 and 1.4 with a quarter wave of MgF2 on
an index of 1.52, 1.8 and 5.5 on 1.75, and 1.5 and 10 with three layers: quarter, half and quarter.
So the colour follows from layers, which a reflectance of 0.5 % does not tell.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.relief import smoothstep

_SUN_RADIUS_RAD = math.radians(0.5 * 0.533)        # nominal; what a date changes is not seen


@dataclasses.dataclass(frozen=True)
class Ghost:
    """The ghost of one pair of surfaces.

    Attributes:
        surfaces: Numbers of both in the lens, the stop counted, from 0 in front.
        place: From the middle of the image, over the place of the sun.
        radius: Of its disc, over the focal length.
        edge: Half the width that aberrations blur its edge to, over the focal length.
        share: Of the light of the pair that passes stop and rims, the sun near the axis.
        cut_deg: Angles of the sun from the axis between which the rims cut the ghost off [deg].
    """

    surfaces: tuple[int, int]
    place: float
    radius: float
    edge: float
    share: float
    cut_deg: tuple[float, float]

    def passing(self, direction: Array) -> float:
        """Return the share of the pair's light that arrives from a (3,) unit vector, camera axes.
        """
        angle = math.degrees(math.acos(min(1.0, max(-1.0, float(direction[2])))))
        low, high = self.cut_deg
        return self.share * float(smoothstep((high - angle) / (high - low)))

    def half_edge_px(self, focal_px: float) -> float:
        """Return half the width of the edge [px].

        The sun is a disc, whose image the place of the ghost scales, and pixels are squares: each
        adds its variance across an edge to that of the aberrations, e^2 / 5.
        """
        sun_px = abs(self.place) * _SUN_RADIUS_RAD * focal_px
        blurred = math.sqrt((self.edge * focal_px)**2 + 5.0 / 4.0 * sun_px**2 + 5.0 / 12.0)
        return min(blurred, self.radius * focal_px)

    def reach_px(self, focal_px: float) -> float:
        """Return how far from its middle the ghost ends [px]."""
        return self.radius * focal_px + self.half_edge_px(focal_px)

    def irradiance(self, distance_px: ArrayLike, focal_px: float) -> Array:
        """Return what of a light of one falls on a pixel at a distance from the middle [1/px2].

        Its sum over pixels is one: a disc of radius R, whose edge falls smoothly from R - e to
        R + e, has the area pi (R^2 + e^2 / 5).
        """
        radius, edge = self.radius * focal_px, self.half_edge_px(focal_px)
        falling = smoothstep((radius + edge - np.asarray(distance_px)) / (2.0 * edge))
        return falling / (math.pi * (radius**2 + edge**2 / 5.0))


# By test/traced_lens.py, with the sun 8 degrees from the axis.
GHOSTS = (Ghost((0, 12), -0.41, 0.012, 0.003, 0.175, (14.0, 30.0)),
          Ghost((1, 8), -2.5, 0.055, 0.012, 1.0, (4.0, 16.0)),
          Ghost((2, 7), -1.43, 0.06, 0.06, 1.0, (24.0, 36.0)),
          Ghost((11, 12), 1.72, 0.0625, 0.006, 1.0, (30.0, 45.0)))
PAIRS = sum(ghost.share for ghost in GHOSTS)       # so many pairs' light makes them together
