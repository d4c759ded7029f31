"""Light that a lens passes on: the picture, and stray light of sun and bright ground over it.

Stray light varies slowly but for the neighbourhood of the sun. It is computed at the corners of
cells and interpolated between them; only near the sun every pixel is computed.

Ghosts of the sun: light that two surfaces of a lens reflect, and gather near the sensor.

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
import functools
import math

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lunar_rover_sim.base.compiled import compiled
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.workers import ONE_THREAD, Workers
from lunar_rover_sim.ground.world.relief import smoothstep
from lunar_rover_sim.image.camera.image_geometry import ImageGeometry, lengths
from lunar_rover_sim.image.camera.lens import Glare, Lens

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


F32 = NDArray[np.float32]
Part = tuple[slice, slice]      # rows and columns of an image

_CELL = 24                  # pixels along a side of a cell
_NEAR_PX = 32.0, 128.0      # from the sun: within the first, every pixel is computed; beyond, none


@dataclasses.dataclass
class ImagedSun:
    """The sun as both cameras of a rectified pair see it.

    Attributes:
        direction: (3,) unit vector in axes of the cameras.
        irradiance: (2,) normal irradiance of what each camera sees of the disc [W/m2].
    """

    direction: Array
    irradiance: Array


class StrayLight:
    """Turns radiance images into what a lens passes on."""

    def __init__(self, lens: Lens, image: ImageGeometry, most_radiance: float,
                 workers: Workers = ONE_THREAD) -> None:
        """Prepare what does not depend on the image.

        Args:
            image: Geometry of what is drawn, padding included.
            most_radiance: Of all but the sun itself, whose glare follows from `ImagedSun`
                [W m-2 sr-1].
            workers: Share the rows.
        """
        self._workers = workers
        self._lens, self._image, self._most = lens, image, np.float32(most_radiance)
        rows, columns = -(-image.height // _CELL), -(-image.width // _CELL)
        self._glare = Glare(lens, (rows, columns), _CELL, image.width * image.height)
        x, y = (np.arange(n + 1.0) * _CELL - 0.5 for n in (columns, rows))
        middle = np.meshgrid(x[:-1] + 0.5 * _CELL, y[:-1] + 0.5 * _CELL)
        self._falloff = image.falloff(np.stack(middle, axis=-1))
        self._corners_px = x[None], y[:, None]
        # Radiance of an irradiance of one.
        self._amplified = 1.0 / image.falloff(np.stack(np.meshgrid(x, y), axis=-1))
        # Both cameras of a pair see the sun in one place.
        self._of_sun = functools.lru_cache(1)(self._light_of_sun)

    def passed_on(self, radiance: F32, depth_m: F32, sun: ImagedSun | None = None,
                  side: int = 0) -> F32:
        """Return what the lens passes on of an image.

        Args:
            radiance: (h, w) [W m-2 sr-1].
            depth_m: (h, w), 0 for the sky.
            sun: What the cameras see of it, if anything.
            side: 0 for the left camera, 1 for the right one.

        Returns:
            (h, w) radiance; the given image itself if the lens is perfect.
        """
        lens, image = self._lens, self._image
        if lens.perfect:
            return radiance
        sums = np.zeros(self._falloff.shape)
        self._workers.rows(_cell_sums, len(sums), radiance, depth_m, self._most, _CELL, sums)
        stray = self._glare.of((sums * (4.0 / _CELL**2) * self._falloff)[None])[0]
        if sun is None:
            return self._veiled(radiance, stray * self._amplified)
        flux = float(sun.irradiance[side]) * lens.hood(sun.direction) * image.pupil(sun.direction)
        veil = lens.config.veil_share * (1.0 - lens.config.ghost_share)
        stray += flux * veil * image.focal_px**2 / (image.width * image.height)
        stray *= self._amplified
        at_corners, parts = self._of_sun(tuple(sun.direction))
        result = self._veiled(radiance, stray + flux * at_corners)
        for part, light in parts if flux > 0.0 else ():
            result[part] += flux * light
        return result

    def _light_of_sun(self,
                      direction: tuple[float, ...]) -> tuple[Array, list[tuple[Part, Array]]]:
        """Return the radiance at corners, and in parts of the image, of an irradiance of one.

        The parts are near the sun, where cells are too coarse, and its ghosts.
        """
        towards = np.array(direction)
        place = self._image.place(towards)
        part, near = self._square(place, _NEAR_PX[1])
        parts = [(part, _nearby(*near, place) * self._scatter(*near, towards))]
        if self._lens.config.ghost_share > 0.0:
            parts += self._ghosts(towards, place)
        corners = self._corners_px
        return (1.0 - _nearby(*corners, place)) * self._scatter(*corners, towards), parts

    def _veiled(self, radiance: F32, stray: Array) -> F32:
        """Return the direct share of radiance, and stray light, known at corners of cells."""
        h, w = radiance.shape
        veil = cv2.resize(stray.astype(np.float32), None, fx=_CELL, fy=_CELL)
        begin = _CELL // 2      # OpenCV interpolates between the middles of cells
        return np.asarray(cv2.scaleAdd(radiance, self._lens.direct_share,
                                       veil[begin:begin + h, begin:begin + w]), np.float32)

    def _scatter(self, columns_px: Array, rows_px: Array, direction: Array) -> Array:
        """Return the radiance that light of an irradiance of one scatters to pixels."""
        apart, radiance = self._image.scatter(columns_px, rows_px, direction)
        return self._lens.scatter(apart) * radiance

    def _ghosts(self, direction: Array, sun_px: Array) -> list[tuple[Part, Array]]:
        """Return the ghosts, each under the fall-off of its middle."""
        focal, config = self._image.focal_px, self._lens.config
        centre = self._image.K[:2, 2]
        pair = config.veil_share * config.ghost_share / PAIRS
        result = []
        for ghost in GHOSTS:
            place = centre + ghost.place * (sun_px - centre)
            passing = ghost.passing(direction)
            part, (columns, rows) = self._square(place, ghost.reach_px(focal))
            if passing > 0.0 and columns.size and rows.size:
                light = ghost.irradiance(lengths(columns - place[0], rows - place[1]), focal)
                # Radiance is irradiance per pixel over the fall-off and the pixel's solid angle.
                result.append((part, light * (pair * passing * focal**2
                                              / float(self._image.falloff(place)))))
        return result

    def _square(self, place: Array, radius_px: float) -> tuple[Part, tuple[Array, Array]]:
        """Return the part of the image around a place, and its (1, w) columns and (h, 1) rows."""
        size = np.array([self._image.width, self._image.height])
        low = np.clip(np.floor(place - radius_px), 0, size).astype(int)
        high = np.clip(np.ceil(place + radius_px) + 1, 0, size).astype(int)
        columns, rows = (np.arange(a, b, dtype=float) for a, b in zip(low, high))
        return ((slice(low[1], high[1]), slice(low[0], high[0])),
                (columns[None], rows[:, None]))


def _nearby(columns_px: Array, rows_px: Array, sun_px: Array) -> Array:
    """Return the share of the scattered light at places that is computed pixel by pixel."""
    low, high = _NEAR_PX
    apart = lengths(columns_px - sun_px[0], rows_px - sun_px[1])
    return smoothstep((high - apart) / (high - low))


@compiled
def _cell_sums(first, last, radiance, depth, most, cell, cells):  # type: ignore[no-untyped-def]
    """Fill in the sums of rows of cells, of the radiance of every second pixel and row.

    The sky is left out: stray light of the sun is computed apart, and the Earth has none. Light
    brighter than `most` is that of the sun itself, and cut off.
    """
    h, w = radiance.shape
    for r in range(first * cell, min(last * cell, h), 2):
        row, far, sums = radiance[r], depth[r], cells[r // cell]
        for k in range(len(sums)):
            total = 0.0
            for c in range(cell * k, min(cell * (k + 1), w), 2):
                if far[c] != 0.0:
                    total += min(row[c], most)
            sums[k] += total
