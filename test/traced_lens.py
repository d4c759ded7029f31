"""Rays through the lens that the ghosts of the sun were taken from.

Lengths are in mm, z is along the axis, and the first surface is at 0. A surface has its centre of
curvature behind it where its radius is positive.
"""

import dataclasses
import math

import numpy as np

STOP = 5
F_NUMBER = 4.0
# Radius (0: the stop), way to the next surface, refractive index behind it, diameter: a
# wide-angle lens of 38 degrees half field (Nakamura; Smith, Modern Lens Design, p. 360).
PRESCRIPTION = (
    (35.98738, 1.21638, 1.540, 23.716), (11.69718, 9.99570, 1.0, 17.996),
    (13.08714, 5.12622, 1.772, 12.364), (-22.63294, 1.76924, 1.617, 9.812),
    (71.05802, 0.81840, 1.0, 9.152), (0.0, 2.27766, 1.0, 8.756),
    (-9.58584, 2.43254, 1.617, 8.184), (-11.28864, 0.11506, 1.0, 9.152),
    (-166.7765, 3.09606, 1.713, 10.648), (-7.5911, 1.32682, 1.805, 11.44),
    (-16.7662, 3.98068, 1.0, 12.276), (-7.70286, 1.21638, 1.617, 13.42),
    (-11.97328, 0.0, 1.0, 17.996))


@dataclasses.dataclass(frozen=True)
class Surface:
    """A spherical surface; `before` and `behind` are refractive indices."""

    radius: float
    z: float
    before: float
    behind: float
    half: float


class TracedLens:
    """The lens, focused at infinity and stopped down.

    Attributes:
        focal_mm: Focal length.
        sensor_mm: Where the sensor is along the axis.
    """

    def __init__(self):
        y, slope, index, z = 1.0, 0.0, 1.0, 0.0
        surfaces, heights = [], []
        for radius, way, behind, diameter in PRESCRIPTION:     # a ray beside the axis
            heights.append(y)
            if radius:
                slope = (index * slope - (behind - index) / radius * y) / behind
            surfaces.append(Surface(radius, z, index, behind, diameter / 2.0))
            index, z, last = behind, z + way, y
            y += slope * way
        self.focal_mm, self.sensor_mm = -1.0 / slope, z - last / slope
        self.pupil_mm = self.focal_mm / (2.0 * F_NUMBER)
        surfaces[STOP] = dataclasses.replace(surfaces[STOP],
                                             half=heights[STOP] * self.pupil_mm)
        self.surfaces = surfaces

    def rays(self, angle_deg, number, seed=0):
        """Return (n, 3) starts and directions of a parallel beam that covers the front lens."""
        angle = math.radians(angle_deg)
        half = self.surfaces[0].half
        starts = np.zeros((number, 3))
        starts[:, :2] = np.random.default_rng(seed).uniform(-half, half, (number, 2))
        along = np.array([math.sin(angle), 0.0, math.cos(angle)])
        return starts - 30.0 * along / along[2], np.tile(along, (number, 1))

    def on_sensor(self, starts, along, pair=None):
        """Return the (n, 2) places on the sensor of all rays that arrive, over the focal length.

        Args:
            starts: (n, 3) where rays begin.
            along: (n, 3) unit vectors.
            pair: Numbers of the surfaces that reflect, the one in front first; None: no one.
        """
        last = len(self.surfaces)
        legs = ([(range(last), None)] if pair is None else
                [(range(pair[1]), pair[1]), (range(pair[1] - 1, pair[0], -1), pair[0]),
                 (range(pair[0] + 1, last), None)])
        rays = starts, along
        for between, mirror in legs:
            for number in between:
                rays = _through(*rays, self.surfaces[number])
            if mirror is not None:
                rays = _through(*rays, self.surfaces[mirror], reflect=True)
        places = rays[0] + rays[1] * ((self.sensor_mm - rays[0][:, 2]) / rays[1][:, 2])[:, None]
        return places[:, :2] / self.focal_mm


def _through(starts, along, surface, reflect=False):
    """Return the rays behind a surface, without those that miss it."""
    if surface.radius == 0.0:
        way = (surface.z - starts[:, 2]) / along[:, 2]
        met = starts + way[:, None] * along
        kept = np.hypot(met[:, 0], met[:, 1]) <= surface.half
        return met[kept], along[kept]
    centre = np.array([0.0, 0.0, surface.z + surface.radius])
    nearest = ((starts - centre) * along).sum(axis=1)
    root = nearest**2 - ((starts - centre)**2).sum(axis=1) + surface.radius**2
    starts, along, nearest = starts[root > 0.0], along[root > 0.0], nearest[root > 0.0]
    root = np.sqrt(root[root > 0.0])
    both = [starts + (sign * root - nearest)[:, None] * along for sign in (-1.0, 1.0)]
    front = np.abs(both[0][:, 2] - surface.z) < np.abs(both[1][:, 2] - surface.z)
    met = np.where(front[:, None], *both)
    kept = np.hypot(met[:, 0], met[:, 1]) <= surface.half
    met, along = met[kept], along[kept]
    normal = (met - centre) / surface.radius
    normal *= -np.sign((normal * along).sum(axis=1))[:, None]    # against the ray
    cosine = -(normal * along).sum(axis=1)
    if reflect:
        return met, along + 2.0 * cosine[:, None] * normal
    forward = np.sign(along[:, 2]) > 0.0
    ratio = np.where(forward, surface.before / surface.behind, surface.behind / surface.before)
    rest = 1.0 - ratio**2 * (1.0 - cosine**2)
    passed = ratio[:, None] * along + (ratio * cosine - np.sqrt(np.maximum(rest, 0.0)))[
        :, None] * normal
    return met[rest > 0.0], passed[rest > 0.0]
