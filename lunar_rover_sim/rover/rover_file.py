"""Rover descriptions as YAML files."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import find_file
from lunar_rover_sim.base.files.yaml_text import read_yaml, yaml_of
from lunar_rover_sim.rover.description import DEFAULT_ROVER, RoverDescription

_MOST_BYTES = 1 << 18


def load_rover(path: str | Path | None = None) -> RoverDescription:
    """Return a rover by its YAML file, or by the name of a packaged one; by default `quad`.

    Raises:
        ConfigError: If there is none, or if it cannot be read or is not valid.
    """
    path = find_file('rover', str(path or DEFAULT_ROVER))
    content = read_yaml(path, _MOST_BYTES)
    try:
        return RoverDescription.from_mapping({} if content is None else content)
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from None


def save_rover(rover: RoverDescription, path: str | Path) -> None:
    """Write the rover to a YAML file for `load_rover`; raise ConfigError if that fails."""
    atomic_write(path, yaml_of(rover.to_mapping()), ConfigError)
