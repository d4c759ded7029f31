"""Illumination: reflectance, shadows, indirect light, what is seen of the sun."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from references.cases import reference
from references.scenes import hills, hilly_levels, stones, stony_world
from references.summary import Within

from lunar_rover_sim.frames import sun_direction
from lunar_rover_sim.illumination import hapke, rock_shadow
from lunar_rover_sim.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.illumination.horizon import (disc_fraction, shadow_levels, ShadowLevel, split,
                                                  SunGeometry)
from lunar_rover_sim.illumination.indirect_light import indirect_light
from lunar_rover_sim.illumination.lamp import beam_exponent, peak_intensity
from lunar_rover_sim.illumination.sun_disc import central_radiance, disc_radiance, limb_darkening
from lunar_rover_sim.illumination.sun_view import SunView
from lunar_rover_sim.illumination.sunlight import Sunlight
from lunar_rover_sim.world import shapes
from lunar_rover_sim.world.grid import HeightGrid

# Low and grazing, along axes and diagonals, high, and below the horizontal.
SUNS = ((17.0, 5.0), (118.0, 1.2), (225.0, 12.0), (290.0, 42.0), (90.0, 3.0), (0.0, 84.0),
        (341.0, -0.4))


def _sun(azimuth_deg: float, elevation_deg: float) -> SunGeometry:
    return SunGeometry.towards(sun_direction(azimuth_deg, elevation_deg))


@reference
def reflectances() -> dict[str, Any]:
    """Every set over angles, with and without roughness."""
    rng = np.random.default_rng(1)
    i, e, g = rng.uniform(-0.1, 1.0, 400), rng.uniform(-0.1, 1.0, 400), rng.uniform(-1.0, 1.0, 400)
    phase = np.linspace(0.0, 3.1, 30)
    found: dict[str, Any] = {}
    for name in hapke.SETS:
        kind = hapke.parameter_set(name)
        found[name] = {
            'set': kind, 'r': hapke.reflectance(i, e, g, kind),
            'smooth': hapke.reflectance(i, e, g, kind, albedo=1.9, theta_deg=0.0),
            'bright': hapke.reflectance(i, e, g, kind, albedo=9.0, theta_deg=31.0),
            'phase': hapke.phase_function(phase, kind.b, kind.c),
            'opposition': hapke.opposition(phase[:25], kind.b_s0, kind.h_s),
            'albedo': [hapke.normal_albedo(kind), hapke.hemispherical_albedo(kind),
                       hapke.hemispherical_albedo(kind, 0.1)]}
    x, y = np.abs(i), np.abs(e)
    found['roughness'] = list(hapke.roughness(x, y, g, 0.4))
    found['retro'] = list(hapke.roughness(x, x, np.ones(400), 0.3))
    found['H'] = hapke.chandrasekhar(x[:, None] + 1e-3, np.array([0.1, 0.6, 0.95]))
    return found


@reference
def shadows_of_relief() -> dict[str, Any]:
    """Clearance and distance of what limits the sun, on three levels, and above them."""
    found: dict[str, Any] = {}
    levels = hilly_levels()
    rng = np.random.default_rng(2)
    points = rng.uniform(-120.0, 120.0, (60, 3)) * [1.0, 1.0, 0.1] + [0.0, 0.0, 12.0]
    for azimuth, elevation in SUNS:
        sun = _sun(azimuth, elevation)
        made = shadow_levels(levels, sun)
        found[f'{azimuth} {elevation}'] = {
            'levels': [list(level.clearance()) for level in made],
            'points': list(made[2].clearance_of(points)),
            'below': made[1].shadow_at(points[:, :2] / 9.0), 'sweep': sun.sweep_rad,
            'ground': made[1].shadow_at(points[:, :2] / 9.0, with_ground=True)}
    found['other heights'] = list(ShadowLevel(levels[0], _sun(33.0, 8.0), None, np.asarray(
        levels[0].heights_m[::-1])).clearance())
    above = (np.array([[3.0], [2.5], [1.9]]) * rng.uniform(-1.0, 3.0, (3, 40))).astype(np.float32)
    found['split'] = [list(split(above, _sun(0.0, e))) for e in (2.0, 88.0)]
    found['fraction'] = disc_fraction(np.linspace(-0.006, 0.006, 21), 0.0046)
    return found


@reference
def outlines_of_rocks() -> dict[str, Any]:
    """Silhouettes, and which points are within."""
    found: dict[str, Any] = {}
    rocks = stones(hills(65, 0.1, 0.2, 0.1), 23)
    rng = np.random.default_rng(3)
    for azimuth, elevation in SUNS[:4]:
        made = rock_shadow.silhouettes(rocks, shapes.library(), _sun(azimuth, elevation))
        a, b = rng.uniform(-3.0, 3.0, (2, 300)).astype(np.float32)
        found[f'{azimuth}'] = {
            'edges': np.sort(made.edges, axis=1), 'centre': made.centre, 'axes': made.axes,
            'width': made.half_width, 'top': made.top,
            'distance': made.distance(rng.integers(0, 23, 300), a, b)}
    return found


@reference
def shadows_of_rocks() -> dict[str, Any]:
    """Rocks on slopes and at borders: fine and coarse grids, each sun; rocks in shadow."""
    found: dict[str, Any] = {}
    for steepness in (0.0, 0.3):
        ground = hills(91, 0.07, 0.08, steepness)
        rocks = stones(ground, 17, 8, 1.3)
        coarse = [(HeightGrid(hills(n, cell, 0.1, steepness).heights_m, cell), inner)
                  for n, cell, inner in ((41, 0.3, 0.0), (33, 0.9, 3.15), (17, 2.3, 3.15),
                                         (35, 3.0, 45.0))]
        for azimuth, elevation in SUNS:
            sun = _sun(azimuth, elevation)
            made = rock_shadow.silhouettes(rocks, shapes.library(), sun)
            clearance, occluder = ShadowLevel(ground, sun, None).clearance()
            rock_shadow.stamp(clearance, occluder, ground, made, sun)
            name = f'{steepness} {azimuth} {elevation}'
            # Where two rocks limit the sun alike, the last bit says whose distance counts.
            found[name] = {'angle': clearance / occluder, 'pair': Within(
                [clearance, occluder], 0.1), 'shares': Within([
                    rock_shadow.share(grid, made, sun, inner).astype(np.float32)
                    for grid, inner in coarse], 1e-3)}
            points = rocks.position_m + [0.0, 0.0, 0.1]
            limits = np.linspace(-0.1, 2.0, 17).astype(np.float32)
            found[name]['rocks'] = list(rock_shadow.darken(
                limits, np.linspace(20.0, 1.0, 17).astype(np.float32), points, made))
    return found


@reference
def light_between_hills() -> dict[str, Any]:
    """Light that lit ground scatters."""
    found = {}
    for n, cell in ((23, 0.4), (64, 1.7), (47, 0.1)):
        grid = hills(n, cell, 0.5 * cell, 0.1)
        lit = (hills(n, cell, 0.6).heights_m > 0.1).astype(np.float32)
        found[f'{n}'] = list(indirect_light(grid.heights_m, cell, lit, sun_direction(70.0, 11.0),
                                            0.17))
    return found


@reference
def sunlight_of_a_world() -> dict[str, Any]:
    """All light of a small world, with far rocks, for three suns; by night, and without bounce."""
    found: dict[str, Any] = {}
    world = stony_world(count=21)
    far = stones(world.levels[1], 19, 2, 0.99)
    xy = np.random.default_rng(4).uniform(-110.0, 110.0, (50, 2)) * np.geomspace(
        0.01, 1.0, 50)[:, None]
    for azimuth, elevation, indirect in ((63.0, 4.0, True), (200.0, 19.0, True),
                                         (300.0, 1.0, False), (10.0, -0.2, True)):
        direction = sun_direction(azimuth, elevation)
        light = Sunlight(world, SunConfig(azimuth_deg=azimuth, elevation_deg=elevation,
                                          angular_diameter_deg=0.7),
                         ReflectanceConfig('mare', 'rock', 1.3), direction, indirect, far)
        found[f'{azimuth}'] = {
            'clearance': [list(pair) for pair in light.clearance],
            'shares': Within([share.astype(np.float32) for share in light.rock_share], 1e-3),
            'scattered': [list(pair) for pair in light.scattered], 'rocks': light.rock_light(),
            'around': light.surroundings_at(xy),
            'angle': light.angle_above_horizon(np.column_stack([xy, 0.4 + 0.0 * xy[:, 0]]))}
    return found


@reference
def lamps_and_discs() -> dict[str, Any]:
    """The beam of the lamp, the disc of the sun."""
    lamps = [LampConfig(power_w=3.0, cone_deg=cone) for cone in (20.0, 60.0, 120.0)]
    sun = SunConfig(angular_diameter_deg=0.8, irradiance=900.0)
    rays = np.random.default_rng(5).normal(size=(200, 3)) * [0.006, 0.006, 0.0] + [0.0, 0.0, 2.0]
    faint = SunConfig(angular_diameter_deg=4.9, irradiance=0.01)
    return {'lamps': [[beam_exponent(lamp), peak_intensity(lamp)] for lamp in lamps],
            'faint': central_radiance(faint), 'centre': central_radiance(sun),
            'dark': limb_darkening(np.linspace(0.0, 1.2, 25)),
            'disc': disc_radiance(rays, [0.0, 0.0, 1.0], sun),
            'behind': disc_radiance(-rays, [0.0, 0.0, 1.0], sun),
            'shines': [SunConfig(elevation_deg=e, irradiance=r).shines
                       for e in (-0.3, -0.25, 0.0, 4.0) for r in (0.0, 10.0)]}


@reference
def views_of_the_sun() -> dict[str, Any]:
    """What places see of the disc, behind hills near and far, and where the world ends."""
    world = stony_world()
    found: dict[str, Any] = {}
    for azimuth, elevation in (*SUNS, (45.0, 0.1), (250.0, 90.0)):
        view = SunView(world, SunConfig(azimuth_deg=azimuth, elevation_deg=elevation,
                                        angular_diameter_deg=0.6))
        rows = []
        for point in ((0.0, 0.0, 0.2), (2.3, -1.0, 0.5), (-30.0, 60.0, 3.0), (102.0, 0.3, 40.0),
                      (500.0, 0.0, 0.0)):
            seen = view.seen_from(np.array(point),
                                  lambda place, rays: rays @ [0.3, -0.5, 0.8] > -0.4)
            rows.append([math.nan] * 4 if seen is None else [*seen.direction, seen.share])
        found[f'{azimuth} {elevation}'] = np.array(rows)
    return found
