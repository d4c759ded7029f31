"""Error of radiance, against images of 8 x 8 times the pixels.

    python test/benchmarks/bench_edges.py [--scenarios baseline feature_sparse]
        [--elevations 6 15] [--samples 1 2 3] [--width 320] [--times 8]

Prints a table in Markdown; asserts nothing. Each row is a scenario and an elevation of the sun,
over views towards the sun, across and away from it. Errors are RMS over pixels that a rock covers
in part, then over all pixels but those of the sun and the rover, each over that of an image with
steps: without `detail.smooth_outlines`, one sample a pixel.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from brightness import DIRECTIONS_DEG, views  # noqa: E402
from resolution import finer_camera  # noqa: E402

from lunar_rover_sim.base.frames import Array  # noqa: E402
from lunar_rover_sim.ground.world.model import World  # noqa: E402
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK, rover_links  # noqa: E402
from lunar_rover_sim.image.rendering.renderer import Renderer  # noqa: E402
from lunar_rover_sim.rover.pose import RoverPose  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

_MOST = 300.0           # radiance that only the sun's disc exceeds [W m-2 sr-1]
_BORDER = 3             # rows at top and bottom that are left out


def renderer_of(name: str, width: int, world: World | None, **detail: object) -> Renderer:
    """Return a renderer of a scenario with some values of `detail`."""
    return Scenario.load(name, [
        f'render_node.camera.width={width}', f'render_node.camera.height={width * 3 // 4}',
        *(f'render_node.detail.{key}={value}' for key, value in detail.items())]).renderer(world)


def states(renderer: Renderer) -> list[RoverPose]:
    """Return a rover in each direction to the sun."""
    return [views(renderer, direction, 2)[1] for direction in DIRECTIONS_DEG]


def means(fine: Array, times: int) -> Array:
    """Return the means of blocks of so many pixels along a side."""
    h, w = fine.shape
    return fine.astype(float).reshape(h // times, times, w // times, times).mean((1, 3))


def references(renderer: Renderer, times: int) -> list[tuple[Array, Array, Array]]:
    """Return radiance of each view, which of its pixels count, and which lie at edges of rocks."""
    finer, result = finer_camera(renderer, times), []
    for state in states(renderer):
        frame = finer.render(state, 0, ('radiance', 'label'))
        assert frame.radiance is not None and frame.label is not None
        radiance = means(frame.radiance, times)
        rock = means(frame.label >= LABEL_FIRST_ROCK, times)
        counts = (radiance < _MOST) & (means(rover_links(frame.label), times) == 0.0)
        counts[:_BORDER] = counts[-_BORDER:] = False
        result.append((radiance, counts, counts & (rock > 0.0) & (rock < 1.0)))
    return result


def error(renderer: Renderer, expected: list[tuple[Array, Array, Array]]) -> Array:
    """Return the (2,) RMS errors at edges of rocks and of all, over all views [W m-2 sr-1]."""
    squares, counts = np.zeros(2), np.zeros(2)
    for state, (radiance, inside, edge) in zip(states(renderer), expected):
        drawn = renderer.render(state, 0, ('radiance',)).radiance
        assert drawn is not None
        for k, pixels in enumerate((edge, inside)):
            squares[k] += np.sum((drawn - radiance)[pixels]**2)
            counts[k] += np.count_nonzero(pixels)
    return np.sqrt(squares / counts)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--scenarios', nargs='+', default=('baseline', 'feature_sparse'))
    parser.add_argument('--elevations', nargs='+', type=float, default=(6.0, 15.0))
    parser.add_argument('--samples', nargs='+', type=int, default=(1, 2, 3))
    parser.add_argument('--width', type=int, default=320, help='of the coarser image [px]')
    parser.add_argument('--times', type=int, default=8, help='pixels along a side for one')
    args = parser.parse_args()
    columns = [f'{k} × {k}, {what}' for what in ('edges', 'all') for k in args.samples]
    print('| scenario | sun | ' + ' | '.join(columns) + ' |')
    print('|---' * (2 + len(columns)) + '|')
    for name in args.scenarios:
        world = None
        kinds = [{'smooth_outlines': 'false'}, *({'supersampling': k} for k in args.samples)]
        expected = dict[float, list[tuple[Array, Array, Array]]]()
        errors = dict[float, list[Array]]()
        for number, detail in enumerate(kinds):
            with renderer_of(name, args.width, world, **detail) as renderer:
                world = renderer.world
                for elevation in args.elevations:
                    renderer.set_sun(renderer.config.sun.azimuth_deg, elevation)
                    if number == 0:
                        errors[elevation] = []
                        with renderer_of(name, args.width, world) as other:
                            other.set_sun(other.config.sun.azimuth_deg, elevation)
                            expected[elevation] = references(other, args.times)
                    errors[elevation].append(error(renderer, expected[elevation]))
        for elevation, (steps, *smooth) in errors.items():
            ratios = np.array(smooth) / steps
            print(f'| {name} | {elevation:g}° | '
                  + ' | '.join(f'{ratio:.2f}' for ratio in ratios.T.ravel()) + ' |', flush=True)


if __name__ == '__main__':
    main()
