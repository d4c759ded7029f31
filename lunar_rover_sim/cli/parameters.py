"""`lunar_rover_sim parameters`: every parameter with default, unit, range and meaning."""

from __future__ import annotations

import argparse

from rich.markup import escape

from lunar_rover_sim.cli.terminal import console, table
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import nearest
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.scenario import RunConfig, SHARED
from lunar_rover_sim.run.shared_config import NodeConfig
from lunar_rover_sim.world.config import WorldConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = ('List the parameters of a scenario: name, default, what is valid, '
                          'meaning.')
    parser.add_argument('section', nargs='?',
                        help='a node, world, rover or run, or a part of it such as '
                             'render_node.sun; all by default')
    parser.add_argument('--search', metavar='TEXT',
                        help='only parameters with this text in their name or meaning')
    parser.add_argument('--markdown', action='store_true', help='as Markdown tables')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the tables."""
    sections = _sections()
    if args.section is not None:
        sections = _part(sections, args.section)
    if args.search is not None:
        sections = _found(sections, args.search)
    if args.markdown:
        print(markdown(sections))
        return 0
    out = console()
    for name, rows in sections.items():
        shown = table(('parameter', 'default', 'valid', 'meaning'), 4, title=name,
                      title_justify='left')
        for row in rows:
            shown.add_row(*map(escape, row))
        out.print(shown)
    return 0


Sections = dict[str, list[tuple[str, str, str, str]]]


def _part(sections: Sections, name: str) -> Sections:
    """Return one section, or the group or parameter of one that a dotted name names."""
    section, _, group = name.partition('.')
    if section not in sections:
        raise ConfigError(f'section: {name!r} is not valid; {nearest(section, sections)}')
    rows = [row for row in sections[section]
            if not group or row[0] == group or row[0].startswith(f'{group}.')]
    if not rows:
        groups = {'.'.join(row[0].split('.')[:group.count('.') + 1]) for row in sections[section]}
        raise ConfigError(f'section: {name!r} is not valid; {nearest(group, sorted(groups))}')
    return {section: rows}


def _found(sections: Sections, text: str) -> Sections:
    """Return the parameters with a text in their full name or meaning, in any case."""
    found = {section: [row for row in rows if text.lower() in f'{section}.{row[0]}'.lower()
                       or text.lower() in row[3].lower()]
             for section, rows in sections.items()}
    found = {section: rows for section, rows in found.items() if rows}
    if not found:
        raise ConfigError(f'--search: no parameter has {text!r} in its name or meaning')
    return found


def markdown(sections: Sections | None = None) -> str:
    """Return the tables as Markdown; those of all sections by default."""
    lines = []
    for name, rows in (sections or _sections()).items():
        lines += [f'<details><summary><code>{name}</code></summary>', '',
                  '| parameter | default | valid | meaning |', '|---|---|---|---|']
        lines += ['| `{}` | {} | {} | {} |'.format(*(cell.replace('|', '\\|') for cell in row))
                  for row in rows]
        lines += ['', '</details>', '']
    return '\n'.join(lines).rstrip()


def _sections() -> Sections:
    classes = {SHARED: NodeConfig, 'run': RunConfig, 'world': WorldConfig,
               'rover': RoverDescription, **NODE_CONFIGS}
    shared = {name for name, *_ in NodeConfig().flatten()}
    result = {}
    for section, cls in classes.items():
        rows = []
        for name, value, info, _ in cls().flatten(documented=True):
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
