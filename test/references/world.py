"""World: levels, craters, rocks, their shapes and statistics."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from references.cases import reference
from references.scenes import craters, hills, hilly_levels, small_world, stony_world
from references.summary import Within

from lunar_rover_sim.world import (crater_population, curvature, ejecta, far_albedo, far_rocks,
                                   lattice, levels, relief, rockfield, shapes, stamping)
from lunar_rover_sim.world.config import (AlbedoConfig, CraterConfig, preset, PRESETS,
                                          ReliefConfig, RockConfig, WorldConfig)
from lunar_rover_sim.world.crater_profile import fresh_profile, profile_table
from lunar_rover_sim.world.craters import Craters
from lunar_rover_sim.world.fill import harmonic_fill, plate_fill
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.site import reported_site, Site, site_towards, unit_vector
from lunar_rover_sim.world.window import window_of


def parts(world: World) -> dict[str, Any]:
    """Return all that a world consists of, but for names and hash."""
    return {'heights': [level.heights_m for level in world.levels], 'albedo': world.albedo,
            'cells': [level.cell_m for level in world.levels],
            'rocks': world.rocks, 'craters': world.craters,
            'origin': world.report['origin_height_m']}


@reference
def worlds() -> dict[str, Any]:
    """Four recipes."""
    return {
        'stony': parts(small_world(2)),
        'level craters': parts(small_world(3, craters={
            'irregularity': 0.0, 'density': 0.3, 'slope': 2.6, 'fresh_depth': 0.15,
            'oldest_depth': 0.05, 'max_diameter_m': 9.0}, albedo={'variation': 0.0})),
        'few rocks': parts(small_world(4, clear_radius_m=1.7, rocks={
            'max_number': 9, 'abundance': 0.2, 'decay_per_m': 3.0, 'tilt_deg': 40.0,
            'near_craters': 30.0, 'burial': 0.6, 'size_classes': 5}, albedo={'grain': 0.0})),
        'coarse': parts(small_world(5, size_m=12.8, cell_m=0.1, albedo={'fresh_crater': 0.0},
                                    relief={'rms_slope_deg': 6.0, 'far_rms_slope_deg': 0.0,
                                            'longest_wavelength_m': 20.0}))}


@reference
def packaged_recipes() -> dict[str, Any]:
    """The worlds of the scenarios, as their recipes say."""
    return {name: preset(name).to_mapping() for name in PRESETS}


@reference
def progress() -> dict[str, Any]:
    """What is told while a world is built."""
    told: list[str] = []
    from lunar_rover_sim.world.build import build_world
    build_world(WorldConfig.from_mapping({'size_m': 1.6, 'surroundings': {
        'samples': 65, 'extent_m': 9.0}}), 3, lambda what, share: told.append(f'{what} {share:g}'))
    return {'told': told}


@reference
def plans() -> dict[str, Any]:
    """Samples and cells of levels."""
    found = {}
    for size, cell, samples, extent in ((51.2, 0.025, 2049, 1000.0), (6.4, 0.025, 65, 100.0),
                                        (25.6, 0.1, 70, 3000.0), (1.6, 0.1, 100, 0.0),
                                        (204.8, 0.05, 65, 900.0), (102.4, 0.025, 513, 50.0)):
        config = WorldConfig.from_mapping({'size_m': size, 'cell_m': cell, 'surroundings': {
            'samples': samples, 'extent_m': extent}})
        found[f'{size} {cell} {samples} {extent}'] = str(levels.plan(config))
    return found


@reference
def splines() -> dict[str, Any]:
    """Bicubic splines on odd grids, and beyond their ends."""
    rng = np.random.default_rng(1)
    found = {}
    for ny, nx in ((1, 1), (1, 3), (2, 3), (2, 2), (4, 3), (13, 7), (90, 5)):
        y, x = 1.0 + 0.5 * np.arange(ny), -2.0 + 0.25 * np.arange(nx)
        found[f'{ny} {nx}'] = levels.spline(y, x, rng.normal(size=(ny, nx)),
                                            np.linspace(y[0] - 1.0, y[-1] + 1.0, 71),
                                            np.linspace(x[0] - 0.3, x[-1] + 0.4, 23))
    return found


@reference
def seams() -> dict[str, Any]:
    """A level within a coarser one: interpolation, fading, border."""
    parent = hills(33, 0.8, 0.5, 0.1)
    found: dict[str, Any] = {'fade': [levels.fade(n) for n in (5, 17, 49, 151, 257, 301)]}
    for n in (49, 161):
        fine = levels.refine(parent, n, 0.1)
        found[f'refined {n}'] = fine.copy()
        fine += hills(n, 0.1, 0.05).heights_m
        levels.fit_border(fine, 0.1, parent)
        found[f'fitted {n}'] = fine.copy()
        fine += np.float32(0.2)
        levels.close_seam(fine, 0.1, parent)
        found[f'closed {n}'] = fine
        coarse = parent.heights_m.copy()
        levels.embed(coarse, fine)
        found[f'embedded {n}'] = coarse
    return found


@reference
def reliefs() -> dict[str, Any]:
    """Spectra of power, and heights from them."""
    k = np.geomspace(1e-4, 1e3, 57)
    configs = {'default': ReliefConfig(),
               'rough': ReliefConfig(hurst=0.4, rms_slope_deg=7.0, baseline_m=0.1, far_hurst=0.6,
                                     far_rms_slope_deg=11.0, far_baseline_m=5.0,
                                     longest_wavelength_m=90.0)}
    found: dict[str, Any] = {'step': relief.smoothstep(np.linspace(-0.2, 1.2, 15)),
                             'pass': relief.high_pass(k, 3.0)}
    for name, config in configs.items():
        S = relief.spectrum(config)
        found[name] = {'power': S(k), 'differences': [
            relief.structure_function(S, b) for b in (0.05, 0.3, 2.0, 17.0, 60.0)]}
        for n, parent, finest in ((75, None, False), (75, 0.8, True), (64, 0.8, False),
                                  (48, None, True)):
            found[name][f'heights {n} {parent} {finest}'] = relief.synthesise(
                S, n, 0.1, parent, finest, np.random.default_rng(n))
    return found


@reference
def crater_profiles() -> dict[str, Any]:
    """Profiles from fresh to old."""
    found = {}
    for name, config in (('default', CraterConfig()),
                         ('shallow', CraterConfig(fresh_depth=0.11, fresh_rim=0.01,
                                                  oldest_depth=0.06)),
                         ('no time', CraterConfig(oldest_depth=0.2))):
        table = profile_table(config)
        found[name] = {'fresh': fresh_profile(config), 'table': table,
                       'between': np.array([table.at(age) for age in (0.0, 0.004, 0.33, 0.9,
                                                                      1.0)])}
    return found


@reference
def crater_fields() -> dict[str, Any]:
    """How many craters, which of them stay, and what they make of heights, albedo and rocks."""
    config = CraterConfig(density=0.2, slope=2.4, age_exponent=1.7, max_diameter_m=30.0)
    rng = np.random.default_rng(8)
    large = crater_population.populate(config, 40.0, 4.0, np.inf, 2, rng)
    small = crater_population.populate(config, 9.0, 0.4, 4.0, 1, rng)
    calm = crater_population.keep_clear(small, config, 2.3)
    heights, albedo = hills(113, 0.17, 0.2, 0.1).heights_m.copy(), np.zeros((113, 113), np.float32)
    stamping.stamp(heights, 0.17, Craters.join([small, large]), config, rng)
    stamping.brighten(albedo, 0.17, Craters.join([small, large, craters()]), 0.2)
    rays = np.zeros((97, 97), np.float32)
    ejecta.add_rays(rays, 0.6, Craters.join([craters(), large]), 0.3)
    return {'large': large, 'small': small, 'clear': calm,
            'steeper': len(crater_population.keep_clear(small, config, 2.3, 12.0)),
            'alive': crater_population.survivors(calm, large),
            'none': len(crater_population.populate(config, 9.0, 40.0, 50.0, 0, rng)),
            'per m2': [crater_population.density_per_m2(config, d) for d in (0.2, 3.0, 40.0)],
            'time': small.time, 'heights': heights, 'albedo': albedo, 'rays': rays}


@reference
def rock_fields() -> dict[str, Any]:
    """Sizes, places and poses of rocks."""
    found: dict[str, Any] = {}
    ground = hills(121, 0.1, 0.3, 0.2)
    for name, config in (('default', RockConfig()),
                         ('many', RockConfig(abundance=0.1, decay_per_m=2.0, min_diameter_m=0.1,
                                             max_diameter_m=1.1, size_classes=7, tilt_deg=30.0,
                                             near_craters=9.0, albedo_variation=0.3, burial=0.1))):
        diameter = np.geomspace(0.02, 3.0, 31)
        classes = rockfield.size_classes(config)
        rng = np.random.default_rng(11)
        size = rng.integers(0, len(classes), 40)
        xy = rng.uniform(-5.0, 5.0, (40, 2))
        order = np.argsort(-classes[size], kind='stable')
        found[name] = {
            'decay': rockfield.decay_per_m(config), 'classes': classes,
            'number': rockfield.number_per_m2(config, diameter),
            'density': rockfield.relative_density(config, 6.0, 75, craters()),
            'apart': rockfield.apart(0.3 * xy[order], 3.0 * classes[size][order]),
            'laid': rockfield.laid(config, ground, shapes.library(), xy, size, rng),
            'scattered': rockfield.scatter(config, ground, shapes.library(), craters(), 0.9, rng),
            'none': len(rockfield.no_rocks(config))}
    return found


@reference
def rock_shapes() -> dict[str, Any]:
    """The library, and the hull of some points."""
    points = np.random.default_rng(3).normal(size=(40, 3)) * [1.0, 2.0, 0.5]
    return {'library': list(shapes.library()), 'hull': shapes.hull('a hull', points)}


@reference
def beyond_the_ground() -> dict[str, Any]:
    """Albedo and rocks of the coarse levels, which follow from recipe and craters."""
    world = stony_world()
    world = dataclasses.replace(world, config=WorldConfig.from_mapping({
        'seed': 4, 'rocks': {'abundance': 0.04, 'max_diameter_m': 1.4},
        'albedo': {'variation': 0.2, 'fresh_crater': 0.4}}))
    grey = dataclasses.replace(world, config=dataclasses.replace(
        world.config, albedo=AlbedoConfig(variation=0.0)))
    xy = np.random.default_rng(1).uniform(-300.0, 300.0, (20, 2))
    return {'albedo': [far_albedo.far_albedo(world, k) for k in (1, 2)],
            'rays alone': far_albedo.far_albedo(grey, 1),
            # Their places follow from exponentials in single precision, on no lattice.
            'rocks': {f'{reach}': Within(far_rocks.far_rocks(world, reach), 1e-4)
                      for reach in (2.0, 9.0, 60.0)},
            'number': Within(float(len(far_rocks.far_rocks(world, 500.0))), 0.01),
            'least': far_rocks.least_diameter_m(xy)}


@reference
def filled_gaps() -> dict[str, Any]:
    """Gaps in grids of odd sizes."""
    found = {}
    for ny, nx in ((3, 4), (5, 9), (23, 31), (64, 40)):
        values = hills(max(ny, nx), 0.3, 1.0, 0.3).heights_m[:ny, :nx].copy()
        rng = np.random.default_rng(ny)
        known = rng.random((ny, nx)) > 0.3
        known[ny // 3:2 * ny // 3, nx // 4:nx // 2] = False
        found[f'harmonic {ny} {nx}'] = harmonic_fill(values, known)
        found[f'plate {ny} {nx}'] = plate_fill(values, known, 0.02, 40)
        found[f'nothing known {ny}'] = harmonic_fill(values, np.zeros_like(known))
        found[f'all known {ny}'] = plate_fill(values, np.ones_like(known), 0.1)
    return found


@reference
def points_on_grids() -> dict[str, Any]:
    """Heights of triangles, at edges and corners, and outside."""
    grid = hills(12, 0.3, 0.4, 0.2)
    half = grid.half_extent_m
    xy = np.concatenate([np.random.default_rng(2).uniform(-1.1 * half, 1.1 * half, (60, 2)),
                         [[half, half], [-half, half], [half, -half], [-half, -half], [half, 0.1],
                          [0.2, half], [0.0, 0.0], [0.15, 0.15], [half + 1e-6, 0.0],
                          [np.nan, 0.0], [0.0, -half - 1e-6]]])
    world = World(hilly_levels(), np.ones((97, 97), np.float32), rockfield.no_rocks(RockConfig()),
                  (), WorldConfig(), '')
    return {'heights': grid.height_at(xy), 'one by one': np.array(
                [grid.height_at_point(x, y) for x, y in xy.tolist()]),
            'inside': grid.contains(xy), 'half': grid.half_extent_m, 'samples': grid.n,
            'of levels': world.height_at(xy * 40.0)}


@reference
def curvature_and_rounding() -> dict[str, Any]:
    """The sphere, the lattice, and windows around places."""
    heights = np.zeros((131, 131), np.float32)
    curvature.bend(heights, 47.0, 300.0)
    values = np.linspace(-1.0, 1.0, 37) ** 3
    windows = [str(window_of(x, y, reach, 20)) for x in (-3.2, 0.0, 4.7, 19.0, 22.4)
               for y in (-1.0, 7.5, 18.6) for reach in (0.4, 1.0, 2.6, 9.0)]
    return {'drop': curvature.drop_m(np.array([0.0, 1e4, 1e6, 1e8]), 70.0), 'bent': heights,
            'steps': [lattice.height_step_m(c) for c in (0.025, 0.03, 0.2, 1.0, 12.8)],
            'on it': lattice.on_lattice(values, 2.0**-5), 'significant': lattice.significant(
                values), 'windows': windows, 'axis': levels.axis_m(7, 0.3)}


@reference
def sites() -> dict[str, Any]:
    """Places on the Moon and how their grids are turned."""
    found: dict[str, Any] = {}
    for lon, lat, north in ((0.0, 0.0, 0.0), (23.4, -71.0, 35.0), (-140.0, 88.0, -170.0)):
        site = Site(lon, lat, north)
        found[f'{lon} {lat}'] = {
            'turn': site.rotation_enu_moon(), 'report': site.to_report(),
            'azimuth': site.azimuth_deg(np.array([0.0, 12.0, 200.0, -30.0])),
            'direction': unit_vector(lon, lat), 'read': reported_site(site.to_report()),
            'towards': site_towards(lon, lat, unit_vector(lon - 0.3, lat - 0.2),
                                    unit_vector(lon + 0.2, lat + 0.1))}
    found['none'] = reported_site({'lon_deg': 3.0, 'lat_deg': 2.0}) is None
    return found
