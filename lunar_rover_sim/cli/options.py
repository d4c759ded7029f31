"""The vocabulary of the command line: each option that several commands have, and its help."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import contextlib
import functools
import itertools
import json
import math
import os
from pathlib import Path
import re
from typing import Any

import click
from click.shell_completion import CompletionItem

from lunar_rover_sim.base.errors import brief, ConfigError, LunarRoverSimError, nearest, one_line
from lunar_rover_sim.base.files.paths import (check_folder, check_new_folder, packaged_names,
                                              recorded_bag)

Function = Callable[..., Any]
Decorator = Callable[[Function], Function]
Check = Callable[[Path], None]
PATH = click.Path(path_type=Path, readable=False)   # what cannot be read is told later
_NUMBER = re.compile(r'-\.?\d')
_OF_SCENARIO = 'NODE.PARAM=VALUE'
_DOUBT_M = 50.0         # of the start, on a map from orbit
WORDS = 'lunar_rover_sim.words'     # in the meta of a context: what follows the command
# A quarter of the pixels.
FAST = ('render_node.camera.width=320', 'render_node.camera.height=240')


class Command(click.Command):
    """A command whose options of several values take them one after the other."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read `--seeds 1 2` as `--seeds 1 --seeds 2`."""
        ctx.meta[WORDS] = list(args)
        several = {name: option for option in self.params if isinstance(option, _Several)
                   for name in option.opts}
        try:
            return super().parse_args(ctx, list(_one_by_one(args, several)))
        except click.MissingParameter as missing:
            _check_scenario(ctx.params, missing)
            raise


def _check_scenario(given: Mapping[str, Any], missing: click.MissingParameter) -> None:
    """Raise ConfigError where a scenario is not valid, beside an option that is missing."""
    name, overrides = given.get('scenario'), given.get('overrides') or ()
    if not isinstance(name, str):
        return
    # Only here they are needed.
    from lunar_rover_sim.ground.world.config import DEM
    from lunar_rover_sim.ground.world.dem import dem_site
    from lunar_rover_sim.run.scenario import Scenario
    try:
        world = Scenario.load(name, overrides).world
        if world.source == DEM:
            dem_site(world)
    except LunarRoverSimError as error:
        text = one_line(missing.format_message())
        raise ConfigError(f'{error}; also {text[0].lower()}{text[1:]}') from None


def _one_by_one(args: Sequence[str], several: dict[str, _Several]) -> Iterator[str]:
    left = list(args)
    while left:
        word = left.pop(0)
        if word not in several:
            yield word
            continue
        values = list(itertools.takewhile(
            lambda next_word: not next_word.startswith('-') or _NUMBER.match(next_word), left))
        del left[:len(values)]
        if not values:
            if not several[word].none:
                raise click.BadOptionUsage(word, f'Option {word!r} requires an argument.')
            yield from (word, '')
        for value in values:
            yield from (word, value)


class _Several(click.Option):
    """An option with several values, or with `none` without any."""

    def __init__(self, *args: Any, none: bool, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.none = none

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        """Leave out the word that stands for no value."""
        found = super().process_value(ctx, value)
        return tuple(one for one in found if one != '') if self.none else found


class _Argument(click.Argument):
    """A positional argument with a help text."""

    def __init__(self, *args: Any, help: str, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.meaning = help

    def get_help_record(self, _context: click.Context) -> tuple[str, str]:
        """Return how it is written and what it means."""
        return self.metavar or self.human_readable_name, self.meaning


class Choice(click.Choice):     # type: ignore[type-arg]  # no generic before click 8.2
    """One of several words; for another one the nearest is offered."""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> str:
        """Return the word."""
        if value not in self.choices:
            self.fail(f'{value!r} is not valid; {nearest(str(value), self.choices)}', param, ctx)
        return str(value)


def command(help: str | None = None, scenarios: bool = False) -> Callable[..., click.Command]:
    """Declare a command.

    Args:
        help: What it does; by default the docstring of the function.
        scenarios: Whether the help ends with the names of the packaged scenarios.
    """
    epilog = None
    if scenarios:
        with contextlib.suppress(ConfigError):  # a damaged installation; running it says so
            epilog = f'Packaged scenarios: {", ".join(packaged_names("scenario"))}'
    return click.command(cls=Command, help=help, epilog=epilog)


def argument(name: str, help: str, **kwargs: Any) -> Decorator:
    """Declare a positional argument; more of click's `argument` as keywords."""
    return click.argument(name, cls=_Argument, help=help, **kwargs)


def several(name: str, default: Iterable[Any], none: bool = False, **kwargs: Any) -> Decorator:
    """Declare an option that takes several values.

    Args:
        name: Of the option.
        default: Values without the option.
        none: Whether the option alone, without a value, is valid.
        **kwargs: More of click's `option`.
    """
    return click.option(name, cls=_Several, none=none, multiple=True, default=tuple(default),
                        **kwargs)


def not_both(**given: Any) -> None:
    """Raise UsageError if more than one of some options are given; `x_y` stands for --x-y."""
    names = ['--' + name.replace('_', '-') for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise click.UsageError(f'{", ".join(names)}: both are given; valid is one of them')


def _scenarios(_context: click.Context, _param: click.Parameter,
               begin: str) -> list[CompletionItem]:
    names = [name for name in packaged_names('scenario') if name.startswith(begin)]
    return [CompletionItem(name) for name in names] or [CompletionItem(begin, type='file')]


def scenario(default: str | None = None, many: bool = False) -> Decorator:
    """Declare a scenario, or with `many` `scenarios`, which are empty for the default."""
    help = 'name of a packaged scenario, or a YAML file'
    if default is not None:
        help += f'  [default: {default}]'
    return argument('scenarios' if many else 'scenario', help, nargs=-1 if many else 1,
                    metavar=('[SCENARIO]' if default else 'SCENARIO') + ('...' if many else ''),
                    required=default is None, shell_complete=_scenarios,
                    default=None if many else default)


def scenario_option(help: str) -> Decorator:
    """Declare the scenario from which an export takes what the file lacks."""
    return click.option('--scenario', metavar='NAME_OR_PATH', help=help, shell_complete=_scenarios)


def _parameters(_context: click.Context, _param: click.Parameter,
                begin: str) -> list[CompletionItem]:
    from lunar_rover_sim.cli.parameters import parameter_names  # it imports this module
    return [CompletionItem(f'{name}=') for name in parameter_names() if name.startswith(begin)]


def overrides(metavar: str = _OF_SCENARIO, fast: bool = False,
              help: str = 'set a parameter; see `lunar_rover_sim parameters`') -> Decorator:
    """Declare --set and, for parameters of a scenario, --rover, and with `fast` --fast.

    The command gets all of them as `overrides`, in the order in which they count.
    """
    rover = metavar == _OF_SCENARIO

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def with_overrides(**given: Any) -> Any:
            chosen = [*(FAST if given.pop('fast', False) else ()), *given.pop('overrides')]
            if (name := given.pop('rover', None)) is not None:
                chosen.append(f'rover={json.dumps(name)}')
            return function(overrides=chosen, **given)

        found: Function = with_overrides
        if rover:
            found = click.option('--rover', metavar='NAME_OR_PATH', help='a packaged rover, quad '
                                 'or hexapod, or a rover file')(found)
        found = click.option('--set', 'overrides', multiple=True, metavar=metavar,
                             help=f'{help}; may be repeated', shell_complete=_parameters)(found)
        return fast_option(found) if fast else found
    return decorate


def fast_option(function: Function) -> Function:
    """Declare --fast."""
    return click.option('--fast', is_flag=True, help='for a first look: ' + ', '.join(FAST)
                        + '; --set goes before')(function)


def seed(default: int | None = None, help: str = 'seed of everything random') -> Decorator:
    """Declare --seed."""
    return click.option('--seed', type=int, default=default, metavar='N', help=help)


def bag(help: str = 'a bag, or the folder of a run') -> Decorator:
    """Declare the bag that a command reads."""
    return argument('bag', help, type=PATH, metavar='BAG',
                    callback=lambda _context, _param, path: recorded_bag(path))


def world(help: str = "a world made by `world build`, instead of the scenario's own",
          metavar: str = 'DIR') -> Decorator:
    """Declare --world."""
    return click.option('--world', type=PATH, metavar=metavar, help=help)


def recorded_world(prefix: str = '') -> Decorator:
    """Declare the world of a recording."""
    return world(prefix + 'the world that was driven on, where it is not in the cache')


def output(check: Check, metavar: str, help: str, default: str | None = None,
           required: bool = True) -> Decorator:
    """Declare -o.

    Args:
        check: Raises ConfigError, before anything is computed, for what cannot be written.
        metavar: DIR, FILE or PATH.
        help: What is written.
        default: File or folder that is written without the option.
        required: Whether the option must be given, where there is no default.
    """
    def checked(_context: click.Context, _param: click.Parameter, path: Path | None) -> Any:
        if path is not None:
            check(path)
        return path

    given = {'required': required} if default is None else {'default': default}
    return click.option('-o', '--output', type=PATH, metavar=metavar, help=help, callback=checked,
                        **given)


def allowed_origins(function: Function) -> Function:
    """Declare which pages may connect to a live view."""
    return click.option('--allow-origin', multiple=True, metavar='ORIGIN', help='let a page of '
                        'another site, such as https://app.foxglove.dev, connect with the token; '
                        'may be repeated')(function)


def new_folder(help: str, default: str | None = None, required: bool = True) -> Decorator:
    """Declare -o for a folder that must not exist."""
    return output(check_new_folder, 'DIR', f'{help}; must not exist', default, required)


def folder(help: str, default: str | None = None, required: bool = True) -> Decorator:
    """Declare -o for a folder that may exist."""
    return output(check_folder, 'DIR', help, default, required)


def overwrite(what: str = 'an existing file') -> Decorator:
    """Declare --overwrite; --force means the same."""
    return click.option('--overwrite', '--force', is_flag=True, help=f'replace {what}')


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


def workers(help: str, default: int | None = 1) -> Decorator:
    """Declare --workers; --jobs means the same. None as the default: one per core."""
    shown: Any = '1 per core' if default is None else True
    return click.option('--workers', '--jobs', type=number('--workers', 1, kind=int), metavar='N',
                        default=default or os.cpu_count() or 1, show_default=shown, help=help)


def resume(what: str) -> Decorator:
    """Declare --resume."""
    return click.option('--resume', is_flag=True,
                        help=f'go on with an interrupted study: finished {what} are kept')


def as_json(function: Function) -> Function:
    """Declare --json."""
    return click.option('--json', 'as_json', is_flag=True,
                        help='print the result as JSON, and nothing else, to stdout')(function)


def bounded(name: str, low: float, high: float = math.inf, *, help: str, metavar: str = 'N',
            unit: str = '', above: bool = False, kind: type = float,
            **kwargs: Any) -> Decorator:
    """Declare an option that is a number within bounds.

    Args:
        name: Of the option, `--duration`.
        low: Smallest valid value.
        high: Largest valid value.
        help: Meaning; the unit is added.
        metavar: Stands for the value.
        unit: Of the value, for example 's'.
        above: Whether `low` itself is not valid.
        kind: int or float.
        **kwargs: More of click's `option`.
    """
    return click.option(name, type=number(name, low, high, unit, above, kind), metavar=metavar,
                        help=help + (f' [{unit}]' if unit else ''), **kwargs)


def at_place(help: str) -> Decorator:
    """Return the option --at X,Y."""
    return click.option('--at', type=place_of('--at'), metavar='X,Y', help=help + ' [m]')


def place(text: str, name: str = '') -> tuple[float, float]:
    """Return the place that `X,Y` names [m]; raise ConfigError for anything else.

    Args:
        name: Of the option.
    """
    try:
        x, y = (float(part) for part in text.split(','))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(f'{name} {brief(text)}: is no place; valid is X,Y [m], for example 8,3'
                          .strip())
    return x, y


def place_of(name: str) -> Callable[[str], tuple[float, float]]:
    """Return `place` with the name of an option."""
    def convert(text: str) -> tuple[float, float]:
        return place(text, name)
    return convert


def on_maps(system: str, unless: str = '') -> Decorator:
    """Declare --orbital, --near and --doubt; see `checked_doubt`.

    Args:
        system: The option for which they are.
        unless: What stands for --near without it.
    """
    def declared(function: Function) -> Function:
        for option in (
                bounded('--doubt', 1.0, 500.0, unit='m', metavar='M', show_default=False,
                        help=f'with --orbital: radius around it; default: {_DOUBT_M:g}'),
                click.option('--near', type=place_of('--near'), metavar='X,Y', help='with '
                             '--orbital: a place that the start is near to [m]' + unless),
                click.option('--orbital', type=PATH, metavar='DIR', help=f'with {system}: maps of '
                             'the site from orbit, of `world export --orbital`; it finds its '
                             'place on them')):
            function = option(function)
        return function
    return declared


def checked_doubt(orbital: Path | None, near: tuple[float, float] | None,
                  doubt: float | None) -> float:
    """Return the radius [m]; raise ConfigError for what is given without the maps."""
    for name, value in (('--near', near), ('--doubt', doubt)):
        if value is not None and orbital is None:
            raise ConfigError(f'{name}: needs --orbital, the maps on which the place is')
    return _DOUBT_M if doubt is None else doubt


def window_of(folder: Path, at: tuple[float, float] | None) -> Any:
    """Return the world of a folder, or the window of its site around a place, in its own frame.

    Raises:
        ConfigError: The place is not on the site.
        WorldError: The folder holds no world, or the window cannot be made.
    """
    # Here, because most commands need no world.
    from lunar_rover_sim.ground.world.follower import Follower
    from lunar_rover_sim.ground.world.world_folder import load_world
    world = load_world(folder)
    if at is not None:
        follower = Follower(world)
        if not follower.holds(*at):
            raise ConfigError(f'--at: {at[0]:g},{at[1]:g} is not valid; {follower.end}')
        world = follower.site.window(follower.site.middle(at))
    return world.local()


def number(name: str, low: float, high: float = math.inf, unit: str = '', above: bool = False,
           kind: type = float) -> Callable[[Any], Any]:
    """Return what turns the text of an option into a number within bounds.

    Raises:
        ConfigError: The number is out of bounds. The conversion raises it.
    """
    bounds = f'{">" if above else ">="} {low:g}' if high == math.inf else f'{low:g} to {high:g}'
    bounds += f' [{unit}]' if unit else ''

    def convert(text: Any) -> Any:
        try:
            value = kind(text)
        except ValueError:
            word = 'a whole number' if kind is int else 'a number'
            raise click.BadParameter(f'{text!r} is not {word}') from None
        if not low <= value <= high or (above and value == low) or not math.isfinite(value):
            shown = str(value) if kind is int else f'{value:g}'
            raise ConfigError(f'{name}: {shown} is not valid; valid is {bounds}')
        return value
    return convert


def numbers(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """Return what turns text into finite numbers, with commas or blanks between.

    Args:
        *counts: The valid numbers of numbers.
    """
    def convert(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in re.split(r'[,\s]+', text.strip()))
        except ValueError:
            raise click.BadParameter(f'{text!r} is not a list of numbers') from None
        if not all(map(math.isfinite, values)):
            raise click.BadParameter(f'{text!r} is not valid; valid is finite numbers')
        if len(values) not in counts:
            wanted = ' or '.join(map(str, counts))
            raise click.BadParameter(f'{text!r} is not {wanted} numbers')
        return values
    return convert


def sun(prefix: str = '', default: tuple[float, float] | None = None) -> Decorator:
    """Declare --sun; `checked_sun` says whether it is valid."""
    return click.option('--sun', nargs=2, type=float, default=default, metavar='AZIMUTH ELEVATION',
                        help=prefix + '[deg] from east towards north, above the horizontal')


def checked_sun(given: tuple[float, float]) -> tuple[float, float]:
    """Return azimuth and elevation [deg] of --sun; raise ConfigError if they are not valid."""
    azimuth, elevation = given
    if not (-360.0 <= azimuth <= 360.0 and -1.0 <= elevation <= 90.0):
        raise ConfigError(f'--sun: {azimuth:g} {elevation:g} is not valid; valid are an azimuth '
                          'of -360 to 360 and an elevation of -1 to 90 [deg]')
    return azimuth, elevation
