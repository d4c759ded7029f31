"""Where the renderer draws things: depth, labels and normals against rays, grid and joints."""

import dataclasses

import camera_scene as scene
import mujoco
import numpy as np
import pytest
from rolling_scene import pose_on, rolling_world
from scipy.ndimage import map_coordinates
import worlds

from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.labels import (LABEL_FIRST_ROCK, LABEL_GROUND, LABEL_SKY,
                                                    rover_links)
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.model import build_model
from lunar_rover_sim.rover.pose import RoverPose

STILL = np.zeros(4)


@pytest.fixture(scope='module')
def world():
    return rolling_world()


@pytest.fixture(scope='module')
def renderer(world):
    config = RenderConfig(sun=scene.RELIEF_SUN)
    with Renderer(world, scene.ROVER, config) as renderer:
        yield renderer


def mujoco_model(world):
    """Return a MuJoCo model of the ground and the rocks of a synthetic world."""
    z, half = world.ground.heights_m, world.ground.half_extent_m
    low, span = float(z.min()), max(float(np.ptp(z)), 1e-3)
    spec = mujoco.MjSpec()
    spec.add_hfield(name='ground', nrow=z.shape[0], ncol=z.shape[1], size=[half, half, span, 1.0],
                    userdata=((z - low) / span).astype(float).ravel().tolist())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname='ground',
                            pos=[0.0, 0.0, low])
    shape = world.rock_shapes[0]
    size = np.abs(shape.vertices).max(axis=0)
    for position, diameter in zip(world.rocks.position_m, world.rocks.diameter_m):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size * diameter,
                                pos=position)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_depth_agrees_with_ray_casts(world, renderer):
    """10,000 random pixels within 10 m: median < 1 mm and 99 % < 1 cm, none left out."""
    model, data = mujoco_model(world)
    rng = np.random.default_rng(1)
    geom = np.zeros(1, np.int32)
    errors = []
    for x, y, yaw in ((0.0, 0.0, 0.0), (-3.0, 1.0, 30.0), (2.0, 2.0, 190.0), (0.0, -4.0, 100.0)):
        pose = pose_on(world, x, y, yaw)
        frame = renderer.render(RoverPose(pose), 0, ('depth',))
        camera = pose @ renderer.rig.T_base_left
        rays = renderer.rig.rays()
        for v, u in zip(rng.integers(0, 480, 5000), rng.integers(0, 640, 5000)):
            ray = rays[v, u]
            distance = mujoco.mj_ray(model, data, camera[:3, 3], camera[:3, :3] @ ray, None, 1,
                                     -1, geom, None)
            if 0.0 < distance < 10.0:  # in multiples of a ray with z = 1: depth itself
                errors.append(abs(frame.depth_m[v, u] - distance))
    errors = np.array(errors)
    assert len(errors) > 10000
    assert np.median(errors) < 1e-3
    assert np.quantile(errors, 0.99) < 1e-2


# These come next to the first use of `renderer`, whose relief is then still at hand.


def test_rows_of_the_pair_correspond(world):
    """A ground point has the same texture in both images; epipolar error < 0.05 px."""
    config = scene.config(sun=scene.RELIEF_SUN, detail=scene.DetailConfig(),
                          lens=LensConfig(ghost_share=0.0),     # which have no disparity
                          sensor=dataclasses.replace(scene.IDEAL, psf_sigma_px=0.5))
    with Renderer(world, scene.ROVER, config) as renderer:
        frame = renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left', 'right', 'depth'))
    focal, baseline = renderer.rig.focal_px, renderer.rig.baseline_m
    left, right = frame.left.astype(float), frame.right.astype(float)
    v, u = np.indices(left.shape)
    near = np.isfinite(frame.depth_m) & (frame.depth_m < 2.0) & (left > 25) & (left < 200) \
        & (u > 140)
    shift = focal * baseline / frame.depth_m
    best = []
    for dv in (-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2):
        there = map_coordinates(right, [v[near] + dv, (u - shift)[near]], order=3, mode='nearest')
        best.append(np.median(np.abs(there - left[near])))
    offsets = np.array([-0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2])
    a, b, _ = np.polyfit(offsets, best, 2)
    assert abs(-b / (2 * a)) < 0.05
    there = map_coordinates(right, [v[near], (u - shift)[near]], order=1, mode='nearest')
    assert np.corrcoef(there, left[near])[0, 1] > 0.97


def test_relief_below_the_grid_is_fixed_to_the_ground(world):
    """Frames 1 mm apart: with all detail on, each pixel keeps within what was around it."""
    config = scene.config(sun=scene.RELIEF_SUN, detail=scene.DetailConfig())
    with Renderer(world, scene.ROVER, config) as renderer:
        poses = [pose_on(world, 0.0, 0.0) for _ in range(2)]
        poses[1][0, 3] += 0.001
        a, b = (renderer.render(RoverPose(p), 0, ('radiance', 'depth')) for p in poses)
    from scipy.ndimage import maximum_filter, minimum_filter
    scale = np.quantile(a.radiance[np.isfinite(a.depth_m)], 0.9)
    low, high = minimum_filter(a.radiance, 3), maximum_filter(a.radiance, 3)
    beyond = np.maximum(low - b.radiance, b.radiance - high) / scale
    near = (a.depth_m > 1.0) & (a.depth_m < 30.0)       # at most 0.46 px of parallax
    assert (beyond[near] > 0.05).mean() < 5e-3
    # A line between two copies of the relief may move by a pixel.
    assert (beyond[near & (a.depth_m > 2.0)] > 0.1).mean() < 4e-4
    # Where the parallax is small the picture hardly changes at all.
    far = (a.depth_m > 4.0) & (a.depth_m < 30.0)
    assert np.corrcoef(a.radiance[far], b.radiance[far])[0, 1] > 0.99


def test_depth_is_that_of_the_world_of_physics():
    """The same of a built world in the model that is simulated."""
    built = worlds.small()
    model = build_model(built, scene.ROVER, PhysicsConfig())
    data = mujoco.MjData(model)
    data.qpos[2] = 100.0            # the rover out of the way
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(2)
    errors: dict[str, list[float]] = {'anywhere': [], 'on rocks': []}
    with Renderer(built, scene.ROVER, scene.config(12.0)) as renderer:
        for x, y, yaw in ((0.0, 0.0, 0.0), (2.0, -1.0, 150.0), (-2.0, 2.0, -60.0)):
            pose = pose_on(built, x, y, yaw)
            frame = renderer.render(RoverPose(pose), 0, ('depth', 'label'))
            camera = pose @ renderer.rig.T_base_left
            rays = renderer.rig.rays()
            rock = frame.label - LABEL_FIRST_ROCK
            rows, columns = np.nonzero((rock >= 0) & (rock < len(built.rocks)))
            pick = rng.integers(0, len(rows), 150)
            pixels = {'anywhere': (rng.integers(0, 480, 300), rng.integers(0, 640, 300)),
                      'on rocks': (rows[pick], columns[pick])}
            for name, (vs, us) in pixels.items():
                for v, u in zip(vs, us):
                    distance = mujoco.mj_ray(model, data, camera[:3, 3],
                                             camera[:3, :3] @ rays[v, u], None, 1, -1,
                                             np.zeros(1, np.int32), None)
                    if 0.0 < distance < 10.0:
                        errors[name].append(abs(frame.depth_m[v, u] - distance))
    assert min(len(found) for found in errors.values()) > 150
    assert np.median(errors['anywhere']) < 1e-3
    assert np.quantile(errors['anywhere'], 0.97) < 1e-2
    # Far ones of a few pixels are drawn simpler.
    assert np.median(errors['on rocks']) < 1e-3
    assert np.quantile(errors['on rocks'], 0.8) < 1e-2


def test_depth_of_a_plane_is_analytic():
    with Renderer(scene.plane(), scene.ROVER, scene.config(10.0)) as renderer:
        pose = scene.pose(z=0.1)
        frame = renderer.render(RoverPose(pose), 0, ('depth',))
        camera = pose @ renderer.rig.T_base_left
        fall = (camera[:3, :3] @ renderer.rig.rays()[..., None])[..., 2, 0]
    expected = -camera[2, 3] / np.where(fall < 0.0, fall, np.nan)
    near = expected < 30.0
    # Devices may round corners of triangles to 1/256 px.
    rounding = np.abs(np.gradient(expected, axis=0)) / 256.0
    assert np.all(np.abs(frame.depth_m - expected)[near] <= (2e-5 * expected + rounding)[near])
    assert np.all(np.isinf(frame.depth_m[fall > 0.0]))


def test_nothing_pops(world):
    """Frames 1 mm apart differ by no more than the parallax: where the mesh changes too."""
    config = scene.config(12.0, azimuth_deg=50.0,
                          detail=scene.DetailConfig(relief_rms_slope=0.0, pebble_cover=0.0,
                                                    pit_cover=0.0))
    with Renderer(world, scene.ROVER, config) as renderer:
        poses = [pose_on(world, 0.0, 0.0)]
        poses.append(poses[0].copy())
        poses[1][0, 3] += 0.001
        a, b = (renderer.render(RoverPose(p), 0, ('radiance', 'depth', 'left')) for p in poses)
    # Where a ground point moves by less than a fifth of a pixel the picture may change by no
    # more than a fifth of its steepest step nearby.
    both = np.isfinite(a.depth_m) & np.isfinite(b.depth_m) & (a.depth_m > 0.7)
    change = np.abs(a.radiance - b.radiance)
    from scipy.ndimage import maximum_filter, minimum_filter
    step = maximum_filter(a.radiance, 3) - minimum_filter(a.radiance, 3)
    scale = np.quantile(a.radiance[both], 0.9)
    odd = both & (change > 0.5 * step + 0.01 * scale)
    assert odd.mean() < 2e-4
    depth_change = np.abs(a.depth_m - b.depth_m)[both] / a.depth_m[both]
    assert np.quantile(depth_change, 0.99) < 0.01


def test_no_cracks(world, renderer):
    """Below the skyline there is no hole through which the sky shows."""
    for yaw in (0.0, 70.0, 200.0, 310.0):
        depth = renderer.render(RoverPose(pose_on(world, 2.0, -1.0, yaw)), 0, ('depth',)).depth_m
        sky = np.isinf(depth)
        ground_above = np.logical_or.accumulate(~sky, axis=0)
        assert not np.any(sky & ground_above)


def test_labels_and_normals(world, renderer):
    pose = pose_on(world, -3.0, -3.0, 45.0)
    frame = renderer.render(RoverPose(pose), 0, ('depth', 'normal', 'label'))
    assert np.array_equal(frame.label == LABEL_SKY, np.isinf(frame.depth_m))
    assert (frame.label == LABEL_GROUND).any()
    stones = np.unique(frame.label[frame.label >= LABEL_FIRST_ROCK]) - LABEL_FIRST_ROCK
    assert len(stones) > 2
    left, _ = renderer.rig.project(world.rocks.position_m[stones], pose)
    for index, pixel in zip(stones, left):
        if frame.depth_m.shape[1] > pixel[0] >= 0 and frame.depth_m.shape[0] > pixel[1] >= 0:
            rows, columns = np.nonzero(frame.label == index + LABEL_FIRST_ROCK)
            reach = max(np.ptp(rows), np.ptp(columns)) + 3
            assert np.hypot(rows - pixel[1], columns - pixel[0]).min() < reach
    lengths = np.linalg.norm(frame.normal, axis=2)
    np.testing.assert_allclose(lengths[frame.label > 0], 1.0, atol=1e-5)
    assert np.all(frame.normal[frame.label == LABEL_GROUND][:, 2] > 0.3)


def test_rover_is_drawn_where_joints_put_it(world):
    """Seen by a camera that looks back at the rover, legs move with their joints."""
    high = dataclasses.replace(scene.ROVER, stereo=dataclasses.replace(
        scene.ROVER.stereo, position_m=(0.9, 0.0, 0.5), pitch_deg=90.0))
    turned = dataclasses.replace(high, stereo=dataclasses.replace(
        high.stereo, position_m=(0.0, 0.0, 0.9)))
    with Renderer(world, turned, scene.config(30.0)) as renderer:
        pose = pose_on(world, 0.0, 0.0)
        a = renderer.render(RoverPose(pose), 0, ('label', 'depth'))
        b = renderer.render(RoverPose(pose, STILL + np.radians(60.0)), 0, ('label', 'depth'))
    assert 0.01 < rover_links(a.label).mean() < 0.5
    changed = rover_links(a.label) != rover_links(b.label)
    assert changed.sum() > 50


def test_rig_geometry():
    rig = StereoRig(scene.ROVER, CameraConfig())
    assert rig.P_right[0, 3] == pytest.approx(-rig.focal_px * rig.baseline_m)
    assert rig.focal_px == pytest.approx(320 / np.tan(np.radians(35.0)))
    apart = rig.T_base_left[:3, 3] - rig.T_base_right[:3, 3]
    np.testing.assert_allclose(apart, [0.0, rig.baseline_m, 0.0], atol=1e-12)
    # The axis looks 10 deg down.
    np.testing.assert_allclose(rig.T_base_left[:3, 2],
                               [np.cos(np.radians(10)), 0.0, -np.sin(np.radians(10))], atol=1e-12)
    point = rig.T_base_left @ [0.2, -0.1, 2.0, 1.0]
    left, right = rig.project(point[:3], np.eye(4))
    assert left[1] == pytest.approx(right[1])
    assert left[0] - right[0] == pytest.approx(rig.focal_px * rig.baseline_m / 2.0)
    assert np.all(np.isnan(rig.project([-5.0, 0.0, 0.0], np.eye(4))[0]))
