"""The vocabulary of the command line: each option that several commands have, and its help."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import math
import os
from pathlib import Path
import re
from typing import Any

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.paths import (check_folder, check_new_folder, packaged_names,
                                              recorded_bag)
from lunar_rover_sim.cli.help_format import HelpFormatter

Check = Callable[[Path], None]
Run = Callable[[argparse.Namespace], int]
_OF_SCENARIO = 'NODE.PARAM=VALUE'
# A quarter of the pixels.
FAST = ('render_node.camera.width=320', 'render_node.camera.height=240')


def add_action(actions: Any, name: str, text: str, run: Run,
               description: str = '') -> argparse.ArgumentParser:
    """Declare a command below another one.

    Args:
        actions: What `add_subparsers` returned.
        name: Word of the command.
        text: One line of help.
        run: Function of the command.
        description: Of the command; by default the line of help.
    """
    parser: argparse.ArgumentParser = actions.add_parser(
        name, help=text, description=description or text, formatter_class=HelpFormatter)
    parser.set_defaults(run=run)
    return parser


def add_scenario(parser: argparse.ArgumentParser, default: str | None = None,
                 several: bool = False) -> None:
    """Declare a scenario, or several, and list the packaged ones at the end of the help."""
    meaning = 'name of a packaged scenario, or a YAML file'
    if several:
        parser.add_argument('scenarios', nargs='+', metavar='SCENARIO', help=meaning)
    elif default is None:
        parser.add_argument('scenario', metavar='SCENARIO', help=meaning)
    else:
        parser.add_argument('scenario', nargs='?', default=default, metavar='SCENARIO',
                            help=f'{meaning} (default: %(default)s)')
    try:
        names = packaged_names('scenario')
    except ConfigError:     # the installation is damaged; running the command says so
        return
    parser.epilog = f'packaged scenarios: {", ".join(names)}'


def add_scenario_option(parser: Any, help: str) -> None:
    """Declare the scenario from which an export takes what the file lacks."""
    parser.add_argument('--scenario', metavar='NAME_OR_PATH', help=help)


def add_overrides(parser: argparse.ArgumentParser, metavar: str = _OF_SCENARIO,
                  help: str = 'set a parameter; see `lunar_rover_sim parameters`') -> None:
    """Declare --set and, for parameters of a scenario, --rover."""
    parser.add_argument('--set', action='append', default=[], metavar=metavar, dest='overrides',
                        help=f'{help}; may be repeated')
    if metavar == _OF_SCENARIO:
        parser.add_argument('--rover', action='append', type=_rover_override, dest='overrides',
                            metavar='NAME_OR_PATH', default=[],
                            help='a packaged rover, quad or hexapod, or a rover file')


def add_fast(parser: argparse.ArgumentParser) -> None:
    """Declare --fast; `with_fast` gives the parameters that it sets."""
    parser.add_argument('--fast', action='store_true', help='for a first look: '
                        + ', '.join(FAST) + '; --set goes before')


def with_fast(args: argparse.Namespace) -> list[str]:
    """Return the parameters that --fast and --set set, in the order in which they count."""
    return [*(FAST if args.fast else ()), *args.overrides]


def _rover_override(name: str) -> str:
    """Return the --set that a --rover means."""
    return f'rover={json.dumps(name)}'


def add_seed(parser: argparse.ArgumentParser, default: int | None = None,
             help: str = 'seed of everything random') -> None:
    """Declare --seed."""
    parser.add_argument('--seed', type=int, default=default, metavar='N',
                        help=help + ('' if default is None else ' (default: %(default)s)'))


def add_bag(parser: argparse.ArgumentParser, help: str = 'a bag, or the folder of a run') -> None:
    """Declare the bag that a command reads."""
    parser.add_argument('bag', type=recorded_bag, metavar='BAG', help=help)


def add_world(parser: Any, help: str = "a world made by `world build`, instead of the scenario's "
                                       'own') -> None:
    """Declare --world."""
    parser.add_argument('--world', type=Path, metavar='DIR', help=help)


def add_recorded_world(parser: Any) -> None:
    """Declare the world of a recording."""
    add_world(parser, 'the world that was driven on, where it is not in the cache')


def add_output(parser: argparse.ArgumentParser, check: Check, metavar: str, help: str,
               default: str | None = None, required: bool = True) -> None:
    """Declare -o.

    Args:
        parser: Of the command.
        check: Raises ConfigError, before anything is computed, for what cannot be written.
        metavar: DIR, FILE or PATH.
        help: What is written.
        default: File or folder that is written without the option.
        required: Whether the option must be given, where there is no default.
    """
    parser.add_argument('-o', '--output', type=Path, metavar=metavar,
                        required=required and default is None,
                        default=None if default is None else Path(default),
                        help=help + ('' if default is None else ' (default: %(default)s)'))
    parser.set_defaults(check_output=check)


def add_allowed_origins(parser: argparse.ArgumentParser) -> None:
    """Declare which pages may connect to a live view."""
    parser.add_argument('--allow-origin', action='append', default=[], metavar='ORIGIN',
                        help='let a page of another site connect to the view, with the token of '
                        'its address: https://app.foxglove.dev; may be given several times')


def add_new_folder(parser: argparse.ArgumentParser, help: str, default: str | None = None,
                   required: bool = True) -> None:
    """Declare -o for a folder that must not exist."""
    add_output(parser, check_new_folder, 'DIR', f'{help}; must not exist', default, required)


def add_folder(parser: argparse.ArgumentParser, help: str, default: str | None = None,
               required: bool = True) -> None:
    """Declare -o for a folder that may exist."""
    add_output(parser, check_folder, 'DIR', help, default, required)


def add_overwrite(parser: Any, what: str = 'an existing file') -> None:
    """Declare --overwrite; --force means the same."""
    parser.add_argument('--overwrite', action='store_true', help=f'replace {what}')
    parser.add_argument('--force', action='store_true', dest='overwrite', help=argparse.SUPPRESS)


def refuse_existing(path: Path, overwrite: bool = False, option: bool = True) -> None:
    """Raise ConfigError if an output exists and is not to be replaced.

    Args:
        path: Of the output.
        overwrite: Whether it may be replaced.
        option: Whether the command has --overwrite.
    """
    if path.exists() and not overwrite:
        raise ConfigError(f'--output: {path} exists already; choose another name'
                          + (' or say --overwrite' if option else ''))


def add_workers(parser: argparse.ArgumentParser, help: str, default: int | None = 1) -> None:
    """Declare --workers; --jobs means the same. None as the default: one per core."""
    count = os.cpu_count() or 1 if default is None else default
    shown = 'one per core' if default is None else str(default)
    convert = number('--workers', 1, kind=int)
    parser.add_argument('--workers', type=convert, default=count, metavar='N',
                        help=f'{help} (default: {shown})')
    parser.add_argument('--jobs', type=convert, dest='workers', default=count,
                        help=argparse.SUPPRESS)


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare --json."""
    parser.add_argument('--json', action='store_true',
                        help='print the result as JSON, and nothing else, to stdout')


def add_number(parser: Any, name: str, low: float, high: float = math.inf, *, help: str,
               default: float | None = None, metavar: str = 'N', unit: str = '',
               above: bool = False, kind: type = float, **options: Any) -> None:
    """Declare an option that is a number within bounds, or a list of such numbers.

    Args:
        parser: Of the command, or a group of its options.
        name: Of the option, `--duration`.
        low: Smallest valid value.
        high: Largest valid value.
        help: Meaning; unit and default are added.
        default: Value without the option.
        metavar: Stands for the value.
        unit: Of the value, for example 's'.
        above: Whether `low` itself is not valid.
        kind: int or float.
        **options: Of `add_argument`.
    """
    shown = '' if default is None else ' (default: %(default)s)'
    parser.add_argument(name, type=number(name, low, high, unit, above, kind), default=default,
                        metavar=metavar, help=help + (f' [{unit}]' if unit else '') + shown,
                        **options)


def place(text: str) -> tuple[float, float]:
    """Return the place that `X,Y` names [m], for argparse; raise ConfigError for anything else."""
    try:
        x, y = (float(part) for part in text.split(','))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(f'{text}: is no place; valid is X,Y [m], for example 8,3')
    return x, y


def number(name: str, low: float, high: float = math.inf, unit: str = '', above: bool = False,
           kind: type = float) -> Callable[[str], Any]:
    """Return what turns the text of an option into a number within bounds, for argparse.

    Raises:
        ConfigError: The number is out of bounds. The conversion raises it.
    """
    bounds = f'{">" if above else ">="} {low:g}' if high == math.inf else f'{low:g} to {high:g}'
    bounds += f' [{unit}]' if unit else ''

    def convert(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            word = 'a whole number' if kind is int else 'a number'
            raise argparse.ArgumentTypeError(f'{text!r} is not {word}') from None
        if not low <= value <= high or (above and value == low) or not math.isfinite(value):
            shown = str(value) if kind is int else f'{value:g}'
            raise ConfigError(f'{name}: {shown} is not valid; valid is {bounds}')
        return value
    return convert


def numbers(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """Return what turns text into finite numbers, with commas or blanks between, for argparse.

    Args:
        *counts: The valid numbers of numbers.
    """
    def convert(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in re.split(r'[,\s]+', text.strip()))
        except ValueError:
            raise argparse.ArgumentTypeError(f'{text!r} is not a list of numbers') from None
        if not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(f'{text!r} is not valid; valid is finite numbers')
        if len(values) not in counts:
            wanted = ' or '.join(map(str, counts))
            raise argparse.ArgumentTypeError(f'{text!r} is not {wanted} numbers')
        return values
    return convert


def checked_sun(sun: tuple[float, float]) -> tuple[float, float]:
    """Return azimuth and elevation [deg] of --sun; raise ConfigError if they are not valid."""
    azimuth, elevation = sun
    if not (-360.0 <= azimuth <= 360.0 and -1.0 <= elevation <= 90.0):
        raise ConfigError(f'--sun: {azimuth:g} {elevation:g} is not valid; valid are an azimuth '
                          'of -360 to 360 and an elevation of -1 to 90 [deg]')
    return azimuth, elevation
