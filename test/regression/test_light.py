"""Reflectance, shadows, indirect light, the sky and the sensors of light."""

from collections.abc import Callable

import numpy as np
from regression.conftest import DOUBLE, SINGLE
from regression.scenes import hills, hilly_levels, stones, stony_world

from lunar_rover_sim.base.frames import matrix_from_wxyz, sun_direction, wxyz_from_rpy
from lunar_rover_sim.ground.world import shapes
from lunar_rover_sim.ground.world.moon_place import MoonPlace
from lunar_rover_sim.image.illumination import hapke, rock_shadow
from lunar_rover_sim.image.illumination.config import ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.horizon import shadow_levels, ShadowLevel, SunGeometry
from lunar_rover_sim.image.illumination.sky import sky
from lunar_rover_sim.image.illumination.sun_view import SeenSun, SunView
from lunar_rover_sim.image.illumination.sunlight import Sunlight
from lunar_rover_sim.sensors.solar_panel import solar_power_w, SolarPanelConfig
from lunar_rover_sim.sensors.star_tracker import StarCamera, StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunHeads, SunSensorConfig

Unchanged = Callable[..., None]
# Low and grazing, along axes and diagonals, and high.
SUNS = ((17.0, 5.0), (118.0, 1.2), (225.0, 12.0), (290.0, 42.0), (90.0, 3.0))
# Of shadows: where two rocks or hills limit the sun alike, the last bit says which one counts.
SHADOW = 1e-3


def sun_of(azimuth_deg: float, elevation_deg: float) -> SunGeometry:
    return SunGeometry.towards(sun_direction(azimuth_deg, elevation_deg))


def test_reflectance_of_each_parameter_set(unchanged: Unchanged) -> None:
    rng = np.random.default_rng(1)
    i, e, g = rng.uniform(-0.1, 1.0, 400), rng.uniform(-0.1, 1.0, 400), rng.uniform(-1.0, 1.0, 400)
    arrays = {}
    for name in hapke.SETS:
        kind = hapke.parameter_set(name)
        arrays |= {name: hapke.reflectance(i, e, g, kind),
                   f'{name}_smooth': hapke.reflectance(i, e, g, kind, albedo=1.9, theta_deg=0.0),
                   f'{name}_albedo': [hapke.normal_albedo(kind),
                                      hapke.hemispherical_albedo(kind)]}
    unchanged(SINGLE, **arrays)


def test_shadows_of_relief(unchanged: Unchanged) -> None:
    """By how much the sun stands above what limits it, on three nested levels and above them."""
    points = np.random.default_rng(2).uniform([-120.0, -120.0, 0.0], [120.0, 120.0, 24.0], (60, 3))
    arrays = {}
    for azimuth, elevation in SUNS:
        made = shadow_levels(hilly_levels(), sun_of(azimuth, elevation))
        for k, level in enumerate(made):
            arrays[f'level_{k}_{azimuth:g}'] = level.clearance()[0]
        arrays[f'points_{azimuth:g}'] = made[2].clearance_of(points)[0]
    unchanged(SINGLE, **arrays)


def test_shadows_of_rocks(unchanged: Unchanged) -> None:
    """On a slope and beyond its border, and the share of coarse cells that they shade."""
    ground = hills(91, 0.07, 0.08, 0.3)
    rocks = stones(ground, 17, 8, 1.3)
    arrays = {}
    for azimuth, elevation in SUNS:
        sun = sun_of(azimuth, elevation)
        made = rock_shadow.silhouettes(rocks, shapes.library(), sun)
        clearance, occluder = ShadowLevel(ground, sun, None).clearance()
        rock_shadow.stamp(clearance, occluder, ground, made, sun)
        arrays |= {f'angle_{azimuth:g}': clearance / occluder,
                   f'shaded_{azimuth:g}': [np.mean(clearance < 0.0)],
                   f'share_{azimuth:g}': rock_shadow.share(hills(41, 0.3, 0.1, 0.3), made, sun,
                                                           0.0),
                   f'width_{azimuth:g}': made.half_width, f'top_{azimuth:g}': made.top}
    unchanged(SHADOW, **arrays)


def test_light_of_a_small_world(unchanged: Unchanged) -> None:
    """Sun, scattered light and far rocks, for three suns."""
    world = stony_world(count=21)
    far = stones(world.levels[1], 19, 2, 0.99)
    xy = np.random.default_rng(4).uniform(-110.0, 110.0, (50, 2)) * np.geomspace(
        0.01, 1.0, 50)[:, None]
    arrays = {}
    for azimuth, elevation, indirect in ((63.0, 4.0, True), (200.0, 19.0, True),
                                         (300.0, 1.0, False)):
        light = Sunlight(world, SunConfig(azimuth_deg=azimuth, elevation_deg=elevation,
                                          angular_diameter_deg=0.7),
                         ReflectanceConfig('mare', 'rock', 1.3),
                         sun_direction(azimuth, elevation), indirect, far)
        name = f'{azimuth:g}'
        arrays |= {f'share_{name}': light.rock_share[0],
                   f'around_{name}': light.surroundings_at(xy),
                   f'rocks_{name}': light.rock_light(),
                   f'horizon_{name}': light.angle_above_horizon(
                       np.column_stack([xy, np.full(50, 0.4)]))}
        for k, pair in enumerate(light.scattered):
            arrays[f'scattered_{k}_{name}'] = np.stack(list(pair))
    unchanged(SHADOW, **arrays)


def test_sun_and_earth_over_three_sites(unchanged: Unchanged) -> None:
    # Past dates: leap seconds to come are unknown.
    dates = np.array(['1972-01-01T00:00:00', '1981-07-03T11:12:13', '2009-03-20T05:06:07',
                      '2023-05-06T07:08:09'], 'datetime64[us]')
    arrays = {}
    for k, site in enumerate((MoonPlace(0.0, 0.0), MoonPlace(23.4, -71.0, 35.0),
                              MoonPlace(-140.0, 88.5, -170.0))):
        seen = sky(site, dates)
        for name, body in (('sun', seen.sun), ('earth', seen.earth)):
            arrays |= {f'{name}_azimuth_{k}': body.azimuth_deg,
                       f'{name}_elevation_{k}': body.elevation_deg}
    unchanged(DOUBLE, **arrays)


def test_sensors_of_light(unchanged: Unchanged) -> None:
    """Sun sensor, star tracker and solar panel in many attitudes; what a place sees of the sun."""
    attitudes = [matrix_from_wxyz(wxyz_from_rpy(*rpy)) for rpy in np.random.default_rng(6).uniform(
        -0.6, 0.6, (30, 3)) * [1.0, 1.0, 5.0]]
    suns = [SeenSun(sun_direction(37.0 * k, 7.0 * (k % 9)), 0.4 + 0.02 * k) for k in range(30)]
    heads = SunHeads(SunSensorConfig(), np.random.default_rng(7))
    stars = StarCamera(StarTrackerConfig(), np.random.default_rng(8))
    panel = SolarPanelConfig(normal=(0.3, -0.2, 2.0), area_m2=0.2)
    seen = [heads.measure(sun, turn) for sun, turn in zip(suns, attitudes)]
    turned = [stars.measure(turn, np.array([0.0, 0.003 * k, 0.01]), sun if k % 3 else None, None)
              for k, (turn, sun) in enumerate(zip(attitudes, suns))]
    view = SunView(stony_world(), SunConfig(azimuth_deg=118.0, elevation_deg=1.2,
                                            angular_diameter_deg=0.6))
    places = [view.seen_from(np.array(place), lambda point, rays: rays @ [0.3, -0.5, 0.8] > -0.4)
              for place in ((0.0, 0.0, 0.2), (-30.0, 60.0, 3.0), (102.0, 0.3, 40.0))]
    unchanged(DOUBLE, sun=[np.full(3, np.nan) if one is None else one for one in seen],
              stars=[np.full((3, 3), np.nan) if one is None else one for one in turned],
              covariance=stars.covariance_rad2(attitudes[3]),
              power=[solar_power_w(panel, sun, 1300.0, turn)
                     for sun, turn in zip(suns, attitudes)],
              view=[[np.nan] * 4 if one is None else [*one.direction, one.share]
                    for one in places])
