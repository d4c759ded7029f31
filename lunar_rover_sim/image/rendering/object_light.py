"""The light and the truth of rocks and the rover, from what the device has drawn of them."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.image.illumination.hapke import fill_reflectance
from lunar_rover_sim.image.lidar.ray_arrays import RockArrays
from lunar_rover_sim.image.rendering.ground_band import GroundSource
from lunar_rover_sim.image.rendering.labels import link_label
from lunar_rover_sim.image.rendering.lamp_rows import add_lamp, lamp_on_objects
from lunar_rover_sim.image.rendering.object_rows import (angles, count, find, light_rover, mixed,
                                                         rock_radiance, rock_surface, scatter)
from lunar_rover_sim.image.rendering.projection import ViewNumbers
from lunar_rover_sim.image.rendering.rover_pass import BodyLight
from lunar_rover_sim.image.rendering.shade_rows import may_shade, rover_shadow
from lunar_rover_sim.image.rendering.tint_rows import tint_of_rocks, tint_of_rover
from lunar_rover_sim.image.rendering.truth_rows import light_of

F32 = NDArray[np.float32]

_ROWS = 32              # of an image that are lit at a time


@dataclasses.dataclass(frozen=True)
class ObjectSource:
    """What rocks and the rover are lit with by one source of light.

    Attributes:
        ground: What the ground is lit with.
        rocks: As `rock_pass.rock_table`.
        hulls: Of the same rocks.
        body: Of the rover; None where it is out of view.
        parts: As `RoverPass.parts`.
        links: (links, 4, 4) float32 world poses.
    """

    ground: GroundSource
    rocks: F32
    hulls: RockArrays
    body: BodyLight | None
    parts: F32
    links: F32


@dataclasses.dataclass(frozen=True)
class Surfaces:
    """What the device has drawn of rocks and the rover in one image.

    Attributes:
        depth_m: (h, w), negative where they are seen before the ground.
        surface: (h, w, 2) packed normal and number, as shaders/surface.frag has them.
        view: The camera.
    """

    depth_m: F32
    surface: NDArray[np.uint32]
    view: ViewNumbers

    def light(self, sources: list[ObjectSource], workers: Workers, radiance: F32 | None,
              tint: NDArray[np.uint32] | None, shadow: NDArray[np.uint8] | None) -> None:
        """Fill in the pixels of rocks and the rover.

        Args:
            sources: The sun first.
            radiance: (h, w) [W m-2 sr-1]; None, as the others, where it is not wanted.
            tint: (h, w) as `sensor.Tint`.
            shadow: (h, w, 3) as the layer of truth.
        """
        h = len(self.depth_m)
        into = _Into(None if radiance is None else radiance.reshape(-1),
                     None if tint is None else tint.reshape(-1),
                     None if shadow is None else shadow.reshape(-1, 3))
        workers.map(self._light_rows, [(row, min(row + _ROWS, h), sources, into)
                                       for row in range(0, h, _ROWS)])

    def _light_rows(self, first: int, last: int, sources: list[ObjectSource],
                    into: _Into) -> None:
        for of_rover, n in enumerate(count(first, last, self.depth_m, self.surface)):
            if not n or (of_rover and sources[0].body is None):
                continue
            places, numbers = np.empty(n, np.int64), np.empty(n, np.int32)
            at = np.empty((10, n), np.float32)
            find(first, last, self.depth_m, self.surface, self.view.numbers, bool(of_rover),
                 places, numbers, at)
            for k, source in enumerate(sources):
                (_light_rover if of_rover else _light_rocks)(
                    source, self.view, places, numbers, at, into, add=k > 0)

    def links(self, parts: F32) -> NDArray[np.uint8]:
        """Return (h, w) 0, or 1 + the index of the link of the rover that a pixel shows."""
        number = self.surface[..., 1].astype(np.int32)
        shows = (self.depth_m < 0.0) & (number < 0)
        link = np.zeros(number.shape, np.uint8)
        link[shows] = 1 + parts[-1 - number[shows], 0].astype(np.uint8)
        return link

    def labels(self, parts: F32, rocks: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return (h, w) labels of rocks and the rover, 0 elsewhere.

        Args:
            rocks: (m,) those of the rocks.
        """
        number = self.surface[..., 1].astype(np.int32)
        label = np.zeros(number.shape, np.uint16)
        of_link = np.array([link_label(int(part[0])) for part in parts], np.uint16)
        shows = self.depth_m < 0.0
        rover, rock = shows & (number < 0), shows & (number >= 0)
        label[rover], label[rock] = of_link[-1 - number[rover]], rocks[number[rock]]
        return label


@dataclasses.dataclass(frozen=True)
class _Into:
    """Flat images to fill in; None where one is not wanted."""

    radiance: F32 | None
    tint: NDArray[np.uint32] | None
    shadow: NDArray[np.uint8] | None

    def write(self, places: NDArray[np.int64], whole: F32, add: bool) -> None:
        if self.radiance is not None:
            scatter(places, whole, self.radiance, add)

    def tell_shadow(self, places: NDArray[np.int64], at: F32, shares: tuple[F32, F32],
                    normal: F32, source: GroundSource) -> None:
        """Fill in the shares of the sun; shares: those that the world and the rover leave."""
        if self.shadow is not None:
            told = np.empty((3, len(places)), np.uint8)
            light_of(at[0], *shares, *normal, source.constants.sun,
                     bool(source.constants.irradiance > 0.0), *told)
            self.shadow[places] = told.T


def _shadow_of_rover(source: GroundSource, view: ViewNumbers, at: F32) -> F32:
    """Return the share of the sun that the rover leaves, (n,)."""
    towards, place = source.constants.towards, source.shadow.seen_from(view.camera)
    share = np.ones(at.shape[1], np.float32)
    if may_shade(at, towards, place, source.shadow.bounds):
        rover_shadow(at, view.numbers, towards, source.shadow.silhouette(), place, share)
    return share


def _lamp_on(source: GroundSource, view: ViewNumbers, at: F32, normal: F32) -> F32:
    """Return (6, n) as `lamp_on_objects`; (6, 0) without a lamp."""
    lamp = source.lamp
    result = np.empty((6, at.shape[1] if lamp is not None else 0), np.float32)
    if lamp is not None:
        lamp_on_objects(at, normal, lamp.numbers(view.camera), lamp.clip, lamp.shadow, result)
    return result


def _light_rocks(source: ObjectSource, view: ViewNumbers, places: NDArray[np.int64],
                 numbers: NDArray[np.int32], at: F32, into: _Into, *, add: bool) -> None:
    ground, constants, n = source.ground, source.ground.constants, len(places)
    tile = ground.texels.coarse
    normal, matter = np.empty((3, n), np.float32), np.empty((4, n), np.float32)
    rock_surface(numbers, at, source.rocks, source.hulls, *tile, constants.towards,
                 np.array([view.pixel, constants.rough, view.camera[2]], np.float32), normal,
                 matter)
    seen, albedo, around, soil = matter
    of_rover = _shadow_of_rover(ground, view, at)
    lit, cosines = seen * of_rover, np.empty((3, n), np.float32)
    angles(at, normal, constants.towards, lit, cosines)
    direct, whole = np.empty((2, n), np.float32)
    rock_radiance(_reflected(source, cosines, albedo, soil), lit, around, albedo, normal[2],
                  constants.irradiance, constants.rock_diffuse, direct, whole)
    lamp = _lamp_on(ground, view, at, normal)
    of_lamp = lamp_g = np.zeros(n, np.float32)
    if ground.lamp is not None:
        of_lamp, lamp_g = np.empty(n, np.float32), lamp[5]
        add_lamp(_reflected(source, np.stack([lamp[4], cosines[1], lamp_g]), albedo, soil),
                 lamp[0], of_lamp, whole)
    into.write(places, whole, add)
    if not add:
        into.tell_shadow(places, at, (seen, of_rover), normal, ground)
        if into.tint is not None:
            codes = np.empty(n, np.uint32)
            tint_of_rocks(albedo, soil, cosines[2], lamp_g, direct, of_lamp, whole,
                          constants.rock_tint, constants.soil_tint, constants.tint_spread,
                          constants.lamp_tint, codes)
            scatter(places, codes, into.tint, False)


def _reflected(source: ObjectSource, cosines: F32, albedo: F32, soil: F32) -> F32:
    """Return the reflectance of rocks with soil on them, (n,)."""
    constants, n = source.ground.constants, len(albedo)
    theta, zero = np.full(n, constants.rock_theta, np.float32), np.zeros(n, np.float32)
    of_rock, of_soil, result = np.empty((3, n), np.float32)
    for law, values in ((constants.rock_law, of_rock), (constants.law, of_soil)):
        fill_reflectance(*cosines, theta, albedo, zero, law, values)
    mixed(soil, of_rock, of_soil, result)
    return result


def _light_rover(source: ObjectSource, view: ViewNumbers, places: NDArray[np.int64],
                 numbers: NDArray[np.int32], at: F32, into: _Into, *, add: bool) -> None:
    ground, constants, body, n = source.ground, source.ground.constants, source.body, len(places)
    assert body is not None
    face = at[7:10]
    light, shares = np.empty((4, n), np.float32), np.empty((2, n), np.float32)
    light_rover(numbers, at, source.parts, source.links, body.light, body.from_sun, body.map,
                constants.towards, constants.irradiance, np.float32(view.camera[2]),
                _lamp_on(ground, view, at, face), light, shares)
    into.write(places, light[0], add)
    if not add:
        into.tell_shadow(places, at, (shares[0], shares[1]), face, ground)
        if into.tint is not None:
            codes = np.empty(n, np.uint32)
            tint_of_rover(numbers, source.parts, light, constants.soil_tint, constants.lamp_tint,
                          codes)
            scatter(places, codes, into.tint, False)


def tell_objects(truth: dict[str, NDArray[Any]], surfaces: Surfaces, parts: F32,
                 rocks: NDArray[np.uint16], face: NDArray[np.float32] | None) -> None:
    """Fill in labels and normals of rocks and the rover.

    Args:
        rocks: (m,) labels.
        face: (h, w, 3) true normals.
    """
    shows = (surfaces.depth_m < 0.0).view(np.uint8)
    if 'label' in truth:
        cv2.copyTo(surfaces.labels(parts, rocks), shows, truth['label'])
    if 'normal' in truth and face is not None:
        cv2.copyTo(face, shows, truth['normal'])
