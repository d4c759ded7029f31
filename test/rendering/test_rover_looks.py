"""What the rover looks like: its shadow on itself, the gloss of its surfaces."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.chase import ChaseConfig, ChaseMount
from lunar_rover_sim.rendering.renderer import Renderer
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
