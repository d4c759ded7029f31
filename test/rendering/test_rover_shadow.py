"""The shadow of the rover: looked for only where it may fall, and found wherever it does."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rendering.rover_shadow import RoverShadow
from lunar_rover_sim.rover.pose import RoverPose


def test_none_of_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are those of a search everywhere: sun low and high, all around, with rocks."""
    stones = scene.rocks([(0.9, 0.15, 0.1), (2.5, -0.3, 0.1), (0.4, -0.9, 0.1)], 0.25)
    world = scene.plane(heights=scene.hills(), stones=stones, shape=scene.block())
    config = scene.config(2.0, camera=CameraConfig(width=128, height=96))
    looked_for, of_rover = [], []
    may_shade = RoverShadow.may_shade
    with Renderer(world, scene.ROVER, config) as renderer:
        for elevation_deg in (2.0, 6.0, 35.0):
            renderer.set_sun(60.0, elevation_deg)
            for yaw_deg in np.arange(0.0, 360.0, 45.0):
                state = RoverPose(scene.pose(yaw_deg=yaw_deg), np.full(4, 0.4))
                frames = []
                for value in (None, True, False):
                    def shaded(shadow, boxes, links, axes, value=value):
                        found = may_shade(shadow, boxes, links, axes)
                        looked_for.extend([found.mean()] if len(boxes) else [])
                        return found if value is None else np.full(len(boxes), value)
                    monkeypatch.setattr(RoverShadow, 'may_shade', shaded)
                    frames.append(renderer.render(state, 0, ('radiance',)).radiance)
                assert np.array_equal(frames[0], frames[1]), (elevation_deg, yaw_deg)
                of_rover.append((frames[1] != frames[2]).mean())
    # There is something to find, and little of the ground is searched.
    assert max(of_rover) > 0.1 and np.median(of_rover) < 0.01
    assert np.median(looked_for) < 0.05
