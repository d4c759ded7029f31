"""The sections of a scenario: those of its file, and those that overrides change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
from pathlib import Path
from typing import Any

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.files.yaml_text import parse_yaml, read_yaml
from lunar_rover_sim.parameters import nearest, nest
from lunar_rover_sim.run.node_config import NODE_CONFIGS
from lunar_rover_sim.run.params_files import MAX_BYTES, ROS_KEY, section_names, SHARED
from lunar_rover_sim.run.shared_config import NodeConfig


def read_sections(path: Path) -> dict[str, Any]:
    """Return section → nested values of a scenario file; ConfigError for unknown sections."""
    document = read_yaml(path, MAX_BYTES)
    if document is None:
        document = {}
    if not isinstance(document, Mapping):
        raise ConfigError(f'{path}: not a scenario; valid is a mapping of sections')
    sections: dict[str, Any] = {}
    programs = {name: node for node in NODE_CONFIGS for name in section_names(node)}
    for name, body in document.items():
        section = programs.get(name, name)
        if section not in _section_names():
            raise ConfigError(f'{path}: no such section {brief(section)}; '
                              f'{nearest(str(section), _section_names())}')
        if section in sections:
            raise ConfigError(f'{path}: section {section} is given twice')
        if not isinstance(body, Mapping) or set(body) != {ROS_KEY}:
            raise ConfigError(f'{path}: section {section!r} must hold {ROS_KEY!r} and nothing '
                              'else')
        values = body[ROS_KEY]
        if values is not None and not isinstance(values, Mapping):
            raise ConfigError(f'{path}: {section}.{ROS_KEY} is not a mapping of parameters')
        sections[section] = nest(values or {}, section)
    return sections


def _section_names() -> tuple[str, ...]:
    return (SHARED, 'world', 'rover', 'run', *NODE_CONFIGS)


def _shared_names() -> list[str]:
    return [field.name for field in dataclasses.fields(NodeConfig)]


def override_sections(overrides: Iterable[str] | Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return each override as nested sections; ConfigError where they are no texts."""
    items: list[Any] = list(overrides) if isinstance(overrides, Iterable) else [overrides]
    if isinstance(overrides, str) or not all(isinstance(item, str) for item in items):
        raise ConfigError(f'overrides: {brief(overrides)} is not valid; valid is a list of '
                          "'section.parameter=value', or a mapping of 'section.parameter' to "
                          'values')
    if isinstance(overrides, Mapping):
        return [_override(name, value, f'overrides: {name}') for name, value in overrides.items()]
    return [_parse_override(text) for text in items]


def _parse_override(override: str) -> dict[str, Any]:
    name, equals, text = override.partition('=')
    if not equals or not name:
        raise ConfigError(f'--set {override}: valid is section.parameter=value')
    return _override(name, parse_yaml(text, f'--set {override}'), f'--set {override}')


def _override(name: str, value: Any, where: str) -> dict[str, Any]:
    """Return one parameter as nested sections; `where` names it in the ConfigError."""
    section, dot, parameter = name.partition('.')
    if not dot and section in _shared_names():
        return {SHARED: {section: value}}
    if not dot or section not in _section_names():
        valid = [s for s in _section_names() if s != SHARED]
        valid += [] if dot else _shared_names()
        raise ConfigError(f'{where}: no such section {brief(section)}; '
                          f'{nearest(section, valid)}')
    return {section: nest({parameter: value})}
