"""The command `lunar_rover_sim`: one parser, one command a file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import importlib
import logging
import pkgutil
import sys

from lunar_rover_sim import __version__, cli
from lunar_rover_sim.errors import LunarRoverSimError

# Groups of commands: every file whose name begins so adds one member.
_GROUPS = {'validate': 'hold a part of the simulator to its theory or to the paper',
           'calibrate': 'measure a map that a node uses'}


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line: one command per file of this package."""
    root = argparse.ArgumentParser(
        prog='lunar_rover_sim',
        description='A spoke-leg micro rover on the Moon: walk, stereo images, rosbag2.')
    root.add_argument('--version', action='version', version=__version__)
    root.add_argument('-v', '--verbose', action='store_true', help='log what is going on')
    subparsers = root.add_subparsers(metavar='COMMAND', required=True)
    groups = {name: subparsers.add_parser(name, help=text, description=text).add_subparsers(
        metavar='WHAT', required=True) for name, text in _GROUPS.items()}
    for info in pkgutil.iter_modules(cli.__path__):
        if info.name == 'main':
            continue
        module = importlib.import_module(f'{cli.__name__}.{info.name}')
        module.add_parser(groups.get(info.name.partition('_')[0], subparsers))
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


if __name__ == '__main__':
    raise SystemExit(main())
