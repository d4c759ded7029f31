"""`lunar_rover_sim evaluate map`: the maps of a recorded drive against its world."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.results import json_text
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import print_json, print_table, say
from lunar_rover_sim.judge.evaluation.map_evaluation import CELL_M, evaluate_maps, NEAR_M, Rates


@options.command(help=f"""Judge the maps of a recorded drive against its world.

    Prints the error of the elevation and of the flags of rocks in cells of {100 * CELL_M:g} cm, by
    distance from the rover. A rock counts from the height on that the rover does not cross; a flag
    beside it counts as one of it.""")
@options.bag('recording with map/elevation')
@options.world('of the drive, where it is not beside the bag or in the cache', 'FOLDER')
@options.bounded('--maps', 1, kind=int, default=40,
                 help='maps that are judged, spread over the drive')
@options.folder('folder for map_evaluation.json and a picture', required=False)
@options.as_json
def map_(bag: Path, world: Path | None, maps: int, output: Path | None, as_json: bool) -> int:
    """Judge, print a table, write results."""
    picture = None if output is None else output / 'map_evaluation.png'
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    result = evaluate_maps(bag, world, maps, picture)
    if output is not None:
        atomic_write(output / 'map_evaluation.json',
                     json_text(result.to_mapping()) + '\n', EvaluationError)
    if as_json:
        print_json(result.to_mapping())
        return 0
    print_table(('distance [m]', 'cells', 'RMS [m]', 'median [m]', 'precision', 'recall'), 1,
                map(_row, (*result.by_distance, result.near)))
    say(f'{result.maps} maps, sun at {result.sun_deg:g} deg; the last row is all within '
        f'{NEAR_M:g} m; rocks count from {result.rock_m:.3f} m on; median error '
        f'{result.offset_m:+.4f} m; '
        f'{100.0 * result.beyond_3_sigma:.1f} % of the cells are off by more than 3 of their '
        'stated deviations')
    if picture is not None:
        say(picture)
    return 0


def _row(rates: Rates) -> tuple[str, ...]:
    def number(value: float, digits: int) -> str:
        return f'{value:.{digits}f}' if value == value else '-'
    return (f'{rates.low_m:g} to {rates.high_m:g}', str(rates.cells), number(rates.rms_m, 4),
            number(rates.median_m, 4), number(rates.precision, 2), number(rates.recall, 2))
