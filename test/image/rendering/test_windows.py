"""One place of a site, drawn from windows of it."""

import dataclasses
import gc
import json

import camera_scene as scene
import moderngl
import numpy as np
import psutil
import pytest
from site_windows import cut, Windows
import worlds

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK, Numbers, vocabulary
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.rover.pose import moved, RoverPose

SAMPLES = [1025, 225, 253]
LAYERS = ('left', 'depth', 'label', 'crater', 'normal', 'radiance')
# Without what is drawn about the middle of a window: rocks beyond it, patches of far ground.
CONFIG = scene.config(sun=scene.RELIEF_SUN, camera=CameraConfig(width=320, height=240),
                      detail=DetailConfig(far_rocks_m=0.0))


@pytest.fixture(scope='module')
def wide():
    """Return a world that holds windows 12.8 m apart."""
    return worlds.small(2, size_m=64.0, cell_m=0.05, albedo={'variation': 0.0},
                        rocks={'abundance': 0.04, 'max_diameter_m': 0.6})


@pytest.fixture(scope='module')
def windows(wide):
    """Return two windows whose middles are 12.8 m apart, far from the origin of the site."""
    return [cut(wide, (x, 0.0), SAMPLES, (1286.4, -985.6)) for x in (-6.4, 6.4)]


@pytest.fixture(scope='module')
def renderer(windows):
    """Return a renderer that has begun in the first window."""
    with Renderer(windows[0], scene.ROVER, CONFIG) as drawn:
        yield drawn


def poses(world, middle_m=(1286.4, -985.6)):
    """Return states between the two windows, in several directions."""
    return [RoverPose(standing(world, middle_m[0] + x, middle_m[1] + y, yaw))
            for x, y, yaw in ((0.0, 0.0, 0.0), (0.3, 1.0, 100.0), (-0.4, -0.6, 200.0),
                              (0.0, 2.0, 290.0))]


def frames(renderer, world, states, layers=LAYERS):
    """Return frames of states from a window."""
    if renderer.world is not world:
        renderer.enter(world)
    return [renderer.render(state, 0, layers) for state in states]


def trodden(x_m, y_m):
    """Return an overlay with a row of prints east of a place."""
    overlay = Overlay()
    y, x = np.mgrid[-8:9, -8:9]
    away = np.hypot(x, y)
    for k in range(12):
        overlay.put(round(x_m / 0.005) + 40 * k, round(y_m / 0.005) + 30 * (k % 2),
                    np.where(away < 5, -0.012, np.where(away < 8, 0.004 * (8 - away) / 3, 0.0)),
                    np.where(away < 5, 0.008, 0.0))
    return overlay


def test_two_windows_show_one_picture(renderer, windows):
    states = poses(windows[0])
    for first, second in zip(frames(renderer, windows[0], states),
                             frames(renderer, windows[1], states)):
        near = (first.depth_m < 10.0) & (second.depth_m < 10.0)
        levels = np.abs(first.left.astype(int) - second.left)
        assert near.mean() > 0.4
        # Coarse texels and cells of indirect light lie on the lattice of the site.
        assert (levels[near] <= 1).mean() > 0.999
        # Where the fine ground of the first window ends, 19 m away, the second goes on; in one
        # picture that ground takes a fifth of the pixels.
        assert (levels <= 1).mean() > 0.97
        apart = np.abs(first.depth_m[near] / second.depth_m[near] - 1.0)
        assert (apart < 1e-5).mean() > 0.999        # the rest: rays that graze a stone of relief
        assert (first.label[near] == second.label[near]).mean() > 0.9999
        assert (first.label[near] >= LABEL_FIRST_ROCK).any()
        assert (first.crater[near] == second.crater[near]).mean() > 0.9999
        assert (np.abs(first.normal[near] - second.normal[near]) < 1e-2).mean() > 0.998


def test_texture_would_not_agree_without_the_place_in_the_site(renderer, windows):
    # What the test above sees: the same window as if it lay elsewhere has another texture.
    state = poses(windows[0])[0]
    there = frames(renderer, windows[0], [state])[0]
    world = windows[0].local()
    elsewhere = dataclasses.replace(world, origin_m=(world.origin_m[0] + 3.3, world.origin_m[1]))
    local = moved(state, -np.array([*windows[0].ground.middle_m, 0.0]))
    here = frames(renderer, elsewhere, [local])[0]
    near = there.depth_m < 5.0
    assert (np.abs(there.left.astype(int) - here.left)[near] <= 1).mean() < 0.9


def test_a_window_in_its_own_frame_is_the_same_picture(renderer, windows):
    states = poses(windows[0])[:2]
    there = frames(renderer, windows[0], states)
    offset = -np.array([*windows[0].ground.middle_m, 0.0])
    here = frames(renderer, windows[0].local(), [moved(state, offset) for state in states])
    for first, second in zip(there, here):
        for layer in LAYERS:
            np.testing.assert_array_equal(first.layer(layer), second.layer(layer))


def test_coming_back_draws_the_same_and_leaks_nothing(windows):
    def alive():
        gc.collect()
        kinds = (moderngl.Buffer, moderngl.VertexArray, moderngl.Texture, moderngl.Framebuffer,
                 moderngl.Program, moderngl.Renderbuffer)
        # What is released becomes an InvalidObject. `isinstance` would look through weak proxies.
        return sum(issubclass(type(item), kinds)
                   and not isinstance(item.mglo, moderngl.InvalidObject)
                   for item in gc.get_objects())
    states = poses(windows[0])[:2]
    with Renderer(windows[0], scene.ROVER, CONFIG) as drawn:
        drawn.follow(trodden(1286.4, -985.6))
        before = frames(drawn, windows[0], states)
        counts, memory = [], []
        for _ in range(4):
            for world in (windows[1], windows[0]):
                drawn.ahead(world)
                after = frames(drawn, world, states)
            counts.append(alive())
            memory.append(psutil.Process().memory_info().rss)
        assert len(set(counts)) == 1 and counts[0] > 20
        assert memory[-1] < 1.15 * memory[0]        # a window takes a third
    for first, second in zip(before, after):
        for layer in LAYERS:
            np.testing.assert_array_equal(first.layer(layer), second.layer(layer))


def test_tracks_stay(windows):
    state = poses(windows[0])[0]
    overlay = trodden(1286.4 + 0.7, -985.6 - 0.1)
    with Renderer(windows[0], scene.ROVER, CONFIG) as drawn:
        drawn.follow(overlay)
        first, = frames(drawn, windows[0], [state])
        second, = frames(drawn, windows[1], [state])
    near = first.depth_m < 4.0
    disturbed = first.label == 3
    assert disturbed.sum() > 200
    assert (disturbed == (second.label == 3)).mean() > 0.9999
    assert (np.abs(first.left.astype(int) - second.left)[near] <= 1).mean() > 0.998


def test_only_tracks_of_the_window_are_kept_ready(windows):
    def kept_ready(overlay):
        with Renderer(windows[0], scene.ROVER, CONFIG) as drawn:
            drawn.follow(overlay)
            drawn.render(poses(windows[0])[0])
            drawn.enter(windows[1])
            drawn.render(poses(windows[0])[0])
            return len(drawn._shared.tracks.keys)
    near = trodden(1286.4 + 0.7, -985.6 - 0.1)
    both = trodden(1286.4 + 0.7, -985.6 - 0.1)
    for x in range(0, 100, 3):
        both.apply(trodden(1300.0 + x, -985.6).snapshot())
    assert kept_ready(both) < 8 * kept_ready(near)      # of 34 times as many


def test_frames_under_way_are_those_of_the_window_before(renderer, windows):
    one, other = poses(windows[0])[:2]
    alone = frames(renderer, windows[0], [one], ('left',))[0]
    renderer.begin(one, 0, ('left',))
    renderer.enter(windows[1])
    renderer.begin(other, 0, ('left',))
    np.testing.assert_array_equal(renderer.finish().left, alone.left)
    after = renderer.finish().left
    np.testing.assert_array_equal(after, frames(renderer, windows[1], [other], ('left',))[0].left)


def test_a_chase_camera_is_in_the_site(renderer, windows):
    config = ChaseConfig(camera=dataclasses.replace(ChaseConfig().camera, width=160, height=90))
    mount = ChaseMount(config, CONFIG.sun.azimuth_deg, windows[0])
    camera = renderer.add_camera(config, mount)
    state = poses(windows[0])[0]
    seen = []
    for world in windows:
        renderer.enter(world)
        mount.enter(world)
        mount.follow(state)
        seen.append(camera.render(state, 0, ('depth', 'label')))
    assert (seen[0].label == 2).any()       # it shows the rover
    assert (seen[0].label == seen[1].label).mean() > 0.995


def test_the_window_follows_the_pose(renderer, windows):
    """A renderer that follows enters the next window by itself, with its cameras."""
    site = Windows(windows)
    states = [RoverPose(standing(windows[0], 1286.4 + x, -985.6, 0.0))
              for x in (0.0, 3.1, 3.4, 0.0)]
    chase = ChaseConfig(camera=dataclasses.replace(ChaseConfig().camera, width=160, height=90))
    mount = ChaseMount(chase, CONFIG.sun.azimuth_deg, windows[0])
    with Renderer(windows[0], scene.ROVER, CONFIG,
                  follower=Follower(windows[0], site)) as drawn:
        drawn.add_camera(chase, mount)
        for state, there in zip(states, (0, 0, 1, 1)):
            image = drawn.render(state, 0, ('left',)).left
            assert drawn.world is windows[there]
            by_hand = frames(renderer, windows[there], [state], ('left',))[0].left
            np.testing.assert_array_equal(image, by_hand)
        assert mount._world is windows[1]
        assert site.asked.count(windows[1].ground.middle_m) == 1     # made ahead, not once more


def test_the_sun_that_moved_meanwhile(renderer, windows):
    state = poses(windows[0])[0]
    frames(renderer, windows[0], [state])
    late = renderer.light_of(dataclasses.replace(CONFIG.sun, azimuth_deg=60.0))
    renderer.ahead(windows[1])
    renderer.set_sun(120.0, 9.0)
    drawn = frames(renderer, windows[1], [state])[0]
    with Renderer(windows[1], scene.ROVER, dataclasses.replace(
            CONFIG, sun=dataclasses.replace(CONFIG.sun, azimuth_deg=120.0,
                                            elevation_deg=9.0))) as fresh:
        again = frames(fresh, windows[1], [state])[0]
        np.testing.assert_array_equal(drawn.radiance, again.radiance)
    renderer.show_sun(late)                 # it was of the window before
    moved_sun = frames(renderer, windows[1], [state])[0].radiance
    renderer.set_sun(60.0, CONFIG.sun.elevation_deg)
    np.testing.assert_array_equal(moved_sun, frames(renderer, windows[1], [state])[0].radiance)
    renderer.set_sun(CONFIG.sun.azimuth_deg, CONFIG.sun.elevation_deg)


def test_a_world_of_another_site_is_refused(renderer):
    with pytest.raises(RenderError, match='enter: the world has other shapes of rocks'):
        renderer.enter(scene.plane())


def test_numbers_stay_and_run_out():
    book = Numbers(LABEL_FIRST_ROCK)
    first = np.arange(100, 140, dtype=np.uint32)
    assert book.of(first).tolist() == list(range(16, 56))
    later = book.of(first[20:] + np.uint32(5))
    assert later[:15].tolist() == list(range(41, 56)) and later[15:].tolist() == [
        56, 57, 58, 59, 60]
    for k in range(1, 40):      # 80,000 rocks come and go
        keys = np.arange(2000 * k, 2000 * k + 4000, dtype=np.uint32)
        numbers = book.of(keys)
        assert len(np.unique(numbers)) == len(keys)
    again = book.of(keys)
    np.testing.assert_array_equal(numbers, again)
    many = book.of(np.arange(70000, dtype=np.uint32) + np.uint32(10**6))
    assert len(np.unique(many)) == 65535 - 16 + 1 and many.max() == 65535


def test_the_vocabulary_knows_numbers_of_later_windows(renderer, windows):
    for world in windows:
        renderer.enter(world)
        told = json.loads(vocabulary(renderer.rocks, world.craters, '', scene.ROVER.legs.names,
                                     renderer.rock_labels, renderer.crater_numbers))
        rocks = told['rocks']
        numbers = rocks.get('id', list(range(16, 16 + len(renderer.rocks))))
        found = dict(zip(numbers, rocks['position_m']))
        names = {entry['class_id'] for entry in told['class_map']}
        assert set(numbers) <= names
        label = frames(renderer, world, poses(windows[0])[:1])[0].label
        for seen in np.unique(label[label >= LABEL_FIRST_ROCK]):
            # In the frame of the site.
            assert np.abs(np.subtract(found[seen][:2], world.ground.middle_m)).max() < 25.6
