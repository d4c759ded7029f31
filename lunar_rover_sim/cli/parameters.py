"""`lunar_rover_sim parameters`: every parameter with default, unit, range and meaning."""

from __future__ import annotations

import textwrap
from typing import NamedTuple

import click
from click.shell_completion import CompletionItem

from lunar_rover_sim.base.errors import ConfigError, did_you_mean
from lunar_rover_sim.base.files.results import markdown_table
from lunar_rover_sim.base.parameters import nearest
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import console
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.scenario import RunConfig, SHARED
from lunar_rover_sim.run.shared_config import NodeConfig


class Row(NamedTuple):
    """One parameter in words."""

    name: str
    default: str
    valid: str
    meaning: str


Sections = dict[str, list[Row]]


def _begun(_context: click.Context, _param: click.Parameter, begin: str) -> list[CompletionItem]:
    parts = {'.'.join(name.split('.')[:count]) for name in parameter_names()
             for count in range(1, name.count('.') + 1)}
    return [CompletionItem(part) for part in sorted(parts) if part.startswith(begin)]


@options.command()
@options.argument('section', 'a node, world, rover or run, or a part of it such as '
                  'render_node.sun; all by default', required=False, metavar='[SECTION]',
                  shell_complete=_begun)
@click.option('--search', metavar='TEXT',
              help='only parameters with this text in their name or meaning')
@click.option('--markdown', 'as_markdown', is_flag=True, help='as Markdown tables')
def parameters(section: str | None, search: str | None, as_markdown: bool) -> int:
    """List the parameters of a scenario.

    A line has name, default, what is valid and unit; the meaning follows. `--set NAME=VALUE` of
    other commands sets one.
    """
    sections = _sections()
    if section is not None:
        sections = _part(sections, section)
    if search is not None:
        sections = _found(sections, search)
    if as_markdown:
        print(markdown(sections))
        return 0
    width = console().width
    for name, rows in sections.items():
        for row in rows:
            full = row.name if name == SHARED else f'{name}.{row.name}'
            bound = f' {row.valid}' if row.valid.startswith('[') else f', {row.valid}'
            for text, indent in ((f'{full} = {row.default}{bound if row.valid else ""}', ''),
                                 (row.meaning, '    ')):
                print(textwrap.fill(text, width, initial_indent=indent,
                                    subsequent_indent=indent or '        ',
                                    break_long_words=False, break_on_hyphens=False))
    return 0


def _part(sections: Sections, name: str) -> Sections:
    """Return one section, or the group or parameter of one that a dotted name names."""
    section, _, group = name.partition('.')
    if section not in sections:
        raise ConfigError(f'section: {name!r} is not valid; '
                          + (did_you_mean(section, sections) or 'see lunar_rover_sim parameters'))
    rows = [row for row in sections[section]
            if not group or row.name == group or row.name.startswith(f'{group}.')]
    if not rows:
        groups = {'.'.join(row.name.split('.')[:group.count('.') + 1])
                  for row in sections[section]}
        raise ConfigError(f'section: {name!r} is not valid; {nearest(group, sorted(groups))}')
    return {section: rows}


def _found(sections: Sections, text: str) -> Sections:
    """Return the parameters with a text in their full name or meaning, in any case."""
    found = {section: [row for row in rows if text.lower() in f'{section}.{row.name}'.lower()
                       or text.lower() in row.meaning.lower()]
             for section, rows in sections.items()}
    found = {section: rows for section, rows in found.items() if rows}
    if not found:
        raise ConfigError(f'--search: no parameter has {text!r} in its name or meaning')
    return found


def markdown(sections: Sections | None = None) -> str:
    """Return the parameters as Markdown tables; those of all sections by default."""
    lines = []
    for name, rows in (sections or _sections()).items():
        table = markdown_table(('parameter', 'default', 'valid', 'meaning'),
                               ([f'`{row.name}`', *row[1:]] for row in rows))
        lines += [f'<details><summary><code>{name}</code></summary>', '', *table, '',
                  '</details>', '']
    return '\n'.join(lines).rstrip()


def parameter_names() -> list[str]:
    """Return the names of all parameters, as --set takes them."""
    return [row.name if section == SHARED else f'{section}.{row.name}'
            for section, rows in _sections().items() for row in rows]


def _sections() -> Sections:
    classes = {SHARED: NodeConfig, 'run': RunConfig, 'world': WorldConfig,
               'rover': RoverDescription, **NODE_CONFIGS}
    shared = {name for name, *_ in NodeConfig().flatten()}
    return {section: [Row(name, _plain(value), info.valid(),
                          info.doc + (' (live)' if info.live else ''))
                      for name, value, info, _ in cls().flatten(documented=True)
                      if section not in NODE_CONFIGS or name not in shared]
            for section, cls in classes.items()}


def _plain(value: object) -> str:
    if isinstance(value, tuple):
        return '[' + ', '.join(map(str, value)) + ']'
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if value == '' else str(value)
