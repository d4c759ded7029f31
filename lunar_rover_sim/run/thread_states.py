"""Whether a process works or waits, as Linux tells it of each thread."""

from __future__ import annotations

from pathlib import Path

_WORKING = frozenset('RD')      # runs or waits for a core; waits for a disk


class Looks:
    """How often somebody was seen at work; who is idle wakes up for a moment now and then."""

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

    A process that does not exist any more is not at work. A machine that has ten times the work
    it can do does not change the answer, as it changes how much time a process gets.
    """
    try:
        return any(_state(task / 'stat') in _WORKING
                   for task in Path(f'/proc/{pid}/task').iterdir())
    except OSError:
        return False


def _state(file: Path) -> str:
    """Return the letter after the name, which is in parentheses and may hold some."""
    try:
        return file.read_text(encoding='utf-8', errors='replace').rpartition(') ')[2][:1]
    except OSError:     # the thread has ended
        return ''
