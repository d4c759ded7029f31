"""YAML as users write it: safe tags only, and `1e-3` is a number."""

from __future__ import annotations

import re
from typing import Any

import yaml

from lunar_rover_sim.errors import ConfigError


class _Loader(yaml.SafeLoader):
    """PyYAML follows YAML 1.1, where a float needs a point: 1e-3 would be text."""


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?[0-9][0-9_]*[eE][-+]?[0-9]+'),
    list('-+0123456789'))


def parse_yaml(text: str, where: str) -> Any:
    """Return the document as plain values; `where` names it in the ConfigError if it is broken."""
    try:
        return yaml.load(text, _Loader)  # noqa: S506  (a safe loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(f'{where}: not valid YAML: {" ".join(str(error).split())}') from None
