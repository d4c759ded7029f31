"""A rock is one thing: legs, LiDAR and camera meet the same surface.

The reference is a ray cast of the triangles of the rocks, written here.
"""

import dataclasses

import camera_scene as scene
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import matrix_from_wxyz
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.ground.world.shapes import library
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls
from lunar_rover_sim.image.lidar.ray_caster import RayCaster
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.pose import RoverPose

COUNT, AT_A_TIME, APART_M = 100, 10, 12.0
MOST_M, TO_M = 0.005, 5.0


def field():
    """Return a plane with groups of ten turned rocks, of 0.1 to 1.6 m, up to 5 m east of eyes."""
    rng = np.random.default_rng(7)
    k = np.arange(COUNT)
    size = np.geomspace(0.1, 1.6, COUNT)
    away = 0.6 + size + rng.uniform(0.0, 1.0, COUNT) * (4.2 - 1.6 * size)
    place = np.stack([away, rng.uniform(-0.35, 0.35, COUNT) * away, rng.uniform(0.0, 0.3) * size],
                     axis=-1)
    eye = np.stack([k // AT_A_TIME % 3 - 1.0, k // AT_A_TIME // 3 - 1.5, 0.0 * k], axis=-1)
    stones = Rocks((k % len(library())).astype(np.int32), k.astype(np.int32),
                   place + APART_M * eye, Rotation.random(COUNT, rng).as_quat()[:, [3, 0, 1, 2]],
                   np.ones(COUNT, np.float32), size)
    world = dataclasses.replace(scene.plane(n=1025, cell_m=0.05, stones=stones),
                                rock_shapes=library())
    return world, APART_M * eye[::AT_A_TIME]


def first_hits(world, origin, direction):
    """Return (n,) distances at which rays meet the plane or triangles of rocks, inf if none."""
    with np.errstate(divide='ignore'):
        found = np.where(direction[:, 2] < 0.0, -origin[2] / direction[:, 2], np.inf)
    rocks = world.rocks
    for i, R in enumerate(matrix_from_wxyz(rocks.orientation_wxyz)):
        shape = world.rock_shapes[rocks.shape[i]]
        corners = (shape.vertices * rocks.diameter_m[i]) @ R.T + rocks.position_m[i]
        a, b, c = np.moveaxis(corners[shape.faces], 1, 0)
        middle = rocks.position_m[i] - origin
        along = direction @ middle / np.linalg.norm(direction, axis=1)
        near = np.flatnonzero((along > 0.0) & (middle @ middle - along**2
                                               < rocks.diameter_m[i]**2))
        # Moeller and Trumbore (1997), front faces only.
        across = np.cross(direction[near, None], c - a)
        det = np.einsum('rfi,fi->rf', across, b - a)
        with np.errstate(divide='ignore', invalid='ignore'):
            u = np.einsum('rfi,fi->rf', across, origin - a) / det
            q = np.cross(origin - a, b - a)
            v = np.einsum('ri,fi->rf', direction[near], q) / det
            t = np.einsum('fi,fi->f', c - a, q) / det
        hit = (det > 1e-12) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
        found[near] = np.minimum(found[near], np.where(hit, t, np.inf).min(axis=1))
    return found


@pytest.fixture(scope='module')
def apart():
    """Return distances [m] of camera, LiDAR and legs from the reference, and rocks seen."""
    world, eyes = field()
    hulls = RockHulls(world.rocks, world.rock_shapes)
    caster = RayCaster([HeightPyramid(world.ground, hulls)], hulls)
    model = build_model(world, scene.ROVER, PhysicsConfig())
    data = mujoco.MjData(model)
    data.qpos[2] = 100.0            # the rover out of the way
    mujoco.mj_forward(model, data)
    result = {'camera': [], 'lidar': [], 'legs': []}
    seen = set()
    camera = CameraConfig(640, 480, 75.0)
    rng = np.random.default_rng(1)
    with Renderer(world, scene.ROVER, scene.config(15.0, 140.0, camera=camera)) as renderer:
        rays = renderer.rig.rays()
        for eye in eyes:
            pose = scene.pose(*eye[:2], z=0.5, pitch_deg=5.0)
            frame = renderer.render(RoverPose(pose), 0, ('depth', 'label'))
            view = pose @ renderer.rig.T_base_left
            rock = (frame.label >= LABEL_FIRST_ROCK) & (frame.depth_m < TO_M)
            seen |= set(np.unique(frame.label[rock]) - LABEL_FIRST_ROCK)
            pixels = np.concatenate([rng.choice(np.flatnonzero(rock & (frame.label == one)), 60)
                                     for one in np.unique(frame.label[rock])])
            direction = rays.reshape(-1, 3)[pixels] @ view[:3, :3].T
            length = np.linalg.norm(direction, axis=1)
            true_m = first_hits(world, view[:3, 3], direction) * length
            result['camera'].append(frame.depth_m.ravel()[pixels] * length - true_m)
            hits = caster.cast(np.tile(view[:3, 3], (len(pixels), 1)), direction / length[:, None],
                               20.0)
            result['lidar'].append(hits.distance_m - true_m)
            result['legs'].append([mujoco.mj_ray(
                model, data, view[:3, 3], ray, None, 1, -1, np.zeros(1, np.int32), None)
                for ray in direction / length[:, None]] - true_m)
    return {name: np.abs(np.concatenate(found)) for name, found in result.items()}, seen


@pytest.mark.parametrize('who', ['camera', 'lidar', 'legs'])
def test_all_meet_the_surface_of_the_rocks(apart, who):
    """Within 5 mm of the reference in 95 of 100 places, to 5 m; nearly all by far nearer."""
    found, seen = apart
    assert len(seen) > 0.8 * COUNT
    assert len(found[who]) > 3000
    assert np.quantile(found[who], 0.95) < MOST_M
    assert np.median(found[who]) < 1e-4
