"""Whether loops are being compiled, for those who show what a wait is for.

Without Numba, which takes half a second to import.
"""

from __future__ import annotations

from collections.abc import Callable

WORDS = 'compiling, once'      # Numba keeps what it has compiled


class Compilation:
    """Compilation in this process, of what no earlier process has kept.

    Attributes:
        running: Number of functions under way, one within another.
        on_change: Called with whether anything is compiled, when that begins or ends.
    """

    def __init__(self) -> None:
        self.running = 0
        self.on_change: Callable[[bool], None] = lambda _is_running: None

    def begin(self) -> None:
        """Take note that a function begins to be compiled."""
        self.running += 1
        if self.running == 1:
            self.on_change(True)

    def end(self) -> None:
        """Take note that a function is compiled."""
        self.running -= 1
        if not self.running:
            self.on_change(False)


COMPILATION = Compilation()
