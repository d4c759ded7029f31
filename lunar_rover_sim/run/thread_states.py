"""Whether a process works or waits, from the states of its threads in Linux."""

from __future__ import annotations

from pathlib import Path

_WORKING = frozenset('RD')      # R: runs or waits for a core; D: waits for a disk


class Looks:
    """Share of samples in which a process was active. Idle processes wake up briefly, too."""

    def __init__(self) -> None:
        self._count = self._working = 0

    def add(self, working: bool) -> None:
        """Note one look."""
        self._count += 1
        self._working += working

    @property
    def idle(self) -> bool:
        """Whether less than half of the looks saw work."""
        return 2 * self._working < self._count


def is_at_work(pid: int) -> bool:
    """Return whether any thread of a process runs, would if it had a core, or waits for a disk.

    A process that does not exist any more is not at work. The load of the machine changes how
    much time a process gets, but not the answer.
    """
    try:
        return any(_state(task / 'stat') in _WORKING
                   for task in Path(f'/proc/{pid}/task').iterdir())
    except OSError:
        return False


def _state(file: Path) -> str:
    """Return the state letter: it follows the last parenthesis, as the name may hold others."""
    try:
        return file.read_text(encoding='utf-8', errors='replace').rpartition(') ')[2][:1]
    except OSError:     # the thread has ended
        return ''
