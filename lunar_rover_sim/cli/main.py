"""The command `lunar_rover_sim`: one parser, one command a file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import importlib
import logging
import sys

from lunar_rover_sim import __version__
from lunar_rover_sim.errors import LunarRoverSimError

# Commands with a word of their own, and groups whose members are files of their own.
_COMMANDS = ('world', 'run', 'render', 'bag', 'evaluate')
_GROUPS = {
    'validate': ('hold a part of the simulator to its theory or to the paper',
                 ('validate_imu', 'validate_stereo', 'validate_locomotion',
                  'validate_traverse')),
    'calibrate': ('measure a map that a node uses', ('calibrate',)),
}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    root = argparse.ArgumentParser(
        prog='lunar_rover_sim',
        description='A spoke-leg micro rover on the Moon: walk, stereo images, rosbag2.')
    root.add_argument('--version', action='version', version=__version__)
    root.add_argument('-v', '--verbose', action='store_true', help='log what is going on')
    subparsers = root.add_subparsers(metavar='COMMAND', required=True)
    for name in _COMMANDS:
        _module(name).add_parser(subparsers)
    for group, (text, names) in _GROUPS.items():
        members = subparsers.add_parser(group, help=text, description=text).add_subparsers(
            metavar='WHAT', required=True)
        for name in names:
            _module(name).add_parser(members)
    return root


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; return the exit status: 0, 1 after an error, 130 after Ctrl-C."""
    arguments = parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO if arguments.verbose else logging.WARNING,
                        format='%(levelname)s %(name)s: %(message)s')
    try:
        return arguments.run(arguments)
    except LunarRoverSimError as error:
        print(f'lunar_rover_sim: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output (head, less) has seen enough.
        sys.stderr.close()
        return 0


def _module(name: str):  # type: ignore[no-untyped-def]
    return importlib.import_module(f'lunar_rover_sim.cli.{name}')


if __name__ == '__main__':
    raise SystemExit(main())
