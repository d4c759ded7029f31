"""`lunar_rover_sim validate stereo`: SGM on rendered pairs, against true depth."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib
from matplotlib import pyplot
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.folders import make_new
from lunar_rover_sim.rendering.layer_pictures import depth_picture, error_picture, gray8
from lunar_rover_sim.rendering.renderer import Renderer
from lunar_rover_sim.rendering.snapshot import settle, standing
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import load_scenario
from lunar_rover_sim.stereo.depth import depth_from_disparity, disparity_from_depth
from lunar_rover_sim.stereo.error import stereo_errors, StereoErrors
from lunar_rover_sim.stereo.sgm import SgmMatcher
from lunar_rover_sim.world.cache import cached
from lunar_rover_sim.world.world_folder import load_world


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = (
        'Draw stereo pairs along a loop through each scenario, match them, and say '
        'how dense and how right the disparity is: a table, and figures with left image, true '
        'depth, SGM depth and error.')
    parser.add_argument('scenarios', nargs='+', metavar='SCENARIO',
                        help='names of packaged scenarios, or YAML files')
    parser.add_argument('-n', '--frames', type=int, default=12, help='pairs per scenario')
    parser.add_argument('-o', '--output', required=True, type=Path, metavar='DIR',
                        help='folder for table and figures; must not exist')
    parser.add_argument('--seed', type=int, metavar='N', help='seed of everything random')
    parser.add_argument('--set', action='append', default=[], metavar='NODE.PARAM=VALUE',
                        dest='overrides', help='override one parameter; may be repeated')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Draw, match, judge, and save."""
    if args.frames < 1:
        raise ConfigError(f'frames: {args.frames} is not valid; valid is >= 1')
    scenarios = [load_scenario(name, args.overrides, args.seed) for name in args.scenarios]
    make_new(args.output)
    console = Console()
    results: dict[str, dict[str, float]] = {}
    for scenario in scenarios:
        results[scenario.name] = _judge(scenario, args.frames, args.output, console)
    table = Table(title='SGM against true depth')
    table.add_column('')
    for name in results:
        table.add_column(name, justify='right')
    for row in next(iter(results.values())):
        values = [results[name][row] for name in results]
        table.add_row(row, *(f'{v:.3f}' if row.endswith('[px]') else f'{100 * v:.1f} %'
                             for v in values))
    console.print(table)
    (args.output / 'stereo.json').write_text(json.dumps(results, indent=1) + '\n')
    console.print(f'written to {args.output}')
    return 0


def _judge(scenario, frames: int, folder: Path, console) -> dict[str, float]:
    """Return the summary of one scenario; save a figure of its first and middle frame."""
    with console.status(f'{scenario.name}: world and sunlight'):
        world = load_world(cached(scenario.world, scenario.shared.seed))
        renderer = Renderer(world, scenario.rover, scenario.render_node, scenario.shared.seed)
    total = StereoErrors()
    with renderer:
        rig, matcher = renderer.rig, SgmMatcher(scenario.render_node.sgm)
        shift = np.linalg.inv(rig.T_base_left) @ rig.T_base_right
        radius = 0.15 * world.ground.half_extent_m
        for k in track(range(frames), description=scenario.name, console=console):
            # A circle, looking ahead: all directions to the sun have their share.
            angle = 2.0 * np.pi * k / frames
            pose = standing(world, radius * np.cos(angle), radius * np.sin(angle),
                            float(np.degrees(angle) + 90.0))
            settle(renderer, RoverPose(pose))
            frame = renderer.render(RoverPose(pose), k, ('left', 'right', 'depth'))
            # The right camera's depth: the left camera put where the right one is.
            moved = pose @ (rig.T_base_left @ shift @ np.linalg.inv(rig.T_base_left))
            other = renderer.render(RoverPose(moved), k, ('depth',))
            assert frame.left is not None and frame.right is not None
            assert frame.depth_m is not None and other.depth_m is not None
            disparity = matcher.match(frame.left, frame.right)
            truth = [disparity_from_depth(depth, rig.focal_px, rig.baseline_m)
                     for depth in (frame.depth_m, other.depth_m)]
            total += stereo_errors(disparity, truth[0], truth[1], frame.left)
            if k in (0, frames // 2):
                _figure(folder / f'{scenario.name}_{k:03d}.png', frame, disparity, truth[0], rig)
    return total.summary()


def _figure(path: Path, frame, disparity, truth_px, rig) -> None:
    """Save left image, true depth, SGM depth and disparity error side by side."""
    matplotlib.use('Agg')
    depth = depth_from_disparity(disparity, rig.focal_px, rig.baseline_m)
    error = np.where(disparity.valid & (truth_px > 0.0),
                     np.abs(disparity.disparity_px - truth_px), np.nan)
    panels = [('left image', gray8(frame.left)), ('true depth, 0.3 to 20 m',
              depth_picture(frame.depth_m)), ('SGM depth', depth_picture(depth)),
              ('disparity error, 0 to 2 px', error_picture(error, 2.0))]
    figure, axes = pyplot.subplots(1, 4, figsize=(20, 4.2), layout='constrained')
    for axis, (title, picture) in zip(axes, panels):
        axis.imshow(picture[..., ::-1])
        axis.set_title(title)
        axis.set_axis_off()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
