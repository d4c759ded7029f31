"""Beams on the rover against ray casts of MuJoCo on its geoms and the meshes of its body."""

import dataclasses

import mujoco
import numpy as np
from physics_scene import make_world, ROVER
import pytest
from ray_scene import RayScene

from lunar_rover_sim.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.lidar.config import LidarConfig
from lunar_rover_sim.lidar.lidar import Lidar
from lunar_rover_sim.lidar.motion import ScanMotion
from lunar_rover_sim.lidar.optics import LidarOptics
from lunar_rover_sim.lidar.ray_caster import GROUND, NOTHING
from lunar_rover_sim.lidar.ray_caster import ROVER as OWN
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.world.config import WorldConfig

# On an arm to the left: it looks at side and deck of the body, at legs and ground.
LOW = dataclasses.replace(ROVER, lidar=dataclasses.replace(
    ROVER.lidar, position_m=(0.02, 0.2, 0.1), rpy_deg=(3.0, -4.0, 10.0)))
OPTICS = LidarOptics(beams=40, vertical_low_deg=-85.0, vertical_high_deg=15.0,
                     columns_per_s=9000.0, min_range_m=0.02, max_range_m=30.0, firing_s=1e-6)
STATE = RoverPose(se3(matrix_from_wxyz(wxyz_from_rpy(0.05, -0.08, 0.6)), [0.0, 0.0, 0.08]),
                  np.array([0.2, 1.1, -0.7, 2.0]))


def flat(n=201, cell_m=0.025):
    config = WorldConfig.from_mapping({'rocks': {'abundance': 0.0}})
    return dataclasses.replace(make_world(np.zeros((n, n)), cell_m), config=config)


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


def test_where_no_beam_meets_a_leg_none_is_looked_for():
    """The puck on the mast looks over its legs."""
    assert not Lidar(flat(101), ROVER, LidarConfig()).legs_met
    assert lidar('drop').legs_met
