"""Context managers whose end is `close`."""

from __future__ import annotations

from typing import TypeVar

Owner = TypeVar('Owner', bound='Closing')


class Closing:
    """Holds something until it is closed; a context manager that closes itself at the end."""

    def close(self) -> None:
        """Give back what it holds."""
        raise NotImplementedError

    def __enter__(self: Owner) -> Owner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
