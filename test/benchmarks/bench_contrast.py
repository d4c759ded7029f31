"""Contrast and dark share of the ground by view and sun, against rays cast at the same relief.

    python test/benchmarks/bench_contrast.py [--suns 6 15 37] [--azimuths 0 60 120 180]
        [--distances 1.5 3 6 12] [--shape 0] [--seed 61]

The ground is level, with the relief below the grid of the default. Of each sun and azimuth between
sun and view, the pixels of a band around each distance are taken in the middle columns of the left
image (640 x 480 px); rays are cast at the heights of the tiles, 4 x 16 for each of 600 pixels as
large, along the same direction. Printed are standard deviation over mean, drawn and by rays; the
share of pixels with less than a quarter of the mean, likewise; and in how many cells they agree.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / part) for part in ('benchmarks', '.')]

import camera_scene as scene  # noqa: E402
from relief_rays import ReliefRays  # noqa: E402

from lunar_rover_sim.image.camera.config import CameraConfig  # noqa: E402
from lunar_rover_sim.image.illumination import hapke  # noqa: E402
from lunar_rover_sim.image.illumination.config import SunConfig  # noqa: E402
from lunar_rover_sim.image.rendering.config import DetailConfig  # noqa: E402
from lunar_rover_sim.image.rendering.relief_tiles import start_tiles  # noqa: E402
from lunar_rover_sim.image.rendering.renderer import Renderer  # noqa: E402
from lunar_rover_sim.rover.pose import RoverPose  # noqa: E402

DARK = 0.25
WITHIN, POINTS = 0.2, 0.5


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--suns', nargs='+', type=float, default=(6.0, 15.0, 37.0))
    parser.add_argument('--azimuths', nargs='+', type=float, default=(0.0, 60.0, 120.0, 180.0))
    parser.add_argument('--distances', nargs='+', type=float, default=(1.5, 3.0, 6.0, 12.0))
    parser.add_argument('--shape', type=float, default=0.0, help='detail.relief_shape_m')
    parser.add_argument('--seed', type=int, default=61)
    args = parser.parse_args()
    detail = DetailConfig(bounce=False, smooth_outlines=False, relief_shape_m=args.shape)
    print(f'| sun | azimuth | {" | ".join(f"{d:g} m" for d in args.distances)} | contrast within '
          f'{WITHIN:.0%} | dark share within {POINTS:g} points |')
    print('|---' * (len(args.distances) + 4) + '|')
    for sun_deg in args.suns:
        config = scene.config(sun=SunConfig(azimuth_deg=0.0, elevation_deg=sun_deg),
                              detail=detail, camera=CameraConfig())
        with Renderer(scene.plane(1025, cell_m=0.05), scene.ROVER, config, args.seed) as renderer:
            ground = hapke.parameter_set(config.reflectance.ground)
            rays = ReliefRays(start_tiles(detail, args.seed, renderer.sun_direction).result(),
                              ground, config.reflectance.albedo_scale)
            for azimuth_deg in args.azimuths:
                drawn, view_of, size = bands(renderer, azimuth_deg, args.distances)
                cells, agree, dark_agree = [], 0, 0
                for light, view, side in zip(drawn, view_of, size):
                    view_and_size = np.tan(np.radians(sun_deg)), view, side, 600, (4, 16)
                    found = rays.pixels(*view_and_size)
                    one, other = light.std() / light.mean(), rays.contrast(*view_and_size)[0]
                    dark, dark_by_rays = (100.0 * (values < DARK * values.mean()).mean()
                                          for values in (light, found))
                    cells.append(f'{one:.2f}, {other:.2f}; {dark:.0f}, {dark_by_rays:.0f} %')
                    agree += abs(one / other - 1.0) < WITHIN
                    dark_agree += abs(dark - dark_by_rays) < POINTS
                print(f'| {sun_deg:g}° | {azimuth_deg:g}° | {" | ".join(cells)} | {agree} | '
                      f'{dark_agree} |', flush=True)


def bands(renderer, azimuth_deg, distances, places=6):
    """Return light over the law of the pixels around distances, views, sizes of pixels."""
    drawn = [[] for _ in distances]
    sun, reflectance = renderer.sun_direction, renderer.config.reflectance
    ground = hapke.parameter_set(reflectance.ground)
    rig = renderer.rig
    rays = rig.rays()
    middle = slice(rays.shape[1] // 2 - 60, rays.shape[1] // 2 + 60)
    views, sizes = [None] * len(distances), [0.0] * len(distances)
    for place in range(places):
        # The sun is towards x; a camera that sees it at azimuth 0 looks along +x.
        state = RoverPose(scene.pose(0.9 * place - 2.0, 1.7 * place - 4.0, yaw_deg=azimuth_deg))
        frame = renderer.render(state, 0, ('radiance', 'depth', 'shadow'))
        T = state.T_world_base @ rig.T_base_left
        ray = (rays @ T[:3, :3].T)[:, middle]
        depth, light = frame.depth_m[:, middle], frame.radiance[:, middle]
        free = frame.shadow[:, middle, 1] == 0
        far = depth * np.linalg.norm(ray, axis=-1)
        for k, distance in enumerate(distances):
            some = (np.abs(far / distance - 1.0) < 0.06) & (depth > 0.0) & free
            # Over the law of each view: what is left is contrast.
            to_camera = -ray[some] / np.linalg.norm(ray[some], axis=1, keepdims=True)
            law = hapke.reflectance(sun[2], to_camera[:, 2], to_camera @ sun, ground,
                                    albedo=reflectance.albedo_scale)
            drawn[k].append(light[some] / (renderer.config.sun.irradiance * law))
            view = to_camera.mean(axis=0)
            views[k] = view / np.linalg.norm(view)
            sizes[k] = distance / rig.focal_px
    return [np.concatenate(part) for part in drawn], views, sizes


if __name__ == '__main__':
    main()
