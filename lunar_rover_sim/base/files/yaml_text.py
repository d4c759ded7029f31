"""YAML as users write it: plain values only, `1e-3` is a number, and a date is text.

Files are untrusted. Tags, anchors and aliases are refused (nine lines with aliases can stand for
a billion values, and ROS 2 does not read them either); depth and size are bounded. A key that is
given twice is refused: YAML forbids it, and PyYAML would silently take the last value.
"""

from __future__ import annotations

import copy
import functools
from pathlib import Path
import re
from typing import Any

import yaml

from lunar_rover_sim.base.errors import brief, ConfigError, LunarRoverSimError, one_line
from lunar_rover_sim.base.files.paths import check_regular

_MAX_DEPTH = 32
# Of documents that programs write. In C, where PyYAML has that, it takes a tenth of the time.
FAST_LOADER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """Writes plain values; texts that `_Loader` takes for numbers are quoted, as 12e34."""


class _Loader(yaml.SafeLoader):
    """Loads plain values; reads 1e-3 and 1.0e6, which are text in YAML 1.1, as numbers."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node; raise ComposerError if it is more than plain values."""
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise yaml.composer.ComposerError(None, None, 'anchors and aliases are not valid here',
                                              event.start_mark)
        if event.tag not in (None, '!'):
            raise yaml.composer.ComposerError(None, None, 'tags are not valid here',
                                              event.start_mark)
        if self._depth >= _MAX_DEPTH:
            raise yaml.composer.ComposerError(
                None, None, f'nested deeper than {_MAX_DEPTH} levels', event.start_mark)
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping; raise ConstructorError if a key is given twice."""
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f'{brief(key.value)} is given twice', key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


for _each in (_Loader, _Dumper):
    _each.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9]*)?)[eE][-+]?[0-9]+$'),
        list('-+.0123456789'))


# A date stays text, as in ROS 2: 2026-11-22T06:00:00Z needs no quotes.
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers
            if tag != 'tag:yaml.org,2002:timestamp']
    for first, resolvers in _Loader.yaml_implicit_resolvers.items()}


def read_yaml(path: Path, most_bytes: int, error: type[LunarRoverSimError] = ConfigError) -> Any:
    """Return the document in a file as plain values; raise `error` as the two below do."""
    return parse_yaml(read_text(path, most_bytes, error), str(path), error)


def parse_yaml(text: str, where: str, error: type[LunarRoverSimError] = ConfigError) -> Any:
    """Return the document as plain values.

    Raises `error`, in which `where` names the document, if it is not valid.
    """
    try:
        return copy.deepcopy(_parsed(text))
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as reason:
        raise error(f'{where}: not valid YAML: {_line(reason)}') from None


# The episodes of a campaign share a scenario, all its parts a gait table: 30 ms each to parse.
@functools.lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    return yaml.load(text, _Loader)  # noqa: S506  (a safe loader)


def yaml_of(document: Any, **layout: Any) -> str:
    """Return plain values as YAML, keys in their order.

    Args:
        layout: Options of `yaml.dump`, such as width. libyaml takes a third of the time of PyYAML
            itself; long texts it may break elsewhere.
    """
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, **layout)


def read_text(path: Path, most_bytes: int, error: type[LunarRoverSimError] = ConfigError) -> str:
    """Return the text of a regular file.

    Raises `error` if it does not exist, is larger than most_bytes, or is not UTF-8.
    """
    check_regular(path, error)
    try:
        with path.open('rb') as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            raise error(f'{path}: larger than {most_bytes} bytes')
        return content.decode('utf-8')
    except UnicodeDecodeError:
        raise error(f'{path}: cannot be read: it is not UTF-8 text') from None
    except OSError as reason:
        raise error(f'{path}: cannot be read: {reason.strerror}') from None


def _line(error: BaseException) -> str:
    # PyYAML's name of a text that has no file; the caller names the file.
    text = one_line(error).replace('"<unicode string>", ', '')
    text = ''.join(c if c.isprintable() else '?' for c in text)
    return text if len(text) <= 300 else text[:300] + ' ...'
