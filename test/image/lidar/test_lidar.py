"""Patterns, motion and scans."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import make_world, ROVER
import pytest
from ray_scene import RayScene
import worlds

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.image.lidar.beam_pattern import beam_pattern
from lunar_rover_sim.image.lidar.lidar import Lidar
from lunar_rover_sim.image.lidar.motion import ScanMotion
from lunar_rover_sim.image.lidar.optics import FLASH, LidarConfig, LidarOptics, TOFCAM635, VLP16
from lunar_rover_sim.image.lidar.ray_caster import GROUND, NOTHING
from lunar_rover_sim.image.lidar.ray_caster import ROVER as OWN
from lunar_rover_sim.rover.pose import RoverPose

QUIET = LidarConfig(noise=False)


def flat(n=401, cell_m=0.025):
    """Return a plane without rocks, near or far."""
    config = WorldConfig.from_mapping({'rocks': {'abundance': 0.0}})
    return dataclasses.replace(make_world(np.zeros((n, n)), cell_m), config=config)


def at(x=0.0, y=0.0, z=0.1, rpy=(0.0, 0.0, 0.0), **motion):
    return RoverPose(se3(matrix_from_wxyz(wxyz_from_rpy(*rpy)), [x, y, z]), **motion)


def test_times_of_the_puck():
    """The manual: 2.304 us from beam to beam, 55.296 us from column to column."""
    pattern = beam_pattern(VLP16, 10.0)
    assert (pattern.columns, pattern.rings) == (1808, 16)
    assert np.allclose(np.diff(pattern.time_s)[:15], 2.304e-6)
    assert np.isclose(pattern.time_s[16], 55.296e-6) and pattern.time_s[-1] < 0.1
    assert np.allclose(np.degrees(pattern.elevation_rad), np.arange(-15.0, 16.0, 2.0))
    # The second beam that is fired is that at 1 deg: ring 8.
    assert list(pattern.ring[:4]) == [0, 8, 1, 9]
    assert np.allclose(np.degrees(np.arcsin(pattern.direction[:2, 2])), [-15.0, 1.0])
    step = np.degrees(np.diff(pattern.azimuth_rad))
    assert np.allclose(step, 360.0 * 10.0 * 55.296e-6)
    assert beam_pattern(VLP16, 20.0).columns == 904


def test_pixels_of_the_flash_camera():
    pattern = beam_pattern(TOFCAM635, 10.0)
    assert len(pattern) == 160 * 60 and not pattern.time_s.any()
    rays = pattern.direction.reshape(160, 60, 3)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1.0)
    # The corners of a lens without distortion.
    assert np.allclose(rays[-1, :, 1] / rays[-1, :, 0], np.tan(np.radians(25.0)))
    assert np.allclose(rays[:, -1, 2] / rays[:, -1, 0], np.tan(np.radians(9.5)))


def test_tilted_flash_camera():
    optics = LidarOptics(kind=FLASH, vertical_low_deg=-40.0, vertical_high_deg=-20.0, beams=21,
                         columns=31, horizontal_deg=40.0, most_rate_hz=50.0)
    elevation = np.degrees(beam_pattern(optics, 10.0).elevation_rad)
    assert np.allclose(elevation[[0, 10, -1]], [-40.0, -30.0, -20.0])


@pytest.fixture(scope='module')
def plane_lidar():
    return Lidar(flat(801, 0.05), ROVER, QUIET)


def test_points_lie_on_the_plane(plane_lidar):
    """In the frame of the sensor, 0.34 m over flat ground, level."""
    cloud = plane_lidar.scan(at()).cloud()
    assert len(cloud) > 10_000
    # Ranges are float32, and cells are met to 1e-5 m.
    assert np.allclose(cloud['z'], -0.34, atol=2e-5)
    assert cloud['ring'].max() == 7 and (np.diff(cloud['time']) > 0.0).all()


def test_motion_skews_points_and_deskewing_undoes_it(plane_lidar):
    """A twist of 0.2 m/s and 0.5 rad/s of yaw, at rest in the middle of the cloud."""
    state = at(linear_velocity_mps=np.array([0.2, 0.0, 0.0]),
               angular_velocity_radps=np.array([0.0, 0.3, 0.5]))
    scan = plane_lidar.scan(state)
    raw, still = scan.cloud(), scan.cloud(deskewed=True)
    # A point that was measured at t lies where the sensor then was: by the twist of its mount.
    t = raw['time'].astype(float)
    place = np.stack([raw[k] for k in 'xyz'], axis=-1).astype(float)
    mount = np.array(ROVER.lidar.position_m)
    rate, velocity = np.array([0.0, 0.3, 0.5]), np.array([0.2, 0.0, 0.0])
    expected = np.empty_like(place)
    for i in range(0, len(t), 500):
        R = matrix_from_wxyz(np.append(
            np.cos(0.5 * t[i] * np.linalg.norm(rate)),
            np.sin(0.5 * t[i] * np.linalg.norm(rate)) * rate / np.linalg.norm(rate)))
        # The way of the body, in its axes at the start: the integral of R(s) v.
        steps = np.linspace(0.0, t[i], 200)
        way = np.mean([_turn(rate * s) @ velocity for s in steps], axis=0) * t[i]
        expected[i] = way + R @ (place[i] + mount) - mount
        deskewed = np.array([still[k][i] for k in 'xyz'])
        assert np.abs(deskewed - expected[i]).max() < 2e-4 + 2e-5 * np.linalg.norm(place[i])
    moved = np.stack([still[k] - raw[k] for k in 'xyz'], axis=-1)
    assert np.abs(moved[-16:]).max() > 0.02     # 0.1 s later
    # De-skewed points lie on the ground, which is a plane in the frame of the start.
    assert np.abs(still['z'] + 0.34).max() < 2e-3
    assert np.abs(raw['z'] + 0.34).max() > 0.05


def _turn(vector):
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    return matrix_from_wxyz(np.append(np.cos(0.5 * angle), np.sin(0.5 * angle) * vector / angle))


def test_motion_passes_through_its_poses():
    poses = [at(x=0.1 * k, rpy=(0.0, 0.02 * k, 0.3 * k)).T_world_base for k in range(5)]
    motion = ScanMotion([0.0, 0.025, 0.05, 0.075, 0.1], poses)
    R, p = motion.at(np.array([0.0, 0.05, 0.1, 0.0625]))
    assert np.allclose(R[:3], [poses[0][:3, :3], poses[2][:3, :3], poses[4][:3, :3]])
    assert np.allclose(p[:, 0], [0.0, 0.2, 0.4, 0.25])


def test_true_ranges_do_not_depend_on_noise(plane_lidar):
    truth = plane_lidar.true_hits(at().T_world_base)
    measured = plane_lidar.scan(at()).returns.range_m
    seen = np.isfinite(measured)
    assert np.allclose(truth.distance_m[seen], measured[seen], rtol=1e-6)


# Returns


def test_scans_repeat_and_differ():
    lidar = Lidar(flat(), ROVER, LidarConfig())
    first, again, other = (lidar.scan(at(), index).returns.range_m for index in (4, 4, 5))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)


# Clouds and planar scans


def test_organized_cloud(plane_lidar):
    scan = plane_lidar.scan(at())
    rows, flat = scan.cloud(organized=True), scan.cloud()
    assert rows.shape == (16, 1808)
    assert np.array_equal(rows['ring'], np.tile(np.arange(16)[:, None], 1808))
    assert (np.isfinite(rows['x']).sum() == len(flat)) and flat.dtype.itemsize == 22
    assert (np.diff(rows['time'], axis=1) > 0.0).all()


def test_planar_scan(plane_lidar):
    scan = plane_lidar.scan(at())
    planar = scan.planar(0)     # at -15 deg
    assert np.allclose(planar.range_m, 0.34 / np.tan(np.radians(15.0)), atol=1e-4)
    last = planar.angle_min_rad + planar.angle_step_rad * (len(planar.range_m) - 1)
    assert -np.pi <= planar.angle_min_rad < -3.1 and 3.1 < last <= np.pi
    assert np.isclose(planar.time_step_s, 55.296e-6)
    assert np.isinf(scan.planar(15).range_m).all()      # it looks up


def test_planar_scan_of_a_flash_camera():
    """The camera looks 12 deg down; each angle shows the column nearest to it."""
    rover = dataclasses.replace(ROVER, lidar=dataclasses.replace(
        ROVER.lidar, rpy_deg=(0.0, 12.0, 0.0), position_m=(0.2, 0.0, 0.24)))
    lidar = Lidar(flat(), rover, LidarConfig(part='espros_tofcam635', noise=False))
    planar = lidar.scan(at()).planar(20)
    assert np.isclose(planar.angle_min_rad, -np.radians(25.0), atol=1e-2)
    seen = planar.range_m[np.isfinite(planar.range_m)]
    assert len(seen) == 160 and 1.0 < seen.min() < seen.max() < 2.5 and planar.time_step_s == 0.0


def test_the_body_hides_beams():
    low = dataclasses.replace(ROVER, lidar=dataclasses.replace(ROVER.lidar,
                                                               position_m=(0.0, 0.0, 0.1)))
    scan = Lidar(flat(), low, QUIET).scan(at())
    rows = scan.cloud(organized=True)
    ahead = np.abs(scan.pattern.azimuth_rad) < np.arctan(0.008 / 0.12)
    assert np.isnan(rows['x'][:7, ahead]).all()     # the mast
    assert np.isfinite(rows['x'][1:7, ~ahead]).mean() > 0.5
    inside = dataclasses.replace(ROVER, lidar=dataclasses.replace(ROVER.lidar,
                                                                  position_m=(0.0, 0.0, 0.0)))
    with pytest.raises(ConfigError, match='lidar.position_m: .* outside chassis and mast'):
        Lidar(flat(), inside, QUIET)


def test_off_the_ground():
    lidar = Lidar(worlds.small(**worlds.BARE), ROVER, QUIET)
    with pytest.raises(ConfigError, match=r'at \(7.12, 0.00\) m .* within 6.4 m of the origin'):
        lidar.scan(at(x=7.0))


# On an arm to the left: it looks at side and deck of the body, at legs and ground.
LOW = dataclasses.replace(ROVER, lidar=dataclasses.replace(
    ROVER.lidar, position_m=(0.02, 0.2, 0.1), rpy_deg=(3.0, -4.0, 10.0)))
OPTICS = LidarOptics(beams=40, vertical_low_deg=-85.0, vertical_high_deg=15.0,
                     columns_per_s=9000.0, min_range_m=0.02, max_range_m=30.0, firing_s=1e-6)
STATE = RoverPose(se3(matrix_from_wxyz(wxyz_from_rpy(0.05, -0.08, 0.6)), [0.0, 0.0, 0.08]),
                  np.array([0.2, 1.1, -0.7, 2.0]))


def lidar(own_body: str, rover=LOW) -> Lidar:
    return Lidar(flat(), rover, LidarConfig(part='own', own=OPTICS, noise=False,
                                            own_body=own_body))


@pytest.fixture(scope='module')
def seen():
    """Return what MuJoCo's rays meet of the rover: distances, inf for none, and normals; links."""
    rays = RayScene(flat(33, 0.1), LOW)
    model = rays.rover
    base = np.array([model.body(body).name == 'base_link' for body in model.geom_bodyid])
    model.geom_group[~base & (model.geom_group == 2)] = 4   # drawn legs: their geoms collide
    rays.place(STATE)
    sensor = lidar('end')
    T = STATE.T_world_base @ sensor.T_base_lidar
    along = sensor.pattern.direction @ T[:3, :3].T
    distance, normal = np.empty(len(along)), np.empty(3 * len(along))
    geom = np.empty(len(along), np.int32)
    mujoco.mj_multiRay(model, rays.data, T[:3, 3], along.ravel(), np.array([0, 1, 1, 0, 0, 0],
                       np.uint8), True, -1, geom, distance, normal, len(along), 1e10)
    met = distance >= 0.0
    return (T, along, np.where(met, distance, np.inf), normal.reshape(-1, 3),
            met & ~base[np.maximum(geom, 0)])


def test_beams_end_where_rays_meet_the_rover(seen):
    """Within 1 mm, on body and legs, unless the ground is nearer."""
    T, along, distance, normal, on_leg = seen
    with np.errstate(divide='ignore'):
        ground = np.where(along[:, 2] < 0.0, -T[2, 3] / along[:, 2], np.inf)
    hits = lidar('end').true_hits(STATE.T_world_base, STATE.joint_angle_rad)
    own = distance < ground
    assert (own & on_leg).sum() > 300 and (own & ~on_leg).sum() > 3000
    # At an edge rounding decides.
    same = (hits.target == OWN) == own
    assert same.mean() > 0.9999
    both = own & (hits.target == OWN)
    assert np.abs(hits.distance_m[both] - distance[both]).max() < 1e-3
    assert (np.sum(hits.normal * normal, axis=1)[both] > 0.999).mean() > 0.999
    assert (hits.target == GROUND)[~own & (ground < 2.0) & same].all()


def test_they_return_nothing_by_default(seen):
    """The beams are those that would end on it; all others are untouched."""
    end, drop = (lidar(kind).scan(STATE).returns for kind in ('end', 'drop'))
    hits = lidar('end').true_hits(STATE.T_world_base, STATE.joint_angle_rad)
    own = hits.target == OWN
    assert np.isnan(drop.range_m[own]).all()
    assert np.array_equal(drop.range_m[~own], end.range_m[~own], equal_nan=True)
    assert np.allclose(end.range_m[own], hits.distance_m[own], atol=1e-5)
    # A diffuse surface of 40 %: less at oblique incidence.
    assert 39.0 < np.nanmax(end.intensity[own]) <= 40.0
    hidden = lidar('drop').true_hits(STATE.T_world_base, STATE.joint_angle_rad)
    assert (hidden.target[own] == NOTHING).all()


def test_legs_turn_during_a_scan():
    """Each column meets the legs as they are at its time; unknown angles hide nothing."""
    sensor = lidar('end')
    times = np.linspace(0.0, 0.1, 21)
    poses = [STATE.T_world_base] * len(times)
    turning = STATE.joint_angle_rad + 20.0 * times[:, None]
    scan = sensor.scan(ScanMotion(times, poses, turning)).returns.range_m.reshape(-1, 40)
    for column in (100, 450, 700):
        angles = STATE.joint_angle_rad + 20.0 * sensor.pattern.column_s[column]
        still = sensor.true_hits(STATE.T_world_base, angles).distance_m.reshape(-1, 40)[column]
        np.testing.assert_allclose(scan[column], np.where(np.isfinite(still), still, np.nan),
                                   atol=1e-4)
    without = sensor.scan(ScanMotion(times, poses)).returns.range_m.reshape(-1, 40)
    assert (np.abs(without - scan) > 0.01).sum() > 100
