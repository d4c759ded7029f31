"""The renderer: determinism, what it holds and releases, what it refuses."""

import contextlib
import dataclasses
import gc
import os
import threading

import camera_scene as scene
from conftest import PLAIN
import moderngl
import numpy as np
import pytest
from rolling_scene import pose_on, rolling_world

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import wxyz_from_matrix
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.illumination.config import LampConfig
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.context import create_context
from lunar_rover_sim.image.rendering.frame import LAYERS
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.rock_pass import RockPass
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

STILL = np.zeros(4)


@pytest.fixture(scope='module')
def world():
    return rolling_world()


@pytest.fixture(scope='module')
def renderer(world):
    config = RenderConfig(sun=scene.RELIEF_SUN)
    with Renderer(world, scene.ROVER, config) as renderer:
        yield renderer


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


@pytest.mark.parametrize('sensor', [SensorConfig(),
                                    SensorConfig(encoding='rgb8', line_time_s=1e-4)])
def test_pictures_do_not_depend_on_the_number_of_threads(monkeypatch, world, sensor):
    camera = CameraConfig(width=200, height=150, distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    config = RenderConfig(camera=camera, sun=scene.RELIEF_SUN, sensor=sensor)
    state = RoverPose(pose_on(world, 1.0, 0.0, 20.0), STILL,
                      angular_velocity_radps=np.array([0.0, 0.0, 3.0]))
    frames, threads = [], []
    for cores in (1, 2, 6):
        monkeypatch.setattr(os, 'sched_getaffinity', lambda _, n=cores: set(range(n)))
        before = threading.active_count()
        with Renderer(world, scene.ROVER, config) as renderer:
            frames.append(renderer.render(state, 3, LAYERS))
            threads.append(threading.active_count() - before)
    # Beside the thread that draws; one that is idle may do the work of the next one.
    assert threads in ([0, 1, 1], [0, 1, 2])
    for field in dataclasses.fields(frames[0]):
        for frame in frames[1:]:
            np.testing.assert_array_equal(getattr(frames[0], field.name),
                                          getattr(frame, field.name))


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
    monkeypatch.setattr('lunar_rover_sim.image.rendering.renderer.create_context', watched)
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
        assert len(context.objects) > 30
        assert all(isinstance(item, moderngl.InvalidObject) for item in context.objects)


def test_a_renderer_of_a_scenario(world):
    """It takes seed, rover and configuration of the scenario, and its world unless one is given.
    """
    scenario = Scenario.load('baseline', [*PLAIN, 'render_node.camera.width=160',
                                          'render_node.camera.height=120'], seed=3)
    state = RoverPose(pose_on(world, 1.0, 0.0))
    with scenario.renderer(world) as renderer:
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


def test_bad_input(world, renderer):
    with pytest.raises(RenderError, match="layer 'dept' is not valid; did you mean depth"):
        renderer.render(RoverPose(np.eye(4)), 0, ('dept',))
    with pytest.raises(RenderError, match='^frame_index: 1.5 is not valid; valid is a whole num'):
        renderer.render(RoverPose(np.eye(4)), 1.5)
    with pytest.raises(RenderError, match='finite 4 x 4'):
        renderer.render(RoverPose(np.full((4, 4), np.nan)), 0, ('left',))
    with pytest.raises(RenderError, match='leg angles are 4 finite numbers'):
        renderer.render(RoverPose(np.eye(4), np.zeros(3)))
    with pytest.raises(RenderError, match='state: ndarray is not valid; valid is a RoverState or'):
        renderer.render(np.eye(4))


def test_size_beyond_the_device(monkeypatch, world):
    class Small(contextlib.nullcontext):
        info = {'GL_MAX_TEXTURE_SIZE': 1024}

        def release(self):
            self.released = True
    device = Small()
    monkeypatch.setattr('lunar_rover_sim.image.rendering.renderer.create_context', lambda: device)
    big = RenderConfig(camera=CameraConfig(width=640, height=640))
    with pytest.raises(RenderError, match='640 x 640: this device draws at most 1024 x 512'):
        Renderer(world, scene.ROVER, big)
    assert device.released


def test_lost_context(monkeypatch, world, renderer):
    def lost(*_, **__):
        raise Exception('GL_CONTEXT_LOST')
    monkeypatch.setattr(RockPass, 'draw', lost)
    with pytest.raises(RenderError, match='context may be lost: GL_CONTEXT_LOST'):
        renderer.render(RoverPose(pose_on(world, 0.0, 0.0)), 0, ('left',))


def test_a_defect_of_ours_is_no_lost_context(monkeypatch, world, renderer):
    def defect(*_, **__):
        raise KeyError('no such pass')
    monkeypatch.setattr(RockPass, 'draw', defect)
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


CAMERA = CameraConfig(width=160, height=120)


def test_set_sun() -> None:
    """Terrain, rocks, relief below the grid and rover: all are lit from the new side."""
    world = scene.plane(heights=scene.hills(), stones=scene.rocks([(1.2, 0.3, 0.2)], 0.4))
    here = scene.config(25.0, 180.0, camera=CAMERA, detail=DetailConfig())
    there = dataclasses.replace(here, sun=scene.RELIEF_SUN)
    assert there.sun == scene.RELIEF_SUN
    with Renderer(world, scene.ROVER, here) as renderer:
        before = renderer.render(RoverPose(scene.pose())).left
        renderer.set_sun(there.sun.azimuth_deg, there.sun.elevation_deg)
        after = renderer.render(RoverPose(scene.pose()))
    with Renderer(world, scene.ROVER, there) as renderer:
        fresh = renderer.render(RoverPose(scene.pose()))
    assert before is not None and np.mean(before != after.left) > 0.2
    np.testing.assert_array_equal(after.left, fresh.left)
    np.testing.assert_array_equal(after.right, fresh.right)
    assert after.exposure_s == fresh.exposure_s
