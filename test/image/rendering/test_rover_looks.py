"""What the rover looks like: its shadow on itself, the gloss of its surfaces."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering import ground_band, object_light
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.rover_pass import RoverPass
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.rover.visual import CELLS, GLOSS, GOLD, visual_parts

DETAILS = ('radiance', 'label', 'shadow', 'normal')


def looked_at(azimuth_deg, sun_azimuth_deg, sun_elevation_deg=25.0):
    """Return a frame of the rover, which looks along x, from above and aside."""
    config = ChaseConfig.from_mapping({
        'azimuth_deg': azimuth_deg, 'elevation_deg': 55.0, 'distance_m': 0.8, 'reference': 'east',
        'camera': {'width': 320, 'height': 240}})
    world = scene.plane()
    with Renderer(world, scene.ROVER, scene.config(sun_elevation_deg, sun_azimuth_deg)) as drawn:
        mount = ChaseMount(config, sun_azimuth_deg, world)
        camera, state = drawn.add_camera(config, mount), RoverPose(scene.pose())
        mount.follow(state)
        return camera.render(state, 0, DETAILS)


def test_the_mast_shades_the_deck():
    """With the sun ahead it lies along the deck; overhead the head still shades a bit of it."""
    ahead, above = looked_at(90.0, 0.0), looked_at(90.0, 0.0, 90.0)
    for frame, least, most in ((ahead, 0.03, 0.5), (above, 0.0, 0.12)):
        deck = (frame.label == 2) & (frame.normal[..., 2] > 0.99)
        assert deck.sum() > 2000
        shaded = deck & (frame.shadow[..., 1] > 200)    # of the sun, hidden by the rover alone
        assert least <= shaded.sum() / deck.sum() <= most
        if least:
            # No sunlight is left there; what it mirrors of the sky is black.
            lit = deck & (frame.shadow[..., 0] > 200)
            assert np.median(frame.radiance[shaded]) < 0.02 * np.median(frame.radiance[lit])


def test_foil_glitters_and_paint_does_not():
    """Towards the sun's mirror image crumpled foil has facets far above its median."""
    frame = looked_at(150.0, 30.0)
    side = (frame.label == 2) & (frame.normal[..., 2] < 0.5) & (frame.shadow[..., 0] > 200)
    assert side.sum() > 500
    bright = frame.radiance[side]
    assert np.quantile(bright, 0.98) > 2.0 * np.median(bright)
    assert np.isfinite(frame.radiance).all() and frame.radiance.min() >= 0.0


def test_every_part_has_a_gloss():
    parts = visual_parts(scene.ROVER)
    assert all(part.gloss == GLOSS[part.albedo] for part in parts)
    assert GLOSS[GOLD][1] > 0.5 and GLOSS[CELLS][1] == pytest.approx(0.04)


def test_cameras_that_cannot_see_it_do_not_draw_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pair looks over it, where no link reaches at any angle; a chase camera looks at it."""
    drawn = []
    draw = RoverPass.draw
    monkeypatch.setattr(RoverPass, 'draw', lambda self, *args, **kwargs: drawn.append(
        draw(self, *args, **kwargs)))
    world, state = scene.plane(), RoverPose(scene.pose())
    with Renderer(world, scene.ROVER, scene.config(25.0, 180.0)) as renderer:
        renderer.render(state, 0, ('left', 'label'))
        assert not drawn
        mount = ChaseMount(ChaseConfig(), 180.0, world)
        camera = renderer.add_camera(ChaseConfig(), mount)
        mount.follow(state)
        assert (camera.render(state, 0, ('label',)).label > 1).sum() > 1000
        assert drawn


def test_none_of_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are those of a search everywhere: sun low and high, all around, with rocks."""
    stones = scene.rocks([(0.9, 0.15, 0.1), (2.5, -0.3, 0.1), (0.4, -0.9, 0.1)], 0.25)
    world = scene.plane(heights=scene.hills(), stones=stones, shape=scene.block())
    config = scene.config(2.0, camera=CameraConfig(width=128, height=96))
    found, of_rover = [], []
    real = ground_band.may_shade
    with Renderer(world, scene.ROVER, config) as renderer:
        for elevation_deg in (2.0, 6.0, 35.0):
            renderer.set_sun(60.0, elevation_deg)
            for yaw_deg in np.arange(0.0, 360.0, 45.0):
                state = RoverPose(scene.pose(yaw_deg=yaw_deg), np.full(4, 0.4))
                frames = []
                for value in (None, True, False):
                    def shaded(*args, value=value):
                        found.append(real(*args))
                        return found[-1] if value is None else value
                    for module in (ground_band, object_light):
                        monkeypatch.setattr(module, 'may_shade', shaded)
                    frames.append(renderer.render(state, 0, ('radiance',)).radiance)
                assert np.array_equal(frames[0], frames[1]), (elevation_deg, yaw_deg)
                of_rover.append((frames[1] != frames[2]).mean())
    # There is something to find, and where there is nothing it is mostly not looked for.
    assert max(of_rover) > 0.1 and np.median(of_rover) < 0.01
    assert 0.1 < np.mean(found) < 0.5


def test_a_straight_edge_of_its_shadow_is_straight():
    """Half the light across the side of the body's shadow on a plane, row by row, from above."""
    config = ChaseConfig.from_mapping({
        'azimuth_deg': 0.0, 'elevation_deg': 60.0, 'distance_m': 1.6, 'reference': 'east',
        'camera': {'width': 640, 'height': 480}})
    world, state = scene.plane(), RoverPose(scene.pose())
    with Renderer(world, scene.ROVER, scene.config(10.0, 40.0)) as drawn:
        mount = ChaseMount(config, 40.0, world)
        camera = drawn.add_camera(config, mount)
        mount.follow(state)
        rows = camera.render(state, 0, ('radiance',)).radiance[140:168, 230:275].astype(float)
    rows /= rows.max(axis=1, keepdims=True)
    crossings = []
    for number, row in enumerate(rows):
        first = np.flatnonzero((row[:-1] < 0.5) != (row[1:] < 0.5))
        if len(first) == 1:
            k = first[0]
            crossings.append((number, k + (0.5 - row[k]) / (row[k + 1] - row[k])))
    at, column = np.array(crossings).T
    assert len(at) > 20
    assert np.ptp(column - np.polyval(np.polyfit(at, column, 1), at)) < 0.5
