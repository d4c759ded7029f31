"""Message types of bags that were opened before: bags with the same definitions share them."""

from __future__ import annotations

from rosbags.typesys.store import Typestore

_MOST = 8
_known: dict[str, Typestore] = {}


def known_typestore(typestore: Typestore) -> Typestore:
    """Return the typestore of an earlier bag with the same definitions, or the given one.

    A typestore compiles what reads a type when it first meets one: 40 ms for those of a drive.
    """
    definitions = repr(sorted(typestore.fielddefs.items()))
    if definitions not in _known and len(_known) >= _MOST:
        _known.clear()
    return _known.setdefault(definitions, typestore)
