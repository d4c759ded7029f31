"""Relief below the grid does not repeat: distant views match no better than other worlds do."""

import camera_scene as scene
import numpy as np
from repetition import features, inliers

from lunar_rover_sim.camera.config import SensorConfig
from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

AWAY_M = [(6.4, 0.0), (0.0, 6.4), (5.1, 0.0), (0.0, 5.1), (1.6, 0.0), (0.0, -3.2), (1.0, 0.0),
          (0.5, 0.866025), (12.8, 0.0), (-9.3, 14.1)]


def test_distant_views_match_no_better_than_other_worlds():
    """The same place 0.1 m further on shows that the matcher would find a repetition."""
    config = RenderConfig(sun=scene.SunConfig(azimuth_deg=60.0, elevation_deg=6.0),
                          sensor=SensorConfig(exposure_mode='auto'))
    world = scene.plane(n=513, cell_m=0.1)

    def pictures(seed):
        with Renderer(world, scene.ROVER, config, seed) as renderer:
            return [features(renderer.render(RoverPose(scene.pose(x, y, 0.09)), 0, ('left',)).left)
                    for x, y in [(0.0, 0.0), (0.0, 0.0), (0.1, 0.0), *AWAY_M]]
    here, there = pictures(1), pictures(2)
    assert inliers(here[1], here[2]) > 100
    same = [inliers(here[1], picture) for picture in here[3:]]
    other = [inliers(here[1], picture) for picture in there[3:]]
    assert max(same) <= max(max(other) + 4, 20), (same, other)
    assert np.mean(same) <= np.mean(other) + 4
