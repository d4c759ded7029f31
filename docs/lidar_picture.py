"""The picture of the LiDAR in the documentation: one scan in the left image, and from above.

    python docs/lidar_picture.py resource/pictures/lidar.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.lidar.motion import ScanMotion
from lunar_rover_sim.image.rendering.snapshot import settle, standing
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

matplotlib.use('Agg')
from matplotlib import pyplot  # noqa: E402  (behind the choice of a backend)

# More rocks than `baseline` has, so that many beams meet one.
SETTINGS = ('world.rocks.abundance=0.12', 'world.rocks.min_diameter_m=0.1')
YAW_DEG = 165.0             # the sun is at the right, a little behind
SHOWN_M = 10.0


def main() -> None:
    """Draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('output', type=Path)
    args = parser.parse_args()
    scenario = Scenario.load('baseline', SETTINGS)
    world = scenario.load_world()
    rover = scenario.rover
    T_world_base = standing(world, 0.0, 0.0, YAW_DEG, rover.standing_height_m)
    state = RoverPose(T_world_base, np.zeros(4))
    with scenario.renderer(world) as renderer:
        settle(renderer, state)
        image = np.asarray(renderer.render(state, 0, ('left',)).left)
    lidar = scenario.lidar(world)
    cloud = lidar.scan(ScanMotion([0.0, 0.1], [T_world_base, T_world_base])).cloud()
    points = np.stack([cloud[axis] for axis in 'xyz'], axis=1).astype(float)
    T = T_world_base @ lidar.T_base_lidar
    rig = StereoRig(rover, scenario.render_node.camera)
    left_px, _ = rig.project(points @ T[:3, :3].T + T[:3, 3], T_world_base)
    ahead = points[:, 0] > 0.3
    figure, (seen, above) = pyplot.subplots(1, 2, figsize=(11.0, 4.3), dpi=100,
                                            width_ratios=(1.25, 1.0), layout='constrained')
    seen.imshow(image, cmap='gray', vmin=0, vmax=255)
    shape = np.array([image.shape[1], image.shape[0]])
    inside = ahead & ((left_px >= 0) & (left_px < shape)).all(axis=1)
    seen.scatter(*left_px[inside].T, c=np.log(np.linalg.norm(points[inside], axis=1)), s=2.0,
                 cmap='turbo', linewidths=0)
    seen.set_axis_off()
    shown = above.scatter(points[:, 0], points[:, 1], c=cloud['intensity'], s=1.5, vmin=15.0,
                          vmax=50.0, linewidths=0)
    above.set(xlim=(-SHOWN_M, SHOWN_M), ylim=(-SHOWN_M, SHOWN_M), aspect='equal',
              xlabel='x [m], lidar_link', ylabel='y [m]')
    figure.colorbar(shown, label='intensity [%]')
    figure.savefig(args.output)


if __name__ == '__main__':
    main()
