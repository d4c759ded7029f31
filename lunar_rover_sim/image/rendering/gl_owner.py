"""Ownership of GL objects: who makes them releases them, the last one first."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from typing import Any, Protocol, TypeVar


class Releasable(Protocol):
    """A GL object, or an owner of some."""

    def release(self) -> Any:
        """Release them."""


Owned = TypeVar('Owned', bound=Releasable)


class GlOwner:
    """A base class for what is made of several objects of one context."""

    def __init__(self) -> None:
        self._owned = contextlib.ExitStack()

    @contextlib.contextmanager
    def _making(self) -> Iterator[None]:
        """Release what is owned so far if making the rest fails."""
        try:
            yield
        except Exception:
            self.release()
            raise

    def _own(self, item: Owned) -> Owned:
        """Have an object released with this one."""
        self._owned.callback(item.release)
        return item

    def release(self) -> None:
        """Release the GL objects."""
        self._owned.close()
