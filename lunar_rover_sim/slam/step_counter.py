"""How far a step of a long piece of work is, as text for people."""

from __future__ import annotations

from collections.abc import Callable


class StepCounter:
    """Tells how many parts of a piece of work are done, about a hundred times in each."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._text, self._total, self._count = '', 0, 0

    def begin(self, text: str, total: int | None) -> None:
        """Announce work of `total` parts; None if unknown."""
        self._text, self._total, self._count = text, total or 0, 0
        self._tell(text)

    def advance(self) -> None:
        """Count a part that is done."""
        self._count += 1
        if self._total and self._count % max(1, self._total // 100) == 0:
            self._tell(f'{self._text}, {self._count} of {self._total}')
