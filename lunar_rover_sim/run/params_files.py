"""Parameter files of ROS 2 as the nodes read them: by the name of the program.

ROS 2 applies a section `physics_node` to the node `/physics_node` only: in a namespace, or under
`__node:=`, the node would silently get other parameters. And `-p` would lose against the section.
Here a section named by a program, `physics_node` or `/**/physics_node`, concerns that program
under every name and in every namespace; all other sections keep the meaning that ROS 2 gives them.

Lists that ROS 2 does not take are refused: it ends a node with an error that names no parameter
for an empty one, and drops all but the last of lists in a list.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lunar_rover_sim.base.errors import brief, ConfigError
from lunar_rover_sim.base.files.yaml_text import parse_yaml, read_text, yaml_of
from lunar_rover_sim.base.parameters import merge

SHARED = '/**'
ROS_KEY = 'ros__parameters'
MAX_BYTES = 1 << 18


def section_names(program: str) -> tuple[str, str]:
    """Return the two names that a section of a program may have."""
    return program, f'{SHARED}/{program}'


def arguments_of_program(arguments: Sequence[str], program: str, folder: Path) -> list[str]:
    """Return command-line arguments whose parameter files concern `program` by its sections.

    Args:
        folder: Takes the files that are written for this; ROS 2 reads them when it starts.

    Raises:
        ConfigError: For a parameter file that cannot be read, and for a list that ROS 2 does not
            take.
    """
    result = list(arguments)
    of_ros = False
    for k, argument in enumerate(arguments):
        if argument in ('--ros-args', '--'):
            of_ros = argument == '--ros-args'
        elif of_ros and arguments[k - 1] in ('-p', '--param'):
            name, _, value = argument.partition(':=')
            if value.lstrip().startswith('['):
                _check_lists(parse_yaml(value, f'-p {name}'), f'-p {name}')
        elif of_ros and arguments[k - 1] == '--params-file':
            text = _of_program(argument, program)
            if text:
                result[k] = str(folder / f'{k}.yaml')
                Path(result[k]).write_text(text, encoding='utf-8')
    return result


def _check_lists(value: Any, where: str) -> None:
    """Raise ConfigError for an empty list, and one of lists or mappings."""
    if isinstance(value, Mapping):
        for name, below in value.items():
            _check_lists(below, f'{where}: {name}')
    elif isinstance(value, list):
        if not value:
            raise ConfigError(f'{where}: [] is not valid: ROS 2 gives an empty list no type; '
                              'leave the parameter out')
        if any(isinstance(item, (list, Mapping)) for item in value):
            raise ConfigError(f'{where}: {brief(value)} is not valid; valid is a list of numbers '
                              'or of texts')


def _of_program(path: str, program: str) -> str:
    """Return a file whose `/**` includes the program's section; '' where it has none."""
    where = f'--params-file {path}'
    document = parse_yaml(read_text(Path(path), MAX_BYTES), where)
    if document is not None and not isinstance(document, Mapping):
        raise ConfigError(f'{where}: not a parameter file; valid is a mapping of nodes')
    _check_lists(document, where)
    own = [name for name in section_names(program) if name in (document or {})]
    if not own:
        return ''
    assert document is not None
    shared: dict[str, Any] = {}
    for name in (SHARED, *own):
        section = document.get(name)
        if name not in document:
            continue
        if not isinstance(section, Mapping) or set(section) != {ROS_KEY}:
            raise ConfigError(f'{where}: section {name!r} must hold {ROS_KEY!r} and nothing else')
        values = section[ROS_KEY] or {}
        if not isinstance(values, Mapping):
            raise ConfigError(f'{where}: {name}.{ROS_KEY} is not a mapping of parameters')
        shared = merge(shared, values)
    sections = {SHARED: {ROS_KEY: shared},
                **{name: body for name, body in document.items() if name not in (SHARED, *own)}}
    return yaml_of(sections)
