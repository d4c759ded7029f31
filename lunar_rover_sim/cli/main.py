"""The command `lunar_rover_sim`: a table of commands, of which only the chosen one is imported."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
import importlib
import logging
import re
import sys
from typing import NamedTuple, NoReturn

from lunar_rover_sim import __version__
from lunar_rover_sim.base.errors import ConfigError, did_you_mean, LunarRoverSimError, one_line
from lunar_rover_sim.base.files.paths import check_open_files
from lunar_rover_sim.cli.help_format import HelpFormatter

logger = logging.getLogger('lunar_rover_sim.cli')


class Command(NamedTuple):
    """The module of this package with `add_arguments(parser)`, and one line of help."""

    module: str
    help: str


GROUPS = {'validate': 'compare a part of the simulator with theory or published results',
          'calibrate': 'measure a map that a node uses',
          'evaluate': 'judge an estimated trajectory, or compare sets of images'}
# What the name of a group means without one of its members.
DEFAULTS = {'evaluate': 'trajectory'}

COMMANDS = {
    'bag': Command('bag', 'look into, check, hash, recover and export recordings'),
    'benchmark': Command(
        'benchmark', 'simulate, run SLAM, and judge: a table over scenarios and sensors'),
    'calibrate gait': Command(
        'calibrate', 'measure the map from velocity to gait on flat ground'),
    'campaign': Command('campaign', 'record a data set of randomised episodes'),
    'completion': Command('completion', 'print a script that completes commands in a shell'),
    'dataset': Command('dataset', 'look at, verify and describe a data set that `campaign` made'),
    'demo': Command('demo', 'record a first drive, check it and draw pictures of it'),
    'evaluate images': Command(
        'evaluate_images', 'compare the images of two renderers, cameras or worlds'),
    'evaluate map': Command(
        'evaluate_map', 'judge the maps of a recorded drive against its world'),
    'evaluate trajectory': Command(
        'evaluate', 'judge an estimated trajectory against the truth; `evaluate` alone does it'),
    'parameters': Command('parameters', 'list all parameters, by node and section'),
    'render': Command('render', 'draw single stereo frames with all truth layers'),
    'rover': Command('rover', 'export the rover as an OpenUSD stage or URDF'),
    'run': Command('run', 'simulate and record a scenario'),
    'slam': Command(
        'slam', 'what SLAM programs need: settings files, vocabularies; running them on bags'),
    'validate imu': Command(
        'validate_imu', 'Allan deviation of the IMU at rest against its configured noise'),
    'validate learning': Command(
        'validate_learning', 'policies against the packaged gait on hidden seeds'),
    'validate locomotion': Command(
        'validate_locomotion',
        'pitch of the walk against a velocity interface; commands followed'),
    'validate navigation': Command(
        'validate_navigation',
        'goals by what the rover sees, against the true map and a blind route'),
    'validate odometry': Command(
        'validate_odometry', 'wheel odometry and its covariance against the true pose'),
    'validate policy': Command(
        'validate_policy', 'a policy file against its environment, term by term'),
    'validate stereo': Command('validate_stereo', 'semi-global matching against true depth'),
    'validate terramechanics': Command(
        'validate_terramechanics', 'soft ground against published numbers; walks, slopes, pull'),
    'validate traverse': Command(
        'validate_traverse',
        'drive waypoints over many worlds: tip-overs, slip, cost of transport'),
    'view': Command('view', "physics alone in MuJoCo's viewer"),
    'world': Command(
        'world', 'build, inspect, picture and export terrains; sun and Earth over them'),
}

# argparse takes `-2` after an option as its value, but `-2,3,240` as an option.
_NEGATIVE_LIST = re.compile(r'-\.?\d[^,]*,')


class _Parser(argparse.ArgumentParser):
    """Offers the nearest valid word for a mistyped one; so do the parsers of its commands."""

    def error(self, message: str) -> NoReturn:
        found = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        hint = did_you_mean(found[1], re.findall(r'[\w-]+', found[2])) if found else ''
        super().error(f'{message}; {hint}' if hint else message)


def parser(declared: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Return the parser of the command line.

    It knows all commands, but only the `declared` ones are imported and have arguments.
    """
    root = _Parser(
        prog='lunar_rover_sim', formatter_class=HelpFormatter,
        description='A spoke-leg micro rover on the Moon: walk, stereo images, rosbag2.')
    root.add_argument('--version', action='version', version=__version__)
    root.add_argument('-v', '--verbose', action='store_true', help='log what is going on')
    subparsers = root.add_subparsers(metavar='COMMAND', required=True)
    groups = {name: subparsers.add_parser(
        name, help=text, description=text, formatter_class=HelpFormatter).add_subparsers(
            metavar='WHAT', required=True) for name, text in GROUPS.items()}
    for name, command in COMMANDS.items():
        group, _, member = name.rpartition(' ')
        one = groups.get(group, subparsers).add_parser(
            member, help=command.help, description=command.help, formatter_class=HelpFormatter)
        if name in declared:
            module = importlib.import_module(f'lunar_rover_sim.cli.{command.module}')
            module.add_arguments(one)
            if hasattr(module, 'run'):
                one.set_defaults(run=module.run)
    return root


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Return the arguments of a command line; `run` is the function of the chosen command.

    Where it has an `output`, `check_output` is the function that refuses what cannot be written.
    """
    words: list[str] = []
    for word in argv:
        if _NEGATIVE_LIST.match(word) and words and re.fullmatch('--[^=]+', words[-1]):
            words[-1] += f'={word}'
        else:
            words.append(word)
    words = _with_default(words)
    names = [word for word in words if not word.startswith('-')]
    _check_command(names)
    chosen = {' '.join(names[:count]) for count in (1, 2)}
    return parser(chosen).parse_args(words)


def _with_default(words: list[str]) -> list[str]:
    """Return the words with the default member of a group where none is named."""
    first = next((k for k, word in enumerate(words) if not word.startswith('-')), len(words))
    rest = words[first + 1:]
    if first == len(words) or words[first] not in DEFAULTS or not rest:
        return words
    if f'{words[first]} {rest[0]}' in COMMANDS or rest[0] in ('-h', '--help'):
        return words
    return [*words[:first + 1], DEFAULTS[words[first]], *rest]


def _check_command(names: Sequence[str]) -> None:
    """Raise ConfigError, which offers the nearest commands, if there is no such command."""
    known = {name for command in COMMANDS for name in (command, command.split()[0])}
    count = 2 if names and names[0] in GROUPS else 1
    name = ' '.join(names[:count])
    if name and name not in known:
        hint = did_you_mean(name, sorted(known)) or 'see lunar_rover_sim --help'
        raise ConfigError(f'{name}: no such command; {hint}')


def configure_logging(verbose: bool) -> None:
    """Log to stderr: the warnings of this package, or with `verbose` all, also of libraries."""
    handler = logging.StreamHandler()
    if not verbose:
        handler.addFilter(logging.Filter('lunar_rover_sim'))
    logging.basicConfig(level=logging.INFO if verbose else logging.WARNING, handlers=[handler],
                        format='%(levelname)s %(name)s: %(message)s')
    # An error in a callback of a library, such as that of rasterio for texts of GDAL that are not
    # UTF-8: Python would print its traceback.
    sys.unraisablehook = lambda failed: logger.info('%s', failed.err_msg or 'in a callback',
                                                    exc_info=failed.exc_value)


def execute(argv: Sequence[str]) -> int:
    """Run one command; return its exit status. What goes wrong is raised; `main` prints it."""
    arguments = parse(argv)
    configure_logging(arguments.verbose)
    if getattr(arguments, 'output', None) is not None:
        arguments.check_output(arguments.output)
    return arguments.run(arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status: 0, 1 after an error, 130 after Ctrl-C."""
    try:
        check_open_files()
        return execute(sys.argv[1:] if argv is None else argv)
    except LunarRoverSimError as error:
        print(f'lunar_rover_sim: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output (head, less) has seen enough.
        sys.stderr.close()
        return 0
    except (OSError, MemoryError) as error:
        # A file or a resource of the machine, whichever part of a command needed it.
        logger.info('where it was needed', exc_info=True)
        print(f'lunar_rover_sim: {_in_words(error)}', file=sys.stderr)
        return 1


def _in_words(error: OSError | MemoryError) -> str:
    if isinstance(error, MemoryError):
        return 'the memory of this machine is not enough'
    reason = error.strerror or one_line(error)
    return f'{error.filename}: {reason}' if error.filename else reason


if __name__ == '__main__':
    raise SystemExit(main())
