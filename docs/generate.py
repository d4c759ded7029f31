"""Writes the parts of the documentation that the code knows: nobody types them.

    python docs/generate.py

writes the tables of topics, parameters, commands, public names and wings into the pages that show
them, which are in git. A build, and a test, fail where a table is not that of the code. What only
Sphinx reads goes to docs/_generated at every build.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable
from configparser import ConfigParser
import inspect
import itertools
from pathlib import Path
import re
import textwrap

import benchmarks
import click

import lunar_rover_sim
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.parameters import Parameters, ParamInfo
from lunar_rover_sim.cli.main import COMMANDS, load
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.orbital_map import OrbitalConfig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import COMPANION_CONFIGS, FOLLOWS, NODE_CONFIGS
from lunar_rover_sim.run.scenario import RunConfig, Scenario, SHARED
from lunar_rover_sim.run.shared_config import NodeConfig

SECTIONS: dict[str, type[Parameters]] = {
    SHARED: NodeConfig, 'run': RunConfig, 'world': WorldConfig, 'rover': RoverDescription,
    **NODE_CONFIGS, **COMPANION_CONFIGS, 'orbital': OrbitalConfig}

SEVERAL = 2     # commands that have an option alike: it stands once, before them

# What a program may need besides the names that the package exports.
MODULES = {
    'Errors': ['base.errors'],
    'Frames': ['base.frames'],
    'World': ['ground.world.build', 'ground.world.world_folder', 'ground.world.grid',
              'ground.world.moon_place', 'ground.world.orbital_making',
              'ground.world.orbital_map'],
    'Physics and gait': ['rover.physics.state', 'sensors.imu', 'sensors.sensor',
                         'rover.gait.shaping'],
    'Soft ground': ['ground.regolith.soil', 'ground.regolith.overlay'],
    'Images and stereo': ['image.rendering.frame', 'image.camera.rig', 'image.stereo.depth',
                          'image.stereo.error', 'image.illumination.hapke',
                          'image.illumination.sky'],
    'LiDAR': ['image.lidar.optics', 'image.lidar.beam_pattern', 'image.lidar.motion',
              'image.lidar.scan'],
    'Bags and sequences': ['bag.series', 'bag.content_hash', 'bag.ground_points',
                           'products.sequences.export'],
    'Evaluation': ['judge.evaluation.trajectory', 'judge.evaluation.trajectory_evaluation',
                   'judge.evaluation.registration', 'judge.evaluation.metrics',
                   'judge.evaluation.trajectory_files', 'judge.evaluation.image_comparison',
                   'judge.evaluation.image_statistics', 'judge.evaluation.statistics'],
}


def cell(text: str) -> str:
    """Return text for a cell of a Markdown table: `code` stays code, the rest means itself."""
    pieces = text.replace('|', r'\|').split('`')
    return '`'.join(piece if k % 2 else re.sub(r'([*_<>$])', r'\\\1', piece)
                    for k, piece in enumerate(pieces))


def topic_table() -> str:
    """Return one table of topics per node that publishes them."""
    nodes = {name: cls() for name, cls in {**NODE_CONFIGS, **COMPANION_CONFIGS}.items()}
    rates = {topics.STATE: f'{nodes["physics_node"].state_rate_hz} Hz',  # type: ignore
             topics.FRAME: f'{nodes["render_node"].frame_rate_hz} Hz',   # type: ignore
             topics.DEPTH_FRAME: f'{1e9 / nodes["render_node"].depth_period_ns:g} Hz',  # type: ignore  # noqa: E501
             topics.SCAN: f'{nodes["lidar_node"].rate_hz} Hz'}         # type: ignore
    parts = []
    for node in nodes:
        if not any(topic.node == node for topic in topics.CONTRACT):
            continue
        parts += [f'### Published by {node}', '', '| topic | type | rate | frame | notes |',
                  '|---|---|---|---|---|']
        names: dict[str, list[str]] = {}        # what is alike but for its name is one row
        for topic in topics.CONTRACT:
            if topic.node != node:
                continue
            rate = rates.get(topic.rate, topic.rate)
            if topic is topics.CMD_VEL:
                rate = f'{nodes["drive_node"].rate_hz} Hz'               # type: ignore
            frame = f'`{topic.frame_id}`' if topic.frame_id else ''
            if not topic.in_all:
                rate += '*'
            row = (f'{cell(topic.type.replace("/msg/", "/"))} | {rate} | {frame} | '
                   f'{cell(topic.note)}')
            names.setdefault(row, []).append(f'`{topic.name}`')
        parts += [*(f'| {", ".join(alike)} | {row} |' for row, alike in names.items()), '']
    return '\n'.join(parts)


def parameter_tables() -> str:
    """Return one table of parameters per section of a scenario.

    What several sections, or several groups of one, have alike stands in one row.
    """
    shared = {name for name, *_ in NodeConfig().flatten()}
    sections: dict[str, list[tuple[str, object, ParamInfo]]] = {}
    for section, cls in SECTIONS.items():
        apart = () if section == SHARED or not issubclass(cls, NodeConfig) else shared
        sections[section] = [(name, value, info) for name, value, info, _
                             in cls().flatten(documented=True)
                             if name not in apart and not _followed(section, name)]
    counts = Counter(itertools.chain(*sections.values()))
    common = [row for row, count in counts.items() if count > 1]
    parts = []
    for section, rows in sections.items():
        title = 'Shared by all nodes: `/**`' if section == SHARED else f'`{section}`'
        parts += [f'## {title}', '', *_rows(row for row in rows if row not in common)]
        if further := [f'`{row[0]}`' for row in rows if row in common]:
            parts += ['', f'Also, from the last table, {", ".join(further)}.']
        if by_run := [f'`{name}`' for name, _, info in rows if info.by_run]:
            parts += ['', f'A run sets {", ".join(by_run)}.']
        if taken := [f'`{name.partition(".")[2]}` (`{other}`)' for name, other in FOLLOWS.items()
                     if name.startswith(f'{section}.')]:
            parts += ['', f'A run takes over {", ".join(taken)}.']
        parts.append('')
    return '\n'.join([*parts, '## Of several nodes', '', *_rows(common)])


def _followed(section: str, name: str) -> bool:
    """Return whether a parameter, or the group that it is in, is that of another node."""
    return bool({f'{section}.{name}', f'{section}.{name.partition(".")[0]}'} & FOLLOWS.keys())


def _rows(parameters: Iterable[tuple[str, object, ParamInfo]]) -> list[str]:
    """Return a table of parameters; those that are alike but for their names are one row."""
    names: dict[tuple[str, ParamInfo], list[str]] = {}
    for name, value, info in parameters:
        if not info.by_run:
            names.setdefault((plain(value), info), []).append(f'`{name}`')
    return ['| parameter | default | valid | meaning |', '|---|---|---|---|',
            *(f'| {", ".join(alike)} | `{value}` | {cell(info.valid().replace("one of ", ""))} | '
              f'{cell(info.doc)}{" (live)" if info.live else ""} |'
              for (value, info), alike in names.items())]


def plain(value: object) -> str:
    """Return a value as a YAML file would have it."""
    if isinstance(value, tuple):
        return '[' + ', '.join(map(plain, value)) + ']'
    if isinstance(value, bool):
        return str(value).lower()
    return "''" if value == '' else str(value)


def command_pages() -> str:
    """Return usage and arguments of every command; those of several commands stand once."""
    contexts = {name: click.Context(load(name), info_name=f'lunar_rover_sim {name}',
                                    show_default=True) for name in COMMANDS}
    records = {name: [record for param in context.command.params
                      if (record := param.get_help_record(context))]
               for name, context in contexts.items()}
    counts = Counter(itertools.chain(*records.values()))
    often = {words: (words, meaning) for (words, meaning), count in reversed(counts.most_common())
             if count >= SEVERAL}
    common = [record for record in counts if record in often.values()]
    parts = ['## Of several commands', '', *_arguments(common), '']
    for name, context in contexts.items():
        command = context.command
        usage = ' '.join([name, *command.collect_usage_pieces(context)[1:]])
        parts += [f'## `{usage}`', '', cell(' '.join((command.help or '').split())), '']
        if rows := [record for record in records[name] if record not in common]:
            parts += [*_arguments(rows), '']
        if alike := [f'`{words}`' for words, meaning in records[name]
                     if (words, meaning) in common]:
            parts += [f'As above: {", ".join(alike)}.', '']
    return '\n'.join(parts)


def _arguments(records: Iterable[tuple[str, str]]) -> list[str]:
    return ['| argument | meaning |', '|---|---|',
            *(f'| {cell(f"`{words}`")} | {cell(" ".join(meaning.split()))} |'
              for words, meaning in records)]


def python_table() -> str:
    """Return the public names with their meanings, and the modules beside them by subject."""
    def subject(item: object) -> str:
        return cell((inspect.getdoc(item) or '').partition('\n')[0])

    rows = [f'| `{name}` | {subject(getattr(lunar_rover_sim, name))} |'
            for name in lunar_rover_sim.__all__]
    modules = [textwrap.fill(f'- {title}: {", ".join(f"`{name}`" for name in names)}', 110,
                             subsequent_indent='  ', break_long_words=False)
               for title, names in MODULES.items()]
    return '\n'.join(['| name | meaning |', '|---|---|', *rows, '',
                      'Modules of `lunar_rover_sim`, by subject:', '', *modules])


def python_page() -> str:
    """Return autodoc's directives for what the package exports, then for modules beside it."""
    exported = [getattr(lunar_rover_sim, name) for name in lunar_rover_sim.__all__]
    parts = ['## The package', '', '```{eval-rst}']
    for item in exported:
        if isinstance(item, type) and issubclass(item, Exception):
            continue            # with the other errors
        kind = 'autoclass' if isinstance(item, type) else 'autofunction'
        parts += [f'.. {kind}:: {item.__module__}.{item.__qualname__}',
                  *(['   :members:'] if kind == 'autoclass' else []), '']
    parts += ['```', '']
    for title, modules in MODULES.items():
        parts += [f'## {title}', '', '```{eval-rst}']
        for name in modules:
            module = f'lunar_rover_sim.{name}'
            above = [item.__name__ for item in exported if item.__module__ == module
                     and not (isinstance(item, type) and issubclass(item, Exception))]
            parts += [f'.. automodule:: {module}', '   :members:', '   :show-inheritance:',
                      *([f'   :exclude-members: {", ".join(above)}'] if above else []), '']
        parts += ['```', '']
    return '\n'.join(parts)


def check_sections() -> None:
    """Raise ValueError if a section of a scenario has no table."""
    fields = set(Scenario.__dataclass_fields__) - {'name', 'shared'}
    missing = fields - set(SECTIONS)
    if missing:
        raise ValueError(f'no table of parameters for {", ".join(sorted(missing))}')


def wing_table() -> str:
    """Return wings, their rooms and subjects as a table, the highest wing first."""
    root = Path(lunar_rover_sim.__file__).parent
    settings = ConfigParser()
    settings.read(root.parent / 'setup.cfg')
    lines = ['| wing | rooms | subject |', '|---|---|---|']
    for wing in re.findall(r'\w+', settings['importlinter:contract:wings']['layers']):
        rooms = sorted(path.parent.name for path in (root / wing).glob('*/__init__.py'))
        text = (root / wing / '__init__.py').read_text(encoding='utf-8')
        subject = (ast.get_docstring(ast.parse(text)) or '').partition('\n')[0]
        lines.append(f'| `{wing}` | {", ".join(f"`{room}`" for room in rooms)} | {subject} |')
    return '\n'.join([*lines, ''])


# Page → what writes its table, which stands between two comments.
TABLES = {'reference/topics.md': topic_table, 'reference/parameters.md': parameter_tables,
          'reference/commands.md': command_pages, 'reference/python.md': python_table,
          'explanation/architecture.md': wing_table}
BEGIN, END = '<!-- Written by `python docs/generate.py`: -->', '<!-- End of what it wrote. -->'


def outdated(docs: Path) -> dict[Path, str]:
    """Return the pages whose tables are not those of the code, and what they should be."""
    check_sections()
    found = {}
    for name, table in TABLES.items():
        text = (docs / name).read_text(encoding='utf-8')
        before, begin, rest = text.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not begin or not end:
            raise ValueError(f'{name}: the comments around its table are missing')
        wanted = f'{before}{BEGIN}\n\n{table().strip()}\n\n{END}{after}'
        if wanted != text:
            found[docs / name] = wanted
    return found


def write_for_sphinx(docs: Path) -> None:
    """Write what only Sphinx reads; raise ValueError if a table of a page is not up to date."""
    if pages := outdated(docs):
        raise ValueError(f'{", ".join(str(page) for page in pages)}: not up to date; run '
                         '`python docs/generate.py`')
    folder = docs / '_generated'
    folder.mkdir(exist_ok=True)
    path, text = folder / 'python.md', python_page()
    if not path.is_file() or path.read_text(encoding='utf-8') != text:
        path.write_text(text, encoding='utf-8')
    benchmarks.write_all(folder)


if __name__ == '__main__':
    for page, text in outdated(Path(__file__).parent).items():
        page.write_text(text, encoding='utf-8')
        print(page)
