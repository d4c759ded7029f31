"""The renderer: geometry, truth layers, determinism, and what it refuses."""

import contextlib
import dataclasses
import gc

import camera_scene as scene
from conftest import PLAIN
import moderngl
import mujoco
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
import worlds

from lunar_rover_sim.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.camera.mount import BodyMount
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.errors import ConfigError, RenderError
from lunar_rover_sim.frames import wxyz_from_matrix
from lunar_rover_sim.illumination.config import LampConfig
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.model import build_model
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.context import create_context
from lunar_rover_sim.rendering.frame import LAYERS
from lunar_rover_sim.rendering.frame_targets import read_image
from lunar_rover_sim.rendering.labels import LABEL_FIRST_ROCK, LABEL_GROUND, LABEL_SKY, rover_links
from lunar_rover_sim.rendering.projection import Projection
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rendering.scene import LEFT, Request, RIGHT
from lunar_rover_sim.rendering.scene_passes import ScenePasses
from lunar_rover_sim.rendering.sensor_pass import SensorPass
from lunar_rover_sim.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

STILL = np.zeros(4)


@pytest.fixture(scope='module')
def world():
    """Rolling ground with a few rocks."""
    heights = scene.hills()
    rng = np.random.default_rng(5)
    xy = rng.uniform(-5.0, 5.0, (40, 2))
    xy = xy[np.abs(xy).max(axis=1) > 0.8]
    flat = scene.plane(heights=heights)
    z = flat.ground.height_at(xy) + 0.05
    return scene.plane(heights=heights, stones=scene.rocks(np.column_stack([xy, z]), 0.2),
                       shape=scene.block('block', (0.5, 0.45, 0.4)))


@pytest.fixture(scope='module')
def renderer(world):
    config = RenderConfig(sun=scene.RELIEF_SUN)
    with Renderer(world, scene.ROVER, config) as renderer:
        yield renderer


@contextlib.contextmanager
def created_context():
    context = create_context()
    try:
        with context:
            yield context
    finally:
        context.release()


def pose_on(world, x, y, yaw_deg=0.0):
    z = float(world.height_at((x, y))) + 0.1
    return scene.pose(x, y, z, yaw_deg)


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
    assert (beyond[near & (a.depth_m > 2.0)] > 0.1).mean() < 1e-4
    # Where the parallax is small the picture hardly changes at all.
    far = (a.depth_m > 4.0) & (a.depth_m < 30.0)
    assert np.corrcoef(a.radiance[far], b.radiance[far])[0, 1] > 0.99


def test_depth_is_that_of_the_world_of_physics():
    """The same of a built world, its rocks' meshes included, in the model that is simulated."""
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
            rows, columns = np.nonzero(frame.label >= LABEL_FIRST_ROCK)
            pick = rng.integers(0, len(rows), 400)
            pixels = {'anywhere': (rng.integers(0, 480, 800), rng.integers(0, 640, 800)),
                      'on rocks': (rows[pick], columns[pick])}
            for name, (vs, us) in pixels.items():
                for v, u in zip(vs, us):
                    distance = mujoco.mj_ray(model, data, camera[:3, 3],
                                             camera[:3, :3] @ rays[v, u], None, 1, -1,
                                             np.zeros(1, np.int32), None)
                    if 0.0 < distance < 10.0:
                        errors[name].append(abs(frame.depth_m[v, u] - distance))
    for name, good in (('anywhere', 0.99), ('on rocks', 0.95)):     # most are near an outline
        assert len(errors[name]) > 500
        assert np.median(errors[name]) < 1e-3
        assert np.quantile(errors[name], good) < 1e-2, name


def test_depth_of_a_plane_is_analytic():
    with Renderer(scene.plane(), scene.ROVER, scene.config(10.0)) as renderer:
        pose = scene.pose(z=0.1)
        frame = renderer.render(RoverPose(pose), 0, ('depth',))
        camera = pose @ renderer.rig.T_base_left
        fall = (camera[:3, :3] @ renderer.rig.rays()[..., None])[..., 2, 0]
    expected = -camera[2, 3] / np.where(fall < 0.0, fall, np.nan)
    near = expected < 30.0
    np.testing.assert_allclose(frame.depth_m[near], expected[near], rtol=2e-5)
    assert np.all(np.isinf(frame.depth_m[fall > 0.0]))


def test_same_input_same_bytes(world, renderer):
    pose = pose_on(world, 1.0, 0.0, 20.0)
    first = renderer.render(RoverPose(pose), 5, ('left', 'right', 'depth'))
    renderer.render(RoverPose(pose_on(world, -2.0, 1.0), STILL + 0.3), 6, ('left',))
    again = renderer.render(RoverPose(pose), 5, ('left', 'right', 'depth'))
    for name in ('left', 'right', 'depth_m'):
        assert np.array_equal(getattr(first, name), getattr(again, name))
    config = renderer.config
    with Renderer(world, scene.ROVER, config) as other:
        fresh = other.render(RoverPose(pose), 5, ('left', 'right'))
    assert np.array_equal(first.left, fresh.left)
    assert np.array_equal(first.right, fresh.right)
    later = renderer.render(RoverPose(pose), 7, ('left',))
    assert not np.array_equal(first.left, later.left)


@pytest.mark.parametrize('lamp_w', [0.0, 20.0])
def test_a_frame_that_is_begun_early_is_the_same(world, lamp_w):
    """Each frame is begun before or after the one before it is finished, with changing layers."""
    config = scene.config(8.0, camera=CameraConfig(width=160, height=120),
                          lamp=LampConfig(power_w=lamp_w),
                          sensor=SensorConfig(exposure_mode='auto'))
    states = [RoverPose(pose_on(world, 0.4 * k, 0.0, 70.0 * k), STILL + 0.2 * k)
              for k in range(6)]
    asked = [('left', 'right', 'depth'), ('left', 'right', 'depth'), ('right',), (),
             ('left', 'depth', 'label'), ('left', 'right', 'radiance', 'normal')]
    with Renderer(world, scene.ROVER, config) as renderer:
        plain = [renderer.render(*frame) for frame in zip(states, range(6), asked)]
    early = []
    with Renderer(world, scene.ROVER, config) as renderer:
        renderer.begin(states[0], 0, asked[0])
        for k in range(1, 6):
            renderer.begin(states[k], k, asked[k])
            early.append(renderer.finish())
        early.append(renderer.finish())
    for one, two in zip(plain, early):
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(two, field.name))


def test_begin_and_finish_out_of_order(world, renderer):
    """At most two frames are under way, and what would mix them up is refused."""
    state = RoverPose(pose_on(world, 1.0, 0.0))
    with pytest.raises(RenderError, match='finish: no frame is under way; begin one first'):
        renderer.finish()
    renderer.begin(state, 0, ('depth',))
    with pytest.raises(RenderError, match='set_sun: a frame is under way; finish it first'):
        renderer.set_sun(10.0, 10.0)
    with pytest.raises(RenderError, match='render: a frame is under way; finish it first'):
        renderer.render(state)
    renderer.begin(state, 0, ('left',))
    with pytest.raises(RenderError, match='begin: 2 frames are under way; finish one first'):
        renderer.begin(state)
    assert renderer.finish().left is None
    assert renderer.finish().depth_m is None


def test_a_closed_renderer_refuses_to_draw(world):
    with Renderer(world, scene.ROVER, scene.config(8.0)) as renderer:
        pass
    with pytest.raises(RenderError, match='the renderer is closed'):
        renderer.render(RoverPose(np.eye(4)))
    renderer.close()        # closing twice is no error


@pytest.mark.usefixtures('new_contexts')
def test_all_gl_objects_are_released(monkeypatch, world):
    """No owner forgets an object: moderngl lists what was dropped; released ones are invalid."""
    contexts = []

    def watched():
        contexts.append(create_context())
        contexts[-1].gc_mode = 'context_gc'
        return contexts[-1]
    monkeypatch.setattr('lunar_rover_sim.rendering.renderer.create_context', watched)
    config = scene.config(8.0, lamp=LampConfig(power_w=20.0),
                          camera=CameraConfig(width=160, height=120,
                                              distortion=(-0.1, 0.0, 0.0, 0.0, 0.0)))
    state = RoverPose(pose_on(world, 1.0, 0.0))
    for _ in range(2):
        with Renderer(world, scene.ROVER, config) as renderer:
            renderer.render(state, 0, LAYERS)
            renderer.set_sun(200.0, 20.0)
            renderer.begin(state)
            renderer.begin(state)
        del renderer
    gc.collect()
    assert len(contexts) == 2
    for context in contexts:
        assert len(context.objects) > 50
        assert all(isinstance(item, moderngl.InvalidObject) for item in context.objects)


def test_a_renderer_of_a_scenario(world):
    """It takes seed, rover and configuration of the scenario, and its world unless one is given.
    """
    scenario = Scenario.load('baseline', [*PLAIN, 'render_node.camera.width=160',
                                          'render_node.camera.height=120'], seed=3)
    state = RoverPose(pose_on(world, 1.0, 0.0))
    with Renderer.from_scenario(scenario, world) as renderer:
        frame = renderer.render(state)
    with Renderer(world, scenario.rover, scenario.render_node, 3) as renderer:
        expected = renderer.render(state)
    assert frame.left.shape == (120, 160)
    np.testing.assert_array_equal(frame.left, expected.left)


def test_a_state_of_physics_is_drawn(world, renderer):
    """`RoverState` has pose and leg angles, as `RoverPose` has."""
    pose = pose_on(world, 1.0, 0.0, 30.0)
    numbers = {field.name: np.zeros(3) for field in dataclasses.fields(RoverState)}
    state = RoverState(**{**numbers, 'position_m': pose[:3, 3],
                          'orientation_wxyz': wxyz_from_matrix(pose[:3, :3]),
                          'joint_angle_rad': STILL + 0.3, 'joint_velocity_radps': STILL})
    np.testing.assert_allclose(state.T_world_base, pose, atol=1e-12)
    a, b = (renderer.render(s, 0, ('left',)).left for s in (state, RoverPose(pose, STILL + 0.3)))
    assert np.mean(a != b) < 1e-3


def test_layers_do_not_depend_on_each_other(world, renderer):
    pose = pose_on(world, 1.0, 0.0, 20.0)
    pair = renderer.render(RoverPose(pose), 5, ('left', 'right', 'depth', 'normal', 'label'))
    for name, field in (('left', 'left'), ('right', 'right'), ('depth', 'depth_m'),
                        ('label', 'label')):
        alone = renderer.render(RoverPose(pose), 5, (name,))
        assert np.array_equal(getattr(alone, field), getattr(pair, field))
        others = {'left', 'right', 'depth_m', 'label'} - {field}
        assert all(getattr(alone, other) is None for other in others)
    nothing = renderer.render(RoverPose(pose), 5, ())
    assert nothing.left is None and nothing.depth_m is None


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


def test_no_pinholes_where_meshes_meet():
    """No single pixel of sky inside the ground, in either image, where two strides meet."""
    built = worlds.small()
    config = scene.config(12.0)
    rig = StereoRig(scene.ROVER, config.camera)
    projection = Projection(rig.K, rig.width, rig.height, config.camera.near_m,
                            config.camera.far_m)
    rng = np.random.default_rng(4)
    with created_context() as context:
        shared = WorldPasses(context, built, scene.ROVER, config, 0)
        passes = ScenePasses(context, shared, BodyMount(rig), config, projection,
                             sees_rover=False, strays=lambda direction: False)
        for _ in range(40):
            pose = pose_on(built, *rng.uniform(-4.0, 4.0, 2), rng.uniform(0.0, 360.0))
            drawn = passes.draw_geometry(Request.of(('left', 'right'), 0), RoverPose(pose))
            for side in (LEFT, RIGHT):
                ground = read_image(drawn.pixels.targets.ground[side], 0, side,
                                    (rig.height, rig.width), (0, 0)) > 0.0
                around = [np.roll(ground, (dv, du), (0, 1))[1:-1, 1:-1]
                          for dv in (-1, 0, 1) for du in (-1, 0, 1) if dv or du]
                assert 0.2 < ground.mean() < 1.0
                assert not np.any(~ground[1:-1, 1:-1] & np.all(around, axis=0))
        passes.release()
        shared.release()


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


def test_encodings(world):
    camera = CameraConfig(width=160, height=120)
    shapes = {'mono8': ((120, 160), np.uint8), 'mono16': ((120, 160), np.uint16),
              'rgb8': ((120, 160, 3), np.uint8)}
    for encoding, (shape, dtype) in shapes.items():
        config = scene.config(20.0, camera=camera, sensor=SensorConfig(encoding=encoding))
        with Renderer(world, scene.ROVER, config) as renderer:
            frame = renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left', 'right'))
        assert frame.left.shape == shape and frame.left.dtype == dtype
        assert frame.left.max() > 0.1 * np.iinfo(dtype).max


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


def test_bad_input(world, renderer):
    with pytest.raises(RenderError, match="layer 'dept' is not valid; did you mean depth"):
        renderer.render(RoverPose(np.eye(4)), 0, ('dept',))
    with pytest.raises(RenderError, match='^frame_index: 1.5 is not valid; valid is a whole num'):
        renderer.render(RoverPose(np.eye(4)), 1.5)
    with pytest.raises(RenderError, match='finite 4 x 4'):
        renderer.render(RoverPose(np.full((4, 4), np.nan)), 0, ('left',))
    with pytest.raises(RenderError, match='leg angles are four finite numbers'):
        renderer.render(RoverPose(np.eye(4), np.zeros(3)))
    with pytest.raises(RenderError, match='state: ndarray is not valid; valid is a RoverState or'):
        renderer.render(np.eye(4))
    with pytest.raises(ConfigError, match='elevation_deg: -5.0 is not valid'):
        scene.config(-5.0)
    with pytest.raises(ConfigError, match='near_m'):
        RenderConfig(camera=CameraConfig(near_m=10.0, far_m=10.0))


def test_size_beyond_the_device(monkeypatch, world):
    class Small(contextlib.nullcontext):
        info = {'GL_MAX_TEXTURE_SIZE': 1024}

        def release(self):
            self.released = True
    device = Small()
    monkeypatch.setattr('lunar_rover_sim.rendering.renderer.create_context', lambda: device)
    big = RenderConfig(camera=CameraConfig(width=640, height=640))
    with pytest.raises(RenderError, match='640 x 640: this device draws at most 1024 x 512'):
        Renderer(world, scene.ROVER, big)
    assert device.released


def test_lost_context(monkeypatch, world, renderer):
    def lost(*_):
        raise Exception('GL_CONTEXT_LOST')
    monkeypatch.setattr(SensorPass, 'draw', lost)
    with pytest.raises(RenderError, match='context may be lost: GL_CONTEXT_LOST'):
        renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left',))


def test_a_defect_of_ours_is_no_lost_context(monkeypatch, world, renderer):
    def defect(*_):
        raise KeyError('no such pass')
    monkeypatch.setattr(SensorPass, 'draw', defect)
    with pytest.raises(KeyError, match='no such pass'):
        renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left',))
    monkeypatch.undo()
    assert renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left',)).left.any()


def test_no_egl(monkeypatch, world):
    import moderngl

    def broken(**_):
        raise Exception('libEGL.so not loaded')
    monkeypatch.setattr(moderngl, 'create_context', broken)
    with pytest.raises(RenderError, match='libegl1 libgl1 libgl1-mesa-dri'):
        Renderer(world, scene.ROVER, RenderConfig())
