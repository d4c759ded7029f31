"""What the nodes of a run warn of, read from their logs while it goes on."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from pathlib import Path
import re

_LINE = re.compile(rb'\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[([^\]]*)\]: (.*)')
_NUMBER = re.compile(r'-?(\d[\d.e+-]*|\b(nan|inf)\b)')
_COUNTED = re.compile(r'\(\d+ so far\)')
# A node that floods its log does not hold up the run.
_MOST_BYTES = 1 << 16


@dataclasses.dataclass(frozen=True)
class NodeWarning:
    """One line of level WARN or worse in the log of a node."""

    node: str
    level: str
    text: str

    def __str__(self) -> str:
        return f'{self.node}: {self.level}: {self.text}'


class NodeLogs:
    """Reads the logs of nodes as they grow.

    path_by_node: node → its log, which need not exist yet
    """

    def __init__(self, path_by_node: Mapping[str, Path]) -> None:
        self._paths = dict(path_by_node)
        self._offsets = dict.fromkeys(self._paths, 0)
        self._warnings: list[NodeWarning] = []

    def new_warnings(self) -> list[NodeWarning]:
        """Return the warnings and errors that were written since the last call."""
        new = [warning for node in self._paths for warning in self._read(node)]
        self._warnings += new
        return new

    def summary(self) -> list[str]:
        """Return one line per kind of warning so far; texts may differ in numbers.

        Of a warning that counts itself, `(N so far)`, the last line tells all.
        """
        kinds: dict[tuple[str, str], list[NodeWarning]] = {}
        for warning in self._warnings:
            key = warning.node, _NUMBER.sub('#', warning.text)
            kinds.setdefault(key, []).append(warning)
        return [f'{same[-1]}' + (f' ({len(same)} times; the last one is shown)'
                                 if len(same) > 1 and not _COUNTED.search(same[-1].text) else '')
                for same in kinds.values()]

    def _read(self, node: str) -> list[NodeWarning]:
        path, offset = self._paths[node], self._offsets[node]
        if not path.exists() or path.stat().st_size <= offset:
            return []
        with path.open('rb') as file:
            file.seek(offset)
            chunk = file.read(_MOST_BYTES)
        # The rest of a line that is being written is read by the next call.
        whole = chunk[:chunk.rfind(b'\n') + 1]
        self._offsets[node] += len(whole) if whole or len(chunk) < _MOST_BYTES else len(chunk)
        return [NodeWarning(node, match[1].decode(), match[3].decode(errors='replace'))
                for match in map(_LINE.match, whole.splitlines()) if match]
