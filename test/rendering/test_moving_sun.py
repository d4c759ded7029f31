"""Moving the sun of a renderer gives what a new renderer under that sun gives."""

import dataclasses

import camera_scene as scene
import numpy as np

from lunar_rover_sim.camera.config import CameraConfig
from lunar_rover_sim.rendering.config import DetailConfig
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

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
