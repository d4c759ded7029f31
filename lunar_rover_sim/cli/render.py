"""`lunar_rover_sim render`: single stereo frames of a scenario with all truth layers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import ConfigError, RenderError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.options import numbers
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.image.camera.cameras import CameraEntry, chase_camera, hazard_camera
from lunar_rover_sim.image.camera.chase import ChaseConfig, SAMPLES
from lunar_rover_sim.image.rendering.frame import LAYERS
from lunar_rover_sim.image.rendering.layer_pictures import contact_sheet
from lunar_rover_sim.image.rendering.snapshot import HEIGHT_M, settle, settled, standing
from lunar_rover_sim.rover.description import MOST_LEGS
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.node_config import RenderNodeConfig
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.scenario import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Draw what the rover sees at given poses: left and right image (PNG), depth '
        '[m], normals, labels, craters, shadow and ideal radiance (NPY), disparity, and a '
        'preview of all.')
    options.add_scenario(parser)
    parser.add_argument('--pose', action='append', metavar='X,Y,YAW[,Z]', type=numbers(3, 4),
                        help='where the rover stands [m, m, deg]; Z is the height of base_link '
                        'above the ground, 0.09 by default; may be repeated')
    parser.add_argument('--joints', metavar='A,B,…', default=[],
                        type=numbers(*range(1, MOST_LEGS + 1)),
                        help='angle of each leg [deg] (default: 0)')
    parser.add_argument('--twist', metavar='VX,VY,VZ,WX,WY,WZ', type=numbers(6),
                        default=[0.0] * 6, help='velocity of the rover in axes of base_link '
                        '[m/s, rad/s], which blurs the images over the exposure; zero by default')
    parser.add_argument('--chase', action='store_true', help='also draw the rover from outside '
                        '(PNG); render_node.chase.* are the parameters of that camera')
    parser.add_argument('--chase-from', metavar='DISTANCE,AZIMUTH,ELEVATION', type=numbers(3),
                        help='where that camera is [m, deg, deg], by default 1.5,-112,17; the '
                        'azimuth counts from the sun, or as chase.reference says')
    parser.add_argument('--camera', action='append', default=[], metavar='NAME', dest='cameras',
                        help='also draw the hazard camera render_node.hazard.NAME (PNG), or a '
                        'pair; may be repeated')
    options.add_new_folder(parser, 'folder for the pictures')
    options.add_world(parser)
    parser.add_argument('--at', type=Path, metavar='BAG', help='with the tracks that a recording '
                        'left on soft ground, and in its world')
    parser.add_argument('--time', type=float, metavar='S', help='simulated time of these tracks '
                        '[s] (default: the end)')
    options.add_seed(parser)
    options.add_overrides(parser)


def run(args: argparse.Namespace) -> int:
    """Draw and save."""
    if args.time is not None and args.at is None:
        raise ConfigError('--time: needs --at BAG')
    folder = args.world
    if folder is None and args.at is not None:
        with open_bag(args.at) as bag:
            folder = RecordedRun(bag).world_folder()
    scenario = Scenario.load(args.scenario, args.overrides, seed=args.seed, world=folder)
    others = _others(args, scenario.render_node)
    with Progress('building the world'):
        overlay = None
        if args.at is not None:
            with open_bag(args.at) as bag:
                world, overlay = RecordedRun(bag).ground(args.time, folder)
        else:
            world = load_world(folder or cached(scenario.world, scenario.shared.seed))
    angles = np.radians(args.joints)
    poses = [_standing(world, pose) for pose in args.pose or [(0.0, 0.0, 0.0, HEIGHT_M)]]
    with Progress('computing the sunlight'):
        renderer = scenario.renderer(world)
    with renderer:
        renderer.follow(overlay)
        mounts = [entry.mount(world, renderer.config.sun.azimuth_deg)
                  for entry in others if entry.mount is not None]
        drawn = [renderer.add_camera(entry.config, mount, samples=SAMPLES if isinstance(
            entry.config, ChaseConfig) else 1) for entry, mount in zip(others, mounts)]
        matcher = scenario.matcher()
        make_new_folder(args.output)
        for k, T in enumerate(poses):
            state = RoverPose(T, angles, np.array(args.twist[:3]), np.array(args.twist[3:]))
            settle(renderer, state)
            frame = renderer.render(state, k, LAYERS)
            name = f'{k:03d}'
            out = args.output
            for side in ('left', 'right'):
                _save_picture(out / f'{name}_{side}.png', frame.picture(side))
            for layer in ('depth_m', 'normal', 'label', 'radiance', 'crater', 'shadow'):
                _save_array(out / f'{name}_{layer}.npy', getattr(frame, layer))
            disparity = matcher.match(frame.picture('left'), frame.picture('right'))
            _save_array(out / f'{name}_disparity_px.npy', disparity.disparity_px)
            sheet = contact_sheet(frame, disparity.disparity_px, disparity.depth_m)
            _save_picture(out / f'{name}_preview.png', sheet[..., ::-1])    # it is BGR
            for entry, mount, camera in zip(others, mounts, drawn):
                mount.follow(state, k)
                settled(camera, state)
                pictures = camera.render(state, k, entry.images.values())
                for word, layer in entry.images.items():
                    _save_picture(out / f'{name}_{word}.png', pictures.picture(layer))
            say(f'{out / name}: exposure {1e3 * frame.exposure_s:.2f} ms, '
                f'disparity on {100 * disparity.valid.mean():.0f} % of the image')
    return 0


def _save_picture(path: Path, pixels: NDArray[Any]) -> None:
    atomic_write(path, png_bytes(pixels), RenderError)


def _save_array(path: Path, values: NDArray[Any]) -> None:
    atomic_write(path, lambda stream: np.save(stream, values, allow_pickle=False), RenderError)


def _standing(world: World, pose: Sequence[float]) -> Array:
    """Return T_world_base (4, 4) of one --pose."""
    try:
        return standing(world, *pose)
    except ConfigError as error:
        raise ConfigError(f'--{error}') from None


def _others(args: argparse.Namespace, config: RenderNodeConfig) -> list[CameraEntry]:
    """Return the cameras besides the pair that are asked for."""
    chase, found = config.chase, list[CameraEntry]()
    if args.chase_from is not None:
        distance_m, azimuth_deg, elevation_deg = args.chase_from
        try:
            chase = dataclasses.replace(chase, distance_m=distance_m, azimuth_deg=azimuth_deg,
                                        elevation_deg=elevation_deg)
        except ConfigError as error:
            raise ConfigError(f'--chase-from: {error}') from None
    if args.chase or args.chase_from is not None:
        found.append(chase_camera(chase))
    for name in args.cameras:
        if name not in config.hazard:
            raise ConfigError(f'--camera {name}: no such camera; ' + (
                nearest(name, config.hazard) if config.hazard else 'the scenario has none; set '
                f'render_node.hazard.{name}.rate_hz=5, for example'))
        found.append(hazard_camera(name, config.hazard[name]))
    return found
