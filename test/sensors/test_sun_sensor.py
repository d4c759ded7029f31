"""What a place sees of the sun, and what sun sensor and star tracker make of it."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import make_world, ROVER, STATE_S, step_world, sun_seen
import pytest
from scipy.spatial.transform import Rotation
import worlds

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.illumination.config import SunConfig, SunSiteConfig
from lunar_rover_sim.image.illumination.sun_of_date import earth_of_date
from lunar_rover_sim.image.illumination.sun_view import SeenSun, SunView
from lunar_rover_sim.rover.physics.config import PhysicsConfig, StartPose
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig
from lunar_rover_sim.sensors.registry import mounted, SensorsConfig
from lunar_rover_sim.sensors.sensor import Platform
from lunar_rover_sim.sensors.solar_panel import SolarPanelConfig
from lunar_rover_sim.sensors.star_tracker import StarCamera, StarTrackerConfig
from lunar_rover_sim.sensors.sun_from_rover import SkyRays
from lunar_rover_sim.sensors.sun_sensor import SunHeads, SunSensorConfig

EVERYTHING_CLEAR = (lambda point, rays: np.ones(len(rays), bool))
ALL = SunSensorConfig()


def seen(azimuth_deg, elevation_deg):
    return SeenSun(sun_direction(azimuth_deg, elevation_deg), 1.0)


def angle_deg(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def wall_world(height_m):
    """A flat square of 10 m; 50 m east begins a plateau."""
    near, far = np.zeros((401, 401)), np.zeros((201, 201))
    far[:, 150:] = height_m
    world = make_world(near)
    return dataclasses.replace(world, levels=(world.ground,
                                              HeightGrid(far.astype(np.float32), 1.0)))


@pytest.mark.parametrize('offset, share', [(-0.6, 1.0), (0.0, 0.5), (0.6, 0.0), (0.2019, 0.25)])
def test_the_horizon_cuts_the_disc(offset, share):
    """Shares of a disc of 0.5 deg: a quarter lies beyond 0.404 of its radius from the middle."""
    elevation = np.degrees(np.arctan(5.0 / 50.0)) - 0.5 * 0.5 * offset / 0.5
    view = SunView(wall_world(5.0), SunConfig(azimuth_deg=0.0, elevation_deg=elevation,
                                              angular_diameter_deg=0.5))
    sun = view.seen_from(np.zeros(3), EVERYTHING_CLEAR)
    assert (sun.share if sun else 0.0) == pytest.approx(share, abs=0.08)
    if 0.0 < share < 1.0:
        assert np.degrees(np.arcsin(sun.direction[2])) > elevation + 0.02


@pytest.mark.parametrize('place, azimuth_deg', [((0.0, 4.9), 90.0), ((0.0, -4.9), -90.0),
                                                ((4.9, 0.0), 0.0), ((-4.9, 0.0), 180.0)])
def test_the_horizon_begins_where_the_fine_ground_ends(place, azimuth_deg):
    """A bank around it, 1 m away from its rim, hides the sun there."""
    far = np.zeros((201, 201), np.float32)
    far[94:107, 94:107] = 0.5
    far[95:106, 95:106] = 0.0
    world = make_world()
    world = dataclasses.replace(world, levels=(world.ground, HeightGrid(far, 1.0)))
    view = SunView(world, SunConfig(azimuth_deg=azimuth_deg, elevation_deg=10.0))
    assert view.seen_from(np.array([*place, 0.0]), EVERYTHING_CLEAR) is None
    assert view.seen_from(np.zeros(3), EVERYTHING_CLEAR).share == 1.0


def test_other_directions_are_free():
    view = SunView(wall_world(50.0), SunConfig(azimuth_deg=180.0, elevation_deg=3.0))
    assert view.seen_from(np.zeros(3), EVERYTHING_CLEAR).share == 1.0
    view = SunView(wall_world(50.0), SunConfig(elevation_deg=3.0, irradiance=0.0))
    assert view.seen_from(np.zeros(3), EVERYTHING_CLEAR) is None


def test_ground_and_rover_cast_their_shadows():
    """A step of 1 m, 2 m east of the rover, hides a sun below 26 deg; the mast hides it ahead."""
    world = step_world()
    with Simulation(world, ROVER, PhysicsConfig(start=StartPose(yaw_deg=180.0))) as simulation:
        def share(azimuth_deg, elevation_deg, position_m):
            sun = sun_seen(simulation, world, position_m, azimuth_deg, elevation_deg)
            return sun.share if sun else 0.0

        deck, behind_mast = np.array([-0.1, 0.0, 0.06]), np.array([0.08, 0.0, 0.1])
        assert share(0.0, 20.0, deck) == 0.0 and share(0.0, 28.0, deck) == 1.0
        assert share(90.0, 10.0, deck) == 1.0
        assert share(180.0, 3.0, behind_mast) == 0.0
        # Inside the chassis nothing is seen.
        assert share(90.0, 10.0, np.zeros(3)) == 0.0


def test_rays_to_the_sky_hit_what_mujoco_hits():
    """Ground, rocks and rover, near to the horizon, from places around a rover that is tilted."""
    world, geom = worlds.small(rocks={'abundance': 0.1}), np.zeros(1, np.int32)
    rng, different, hit = np.random.default_rng(5), 0, 0
    with Simulation(world, ROVER, PhysicsConfig()) as simulation:
        sky, x, y = SkyRays(simulation), *simulation.state.position_m[:2]
        for k in range(20):
            place = np.array([*(x, y) + rng.uniform(-2.0, 2.0, 2), 0.0])
            place[2] = world.height_at(place[:2]) + rng.uniform(0.05, 0.3)
            azimuth, elevation = rng.uniform(0.0, 360.0, 30), rng.uniform(-2.0, 25.0, 30)
            rays = np.array([sun_direction(a, e) for a, e in zip(azimuth, elevation)])
            if k % 2:       # towards the rover
                rays[0] = simulation.state.position_m - place
                rays[0] /= np.linalg.norm(rays[0])
            free = sky.reached(place, rays)
            expected = np.array([mujoco.mj_ray(simulation.model, simulation.data, place, ray, None,
                                               1, -1, geom) < 0.0 for ray in rays])
            different += int((free != expected).sum())
            hit += int((~expected).sum())
    # One that grazes an edge may round to the other side.
    assert different <= 1 and 60 < hit < 540


def test_a_true_sensor_measures_the_truth():
    turned = Rotation.from_euler('ZYX', [130.0, -10.0, 5.0], degrees=True).as_matrix()
    sensor = SunHeads(SunSensorConfig(enabled=False), np.random.default_rng(1))
    for azimuth in range(0, 360, 15):
        measured = sensor.measure(seen(azimuth, 6.0), turned)
        assert turned @ measured == pytest.approx(sun_direction(azimuth, 6.0), abs=1e-12)


def test_errors_of_the_sun_sensor_are_those_that_are_stated():
    """Over 600 parts, the sun before the head that looks ahead; half of the variance stays."""
    sun, errors = seen(0.0, ALL.heads_elevation_deg), []
    right, up = np.array([0.0, -1.0, 0.0]), sun_direction(0.0, ALL.heads_elevation_deg + 90.0)
    for seed in range(600):
        sensor = SunHeads(ALL, np.random.default_rng(seed))
        errors.append([np.array([right, up]) @ sensor.measure(sun, np.eye(3)) for _ in range(2)])
    errors = np.degrees(np.array(errors))
    np.testing.assert_allclose(errors[:, 0].std(axis=0), ALL.stddev_deg, rtol=0.12)
    assert np.abs(errors.mean(axis=(0, 1))).max() < 4.0 * ALL.stddev_deg / np.sqrt(600)
    assert np.corrcoef(errors[:, 0, 1], errors[:, 1, 1])[0, 1] == pytest.approx(0.5, abs=0.13)


@pytest.mark.parametrize('azimuth_deg, elevation_deg', [(84.0, 0.0), (-84.0, 0.0), (0.0, 84.0)])
def test_no_head_points_behind_itself(azimuth_deg, elevation_deg):
    """At the edge of a wide field errors of 5 deg lead past 90 deg, and stay errors of 5 deg."""
    sensor = SunHeads(SunSensorConfig(heads_yaw_deg=(0.0,), heads_elevation_deg=0.0, bias_deg=0.0,
                                      field_of_view_deg=170.0, noise_deg=5.0),
                      np.random.default_rng(1))
    sun = seen(azimuth_deg, elevation_deg)
    found = np.array([sensor.measure(sun, np.eye(3)) for _ in range(1000)])
    assert np.all(found[:, 0] > 0.0)
    assert max(angle_deg(one, sun.direction) for one in found) < 25.0


@pytest.mark.parametrize('yaw_deg', [0.0, 125.0, -40.0])
def test_a_head_sees_a_cone_about_where_it_looks(yaw_deg):
    """44 deg off its axis in any direction is seen, 46 deg is not; its errors are about it."""
    config = SunSensorConfig(heads_yaw_deg=(yaw_deg,), heads_elevation_deg=30.0,
                             field_of_view_deg=90.0, enabled=False)
    head = SunHeads(config, np.random.default_rng(1))
    axis = sun_direction(yaw_deg, 30.0)
    level = np.array([-np.sin(np.radians(yaw_deg)), np.cos(np.radians(yaw_deg)), 0.0])
    upward = np.cross(axis, level)
    for turn in np.arange(0.0, 2.0 * np.pi, 0.7):
        aside = np.cos(turn) * level + np.sin(turn) * upward
        for off_deg, sees in ((0.0, True), (44.0, True), (46.0, False), (134.0, False)):
            off = np.radians(off_deg)
            sun = SeenSun(np.cos(off) * axis + np.sin(off) * aside, 1.0)
            assert (head.measure(sun, np.eye(3)) is not None) == sees
    blurred = SunHeads(dataclasses.replace(config, enabled=True, bias_deg=0.0, noise_deg=2.0),
                       np.random.default_rng(2))
    found = np.array([blurred.measure(SeenSun(axis, 1.0), np.eye(3)) for _ in range(400)])
    for across in (level, upward):
        assert np.degrees(np.arctan2(found @ across, found @ axis)).std() == pytest.approx(
            2.0, rel=0.15)


@pytest.mark.parametrize('share,seen_by', [(0.49, False), (0.5, True)])
def test_a_head_is_silent_when_too_little_of_the_disc_is_seen(share, seen_by):
    sensor = SunHeads(ALL, np.random.default_rng(1))
    sun = dataclasses.replace(seen(0.0, 20.0), share=share)
    assert (sensor.measure(sun, np.eye(3)) is not None) == seen_by
    assert SunHeads(SunSensorConfig(heads_yaw_deg=()), np.random.default_rng(1)).measure(
        seen(0.0, 20.0), np.eye(3)) is None


def test_a_single_point_that_sees_no_ground_beyond_sees_all_of_a_low_sun():
    """A world that ends at the fine ground has no horizon beyond it."""
    world = make_world()
    view = SunView(world, SunConfig(azimuth_deg=20.0, elevation_deg=-0.1))
    assert view.seen_from(np.array([4.999, 4.999, 0.0]), EVERYTHING_CLEAR).share == 1.0


@pytest.mark.parametrize('elevation', [0.0, 6.0, 15.0, 60.0])
def test_the_heads_cover_the_sky_also_on_slopes(elevation):
    sensor = SunHeads(ALL, np.random.default_rng(1))
    for roll in (-20.0, 0.0, 20.0):
        turned = Rotation.from_euler('X', roll, degrees=True).as_matrix()
        for azimuth in range(0, 360, 30):
            assert sensor.measure(seen(azimuth, elevation), turned) is not None


def tracker(**values):
    return StarCamera(StarTrackerConfig(**values), np.random.default_rng(5))


STILL = np.zeros(3)


def test_errors_of_the_star_tracker_are_those_that_are_stated():
    """Over 1500 attitudes: the covariance is that of the errors, about the axes of the world."""
    truth = Rotation.from_euler('ZYX', [70.0, 8.0, -3.0], degrees=True).as_matrix()
    part = tracker(yaw_deg=30.0, elevation_deg=60.0)
    errors = np.array([Rotation.from_matrix(part.measure(truth, STILL, None, None)
                                            @ truth.T).as_rotvec() for _ in range(1500)])
    stated = part.covariance_rad2(truth)
    arcsec = np.pi / 180.0 / 3600.0
    assert np.sqrt(np.linalg.eigvalsh(stated)) / arcsec == pytest.approx([5.0, 5.0, 55.0])
    consistency = np.einsum('ni,ij,nj->n', errors, np.linalg.inv(stated), errors).mean() / 3.0
    assert consistency == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 3.0 / 1500))
    sight = truth @ sun_direction(30.0, 60.0)
    assert (errors @ sight).std() / arcsec == pytest.approx(55.0, rel=0.08)


@pytest.mark.parametrize('rate_degps, sun, earth, tilt_deg, blind', [
    (0.0, None, None, 0.0, False),
    (2.9, None, None, 0.0, False),
    (3.1, None, None, 0.0, True),       # the stars smear
    (0.0, (0.0, 55.0), None, 0.0, False),   # 35 deg from the zenith
    (0.0, (0.0, 57.0), None, 0.0, True),
    (0.0, None, (90.0, 64.0), 0.0, False),
    (0.0, None, (90.0, 66.0), 0.0, True),
    (0.0, None, None, 64.0, False),
    (0.0, None, None, 66.0, True),      # the ground is bright
])
def test_where_the_star_tracker_is_blind(rate_degps, sun, earth, tilt_deg, blind):
    turned = Rotation.from_euler('X', tilt_deg, degrees=True).as_matrix()
    measured = tracker(elevation_deg=90.0).measure(
        turned, np.array([0.0, np.radians(rate_degps), 0.0]), seen(*sun) if sun else None,
        sun_direction(*earth) if earth else None)
    assert (measured is None) == blind


def test_a_true_star_tracker():
    truth = Rotation.from_euler('Z', 40.0, degrees=True).as_matrix()
    part = tracker(enabled=False)
    assert part.measure(truth, STILL, None, None).tolist() == truth.tolist()
    assert not part.covariance_rad2(truth).any()


def test_the_earth_of_a_date():
    """Near the middle of the near side it stands near the zenith, on the far side nowhere."""
    near, far = (earth_of_date(SunConfig(date='2026-11-22T06:00:00Z', site=SunSiteConfig(
        source='given', lon_deg=lon, lat_deg=0.5))) for lon in (0.5, 180.0))
    assert angle_deg(near, np.array([0.0, 0.0, 1.0])) < 12.0
    assert far is None and earth_of_date(SunConfig()) is None


def test_mounted_sensors_measure_at_their_places():
    """On a rover at any attitude: the truth, while no errors are asked for."""
    turn = Rotation.from_euler('ZYX', [70.0, 10.0, -15.0], degrees=True)
    off = {'enabled': False}
    world = make_world()
    with Simulation(world, ROVER, PhysicsConfig()) as simulation:
        behind = simulation.state.position_m + (-1.0, 0.0, 0.02)
        ahead = behind + (2.0, 0.0, 0.0)
        state = dataclasses.replace(
            simulation.state, position_m=np.array([0.3, -0.2, 0.5]),
            orientation_wxyz=np.roll(turn.as_quat(), 1),
            motor_torque_nm=np.array([0.1, 0.2, 0.3, -0.1]),
            joint_velocity_radps=np.array([1.0, 2.0, 3.0, 4.0]))
        # These places are where the chassis casts its shadow, and on the side of the sun.
        places = [tuple(turn.inv().apply(place - state.position_m)) for place in (behind, ahead)]
        platform = Platform(simulation, SunConfig(
            azimuth_deg=0.0, elevation_deg=0.3, angular_diameter_deg=0.1), 7, STATE_S)
        for place in places:
            sensors = {one.name: one for one in mounted(SensorsConfig(
                sun_sensor=SunSensorConfig(**off, position_m=place, rate_hz=10),
                star_tracker=StarTrackerConfig(**off, position_m=place),
                power_monitor=PowerMonitorConfig(**off),
                solar_panel=SolarPanelConfig(position_m=place, normal=(0.0, -1.0, 0.0))),
                platform)}
            shown = {topic: value for sensor in sensors.values()
                     for topic, value in sensor.measure(state, 0).items()}
            due = [ns for ns in range(0, 300_000_001, 5_000_000)
                   if sensors['sun_sensor'].is_due(ns)]
            assert due == [0, 100_000_000, 200_000_000, 300_000_000]
            assert all(sensors['power_monitor'].is_due(ns) for ns in (0, 5_000_000))
            sun = turn.inv().apply(sun_direction(0.0, 0.3))
            assert ('sun_sensor/direction' in shown) == (place is places[1])
            solar = shown['power/solar']
            watts = solar.voltage_v * solar.current_a
            assert solar.gives and solar.voltage_v == ROVER.motor.supply_voltage_v
            if place is places[1]:
                np.testing.assert_allclose(shown['sun_sensor/direction'].xyz, sun, atol=1e-4)
                panel = SolarPanelConfig()
                assert -sun[1] > 0.5
                assert watts == pytest.approx(
                    -sun[1] * SunConfig().irradiance * panel.area_m2 * panel.efficiency, rel=1e-3)
            else:
                assert watts == 0.0
            np.testing.assert_allclose(shown['star_tracker/attitude'].R_world_base,
                                       turn.as_matrix(), atol=1e-12)
            lines = [shown[topic] for topic in shown if topic.startswith('power/')
                     and topic != 'power/solar']
            assert [line.line for line in lines][-1] not in ROVER.legs.names
            assert [line.line for line in lines][:4] == list(ROVER.legs.names)
            currents = np.array([line.current_a for line in lines])
            assert np.all(currents[:3] < 0.0) and currents[-1] == pytest.approx(currents[:4].sum())
        # The other way round, the sun is on the other side.
        platform.sun.follow(SunConfig(azimuth_deg=180.0, elevation_deg=0.3,
                                      angular_diameter_deg=0.1))
        assert 'sun_sensor/direction' not in sensors['sun_sensor'].measure(state, 0)
