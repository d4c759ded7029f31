"""`lunar_rover_sim render`: single stereo frames of a scenario with all truth layers."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lunar_rover_sim.camera.renderer import Renderer
    from lunar_rover_sim.frames import Array
    from lunar_rover_sim.world.model import World


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        'render', help='draw single stereo frames with all truth layers',
        description='Draw what the rover sees at given poses: left and right image (PNG), depth '
        '[m], normals, labels and ideal radiance (NPY), disparity, and a preview of all.')
    parser.add_argument('scenario', help='name of a packaged scenario, or a YAML file')
    parser.add_argument('--pose', action='append', metavar='X,Y,YAW[,Z]', type=_pose,
                        help='where the rover stands [m, m, deg]; Z is the height of base_link '
                        'above the ground, 0.09 by default; may be repeated')
    parser.add_argument('--joints', metavar='A,B,C,D', type=_numbers(4), default=[0.0] * 4,
                        help='leg angles [deg]')
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for the pictures; must not exist')
    parser.add_argument('--world', type=Path, metavar='DIR', help='a world made by `world build`')
    parser.add_argument('--seed', type=int, metavar='N', help='seed of everything random')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    # Let argparse take `--pose -2,3,240` as a value, as it does `-2`.
    parser._negative_number_matcher = re.compile(r'^-\.?\d')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Draw and save."""
    import cv2
    import numpy as np
    from rich.console import Console

    from lunar_rover_sim.camera.preview import contact_sheet
    from lunar_rover_sim.camera.frame import LAYERS
    from lunar_rover_sim.camera.renderer import Renderer
    from lunar_rover_sim.config import load_scenario
    from lunar_rover_sim.errors import ConfigError
    from lunar_rover_sim.stereo.depth import depth_from_disparity
    from lunar_rover_sim.stereo.sgm import SgmMatcher
    from lunar_rover_sim.world.store import cached, load

    scenario = load_scenario(args.scenario, args.overrides, args.seed)
    if args.output.exists():
        raise ConfigError(f'output: {args.output} exists; name a new folder')
    console = Console()
    with console.status('building the world'):
        folder = args.world or cached(scenario.world, scenario.shared.seed)
        world = load(folder)
    config = scenario.render_node
    angles = np.radians(args.joints)
    with console.status('computing the sunlight'):
        renderer = Renderer(world, scenario.rover, config, scenario.shared.seed)
    with renderer:
        matcher = SgmMatcher(config.sgm)
        rig = renderer.rig
        args.output.mkdir(parents=True)
        for k, pose in enumerate(args.pose or [(0.0, 0.0, 0.0, _HEIGHT_M)]):
            T = standing(world, *pose)
            settle(renderer, T, angles)
            frame = renderer.render(T, angles, k, LAYERS)
            name = f'{k:03d}'
            out = args.output
            for side in ('left', 'right'):
                cv2.imwrite(str(out / f'{name}_{side}.png'), getattr(frame, side))
            for layer in ('depth_m', 'normal', 'label', 'radiance'):
                np.save(out / f'{name}_{layer}.npy', getattr(frame, layer))
            assert frame.left is not None and frame.right is not None
            disparity = matcher.match(frame.left, frame.right)
            np.save(out / f'{name}_disparity_px.npy', disparity.disparity_px)
            depth = depth_from_disparity(disparity, rig.focal_px, rig.baseline_m)
            cv2.imwrite(str(out / f'{name}_preview.png'), contact_sheet(frame, depth))
            console.print(f'{out / name}: exposure {1e3 * frame.exposure_s:.2f} ms, '
                          f'disparity on {100 * disparity.valid.mean():.0f} % of the image')
    return 0


_HEIGHT_M = 0.09
_SETTLED, _MOST_FRAMES = 0.01, 60


def settle(renderer: Renderer, T_world_base: Array, joint_angle_rad: Array) -> None:
    """Let automatic exposure come to rest at a pose, as it would have on the way there."""
    if renderer.config.sensor.exposure_mode != 'auto':
        return
    last = 0.0
    for k in range(_MOST_FRAMES):
        exposure_s = renderer.render(T_world_base, joint_angle_rad, k, ('left',)).exposure_s
        if abs(exposure_s - last) < _SETTLED * exposure_s:
            return
        last = exposure_s


def standing(world: World, x_m: float, y_m: float, yaw_deg: float,
             height_m: float = _HEIGHT_M) -> Array:
    """Return T_world_base of a rover that stands upright on the slope at a place."""
    import numpy as np

    from lunar_rover_sim.errors import ConfigError
    from lunar_rover_sim.frames import se3
    ground = float(world.height_at((x_m, y_m)))
    if not np.isfinite(ground):
        raise ConfigError(f'pose: ({x_m:g}, {y_m:g}) lies outside the world')
    reach = 0.15
    slope = [(float(world.height_at((x_m + reach * dx, y_m + reach * dy)))
              - float(world.height_at((x_m - reach * dx, y_m - reach * dy)))) / (2 * reach)
             for dx, dy in ((1, 0), (0, 1))]
    up = np.array([-slope[0], -slope[1], 1.0])
    up /= np.linalg.norm(up)
    yaw = np.radians(yaw_deg)
    left = np.cross(up, [np.cos(yaw), np.sin(yaw), 0.0])
    left /= np.linalg.norm(left)
    rotation = np.stack([np.cross(left, up), left, up], axis=1)
    return se3(rotation, np.array([x_m, y_m, ground]) + height_m * up)


def _pose(text: str) -> tuple[float, ...]:
    numbers = _split(text)
    if len(numbers) not in (3, 4):
        raise argparse.ArgumentTypeError(f'{text!r} is not X,Y,YAW or X,Y,YAW,Z')
    return tuple(numbers)


def _numbers(count: int):
    def convert(text: str) -> list[float]:
        numbers = _split(text)
        if len(numbers) != count:
            raise argparse.ArgumentTypeError(f'{text!r} is not {count} numbers')
        return numbers
    return convert


def _split(text: str) -> list[float]:
    try:
        return [float(part) for part in re.split(r'[,\s]+', text.strip())]
    except ValueError:
        raise argparse.ArgumentTypeError(f'{text!r} is not a list of numbers') from None
