"""`lunar_rover_sim parameters`: every parameter with default, unit, range and meaning."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import NODE_CONFIGS, NodeConfig
from lunar_rover_sim.run.scenario import RunConfig, SHARED
from lunar_rover_sim.world.config import WorldConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = ('List the parameters of a scenario: name, default, what is valid, '
                          'meaning.')
    parser.add_argument('section', nargs='?', help='a node, world, rover or run; all by default')
    parser.add_argument('--markdown', action='store_true', help='as Markdown tables')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the tables."""
    sections = _sections()
    if args.section is not None:
        if args.section not in sections:
            raise ConfigError(f'section: {args.section!r} is not valid; '
                              f'{nearest(args.section, sections)}')
        sections = {args.section: sections[args.section]}
    if args.markdown:
        print(markdown(sections))
        return 0
    console = Console()
    for name, rows in sections.items():
        table = Table('parameter', 'default', 'valid', 'meaning', title=name, title_justify='left')
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
    return 0


def markdown(sections: dict[str, list[tuple[str, str, str, str]]] | None = None) -> str:
    """Return the tables as Markdown; those of all sections by default."""
    lines = []
    for name, rows in (sections or _sections()).items():
        lines += [f'<details><summary><code>{name}</code></summary>', '',
                  '| parameter | default | valid | meaning |', '|---|---|---|---|']
        lines += ['| `{}` | {} | {} | {} |'.format(*(cell.replace('|', '\\|') for cell in row))
                  for row in rows]
        lines += ['', '</details>', '']
    return '\n'.join(lines).rstrip()


def _sections() -> dict[str, list[tuple[str, str, str, str]]]:
    classes = {SHARED: NodeConfig, 'run': RunConfig, 'world': WorldConfig,
               'rover': RoverDescription, **NODE_CONFIGS}
    shared = {name for name, *_ in NodeConfig().flatten()}
    result = {}
    for section, cls in classes.items():
        rows = []
        for name, value, info, _ in cls().flatten():
            if section != SHARED and name in shared and section in NODE_CONFIGS:
                continue
            live = ' (live)' if info.live else ''
            rows.append((name, _plain(value), info.valid(), info.doc + live))
        result[section] = rows
    return result


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return '[' + ', '.join(map(str, value)) + ']'
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if value == '' else str(value)
