"""`lunar_rover_sim render`: single stereo frames of a scenario with all truth layers."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base.errors import ConfigError, RenderError
from lunar_rover_sim.base.files.arrays import npy_bytes
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.base.files.paths import make_new_folder
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.cli import options
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


@options.command(scenarios=True)
@options.scenario()
@click.option('--pose', 'poses', multiple=True, metavar='X,Y,YAW[,Z]',
              type=options.numbers(3, 4), help='where the rover stands [m, m, deg]; Z is the '
              'height of base_link above the ground, 0.09 by default; may be repeated')
@click.option('--joints', metavar='A,B,…', type=options.numbers(*range(1, MOST_LEGS + 1)),
              help='angle of each leg [deg] (default: 0)')
@click.option('--twist', metavar='VX,VY,VZ,WX,WY,WZ', type=options.numbers(6),
              help='velocity in axes of base_link [m/s, rad/s], which blurs the images; zero by '
              'default')
@click.option('--chase', is_flag=True, help='also draw the rover from outside (PNG), by '
              'render_node.chase.*')
@click.option('--chase-from', metavar='DISTANCE,AZIMUTH,ELEVATION', type=options.numbers(3),
              help='where that camera is [m, deg, deg], by default 1.5,-112,17; the azimuth '
              'counts from the sun, or as chase.reference says')
@click.option('--camera', 'cameras', multiple=True, metavar='NAME', help='also draw the hazard '
              'camera render_node.hazard.NAME (PNG), or a pair; may be repeated')
@options.new_folder('folder for the pictures')
@options.world()
@click.option('--at', type=options.PATH, metavar='BAG', help='with the tracks that a recording '
              'left on soft ground, and in its world')
@click.option('--time', type=float, metavar='S',
              help='simulated time of these tracks [s] (default: the end)')
@options.seed()
@options.overrides()
def render(scenario: str, poses: Sequence[tuple[float, ...]], joints: tuple[float, ...] | None,
           twist: tuple[float, ...] | None, chase: bool, chase_from: tuple[float, ...] | None,
           cameras: Sequence[str], output: Path, world: Path | None, at: Path | None,
           time: float | None, seed: int | None, overrides: list[str]) -> int:
    """Draw what the rover sees at given poses.

    Left and right image (PNG), depth [m], normals, labels, craters, shadow and ideal radiance
    (NPY), disparity, and a preview of all.
    """
    if time is not None and at is None:
        raise ConfigError('--time: needs --at BAG')
    folder = world
    if folder is None and at is not None:
        with open_bag(at) as bag:
            folder = RecordedRun(bag).world_folder()
    loaded = Scenario.load(scenario, overrides, seed=seed, world=folder)
    others = _others(loaded.render_node, chase, chase_from, cameras)
    with Progress('building the world'):
        overlay = None
        if at is not None:
            with open_bag(at) as bag:
                ground, overlay = RecordedRun(bag).ground(time, folder)
        else:
            ground = load_world(folder or cached(loaded.world, loaded.shared.seed))
    angles = np.radians(joints or ())
    velocity = np.array(twist or (0.0,) * 6)
    places = [_standing(ground, pose) for pose in poses or [(0.0, 0.0, 0.0, HEIGHT_M)]]
    with Progress('computing the sunlight'):
        renderer = loaded.renderer(ground)
    with renderer:
        renderer.follow(overlay)
        mounts = [entry.mount(ground, renderer.config.sun.azimuth_deg)
                  for entry in others if entry.mount is not None]
        drawn = [renderer.add_camera(entry.config, mount, samples=SAMPLES if isinstance(
            entry.config, ChaseConfig) else 1) for entry, mount in zip(others, mounts)]
        matcher = loaded.matcher()
        make_new_folder(output)
        for k, T in enumerate(places):
            state = RoverPose(T, angles, velocity[:3], velocity[3:])
            settle(renderer, state)
            frame = renderer.render(state, k, LAYERS)
            name = f'{k:03d}'
            for side in ('left', 'right'):
                _save_picture(output / f'{name}_{side}.png', frame.picture(side))
            for layer in ('depth_m', 'normal', 'label', 'radiance', 'crater', 'shadow'):
                _save_array(output / f'{name}_{layer}.npy', getattr(frame, layer))
            disparity = matcher.match(frame.picture('left'), frame.picture('right'))
            _save_array(output / f'{name}_disparity_px.npy', disparity.disparity_px)
            sheet = contact_sheet(frame, disparity.disparity_px, disparity.depth_m)
            _save_picture(output / f'{name}_preview.png', sheet[..., ::-1])    # it is BGR
            for entry, mount, camera in zip(others, mounts, drawn):
                mount.follow(state, k)
                settled(camera, state)
                pictures = camera.render(state, k, entry.images.values())
                for word, layer in entry.images.items():
                    _save_picture(output / f'{name}_{word}.png', pictures.picture(layer))
            say(f'{output / name}: exposure {1e3 * frame.exposure_s:.2f} ms, '
                f'disparity on {100 * disparity.valid.mean():.0f} % of the image')
    return 0


def _save_picture(path: Path, pixels: NDArray[Any]) -> None:
    atomic_write(path, png_bytes(pixels), RenderError)


def _save_array(path: Path, values: NDArray[Any]) -> None:
    atomic_write(path, npy_bytes(values), RenderError)


def _standing(world: World, pose: Sequence[float]) -> Array:
    """Return T_world_base (4, 4) of one --pose."""
    try:
        return standing(world, *pose)
    except ConfigError as error:
        raise ConfigError(f'--{error}') from None


def _others(config: RenderNodeConfig, with_chase: bool, chase_from: tuple[float, ...] | None,
            cameras: Sequence[str]) -> list[CameraEntry]:
    """Return the cameras besides the pair that are asked for."""
    chase, found = config.chase, list[CameraEntry]()
    if chase_from is not None:
        distance_m, azimuth_deg, elevation_deg = chase_from
        try:
            chase = dataclasses.replace(chase, distance_m=distance_m, azimuth_deg=azimuth_deg,
                                        elevation_deg=elevation_deg)
        except ConfigError as error:
            raise ConfigError(f'--chase-from: {error}') from None
    if with_chase or chase_from is not None:
        found.append(chase_camera(chase))
    for name in cameras:
        if name not in config.hazard:
            raise ConfigError(f'--camera {name}: no such camera; ' + (
                nearest(name, config.hazard) if config.hazard else 'the scenario has none; set '
                f'render_node.hazard.{name}.rate_hz=5, for example'))
        found.append(hazard_camera(name, config.hazard[name]))
    return found
