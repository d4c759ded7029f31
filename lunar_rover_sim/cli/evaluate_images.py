"""`lunar_rover_sim evaluate images`: the gap between two renderers, cameras or worlds."""

from __future__ import annotations

from pathlib import Path

import click
from rich.text import Text

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_table, Progress, say
from lunar_rover_sim.judge.evaluation.image_comparison import (compare_images, DISTANCE, FRAMES,
                                                               ImageComparison, save_comparison)
from lunar_rover_sim.judge.evaluation.image_statistics import MEASURES
from lunar_rover_sim.judge.evaluation.statistics import Difference, SeriesMean

JSON_FILE, FIGURE_FILE = 'comparison.json', 'comparison.png'


@options.command()
@options.argument('first', 'set of images', metavar='A')
@options.argument('second', 'set of images', metavar='B')
@click.option('--frames', type=int, default=FRAMES, metavar='N',
              help='images of each set, evenly over it')
@click.option('--width', type=int, metavar='PX',
              help='scale images down to this width (default: that of the narrower set)')
@options.seed(1, 'seed of the resampling')
@options.folder(f'folder for {JSON_FILE} and {FIGURE_FILE}', required=False)
def images(first: str, second: str, frames: int, width: int | None, seed: int,
           output: Path | None) -> int:
    """Compare two sets of images.

    By gradients, spectrum, shadow, ORB and matching, with 95 % intervals. A set is a bag, a
    sequence, LuSNAR, POLAR, or a folder of pictures.
    """
    with Progress('measuring') as progress:
        result = compare_images(first, second, frames=frames, width_px=width,
                                seed=seed, progress=progress.advance)
    _print(result)
    if output is not None:
        path = output / JSON_FILE
        save_comparison(result, output / FIGURE_FILE)
        atomic_write(path, json_text(result.to_mapping()) + '\n', EvaluationError)
        for written in (path, output / FIGURE_FILE):
            say(written)
    return 0


def _print(result: ImageComparison) -> None:
    for name, one in (('A', result.first), ('B', result.second)):
        say(f'{name}: {one.images.path} ({one.images.layout}, {len(one.values)} of '
            f'{one.images.total})')
    say(f'compared at a width of {result.width_px} px'
        f'{", image by image (the names are the same)" if result.paired else ""}, '
        '95 % intervals; q is p corrected for the number of rows')
    rows = [(Text(row.name), _value(row.first), _value(row.second), _value(row.difference),
             _p(row.difference.p), _p(q), f'{row.first.n}, {row.second.n}')
            for row, q in zip(result.rows, result.q) if row.first.n or row.second.n]
    distance = result.distance
    rows.append((Text(DISTANCE), '', '', _value(distance), _p(distance.p),
                 _p(result.q[-1]), f'{len(result.first.values)}, {len(result.second.values)}'))
    print_table(('', 'A', 'B', 'B - A', 'p', 'q', 'n'), 1, rows, box=None, pad_edge=False)
    if result.chance == result.chance:
        say(f'{DISTANCE}: Wasserstein, in decades; images shuffled between the sets '
            f'reach {result.chance:.3g}')
    if resembling := result.resembling:
        say('neighbouring images resemble each other: intervals and p of '
            f'{", ".join(resembling)} are too small (correlation up to '
            f'{max(resembling.values()):.1f}); compare fewer images by --frames, or more '
            'drives')
    missing = [row.name for row in result.rows if not row.first.n or not row.second.n]
    if missing:
        say(f'not in both sets: {", ".join(missing)} (pairs or truth are missing)')
    for row in result.rows:
        say(f'{row.name}: {MEASURES[row.name]}')


def _value(found: SeriesMean | Difference) -> str:
    if found.value != found.value:
        return '-'
    text = _number(found.value)
    return text if found.low != found.low else (
        f'{text} [{_number(found.low)}, {_number(found.high)}]')


def _number(value: float) -> str:
    return f'{value:.0f}' if abs(value) >= 1000.0 else f'{value:.3g}'


def _p(p: float) -> str:
    return '-' if p != p else '< 0.002' if p < 0.002 else f'{p:.3f}'
