"""Contrast of relief below the grid by the view, against rays cast at the heights of its tiles."""

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

SUN = scene.SunConfig(azimuth_deg=0.0, elevation_deg=15.0)


def light_over_law(by_view):
    """Return of towards the sun and away from it: light over the law at 1.3 to 3 m."""
    detail = DetailConfig(bounce=False, smooth_outlines=False, contrast_by_view=by_view)
    config = scene.config(sun=SUN, detail=detail, camera=CameraConfig(320, 240))
    ground, result = hapke.parameter_set(config.reflectance.ground), []
    with Renderer(scene.plane(257, far=False), scene.ROVER, config, 1) as renderer:
        for yaw_deg in (0.0, 180.0):
            state = RoverPose(scene.pose(yaw_deg=yaw_deg))
            frame = renderer.render(state, 0, ('radiance', 'depth', 'shadow'))
            T = state.T_world_base @ renderer.rig.T_base_left
            ray = renderer.rig.rays() @ T[:3, :3].T
            view = -ray / np.linalg.norm(ray, axis=-1, keepdims=True)
            some = (frame.depth_m > 1.3) & (frame.depth_m < 3.0) & (frame.shadow[..., 1] == 0)
            sun = renderer.sun_direction
            law = hapke.reflectance(sun[2], view[some][:, 2], view[some] @ sun, ground,
                                    albedo=config.reflectance.albedo_scale)
            result.append(frame.radiance[some] / (config.sun.irradiance * law))
    return result


def test_contrast_follows_the_view_and_the_mean_stays():
    """Away from the sun hardly any shadow is seen, towards it there is more texture."""
    (towards, away), (now_towards, now_away) = light_over_law(False), light_over_law(True)
    for drawn in (now_towards, now_away):
        assert drawn.mean() == pytest.approx(1.0, abs=0.06)
    assert now_away.std() < 0.6 * away.std() and now_towards.std() > 1.1 * towards.std()
    assert (now_away < 0.25).mean() < 0.3 * (away < 0.25).mean()
