"""Message types of bags: those that their definitions give; bags with the same ones share them."""

from __future__ import annotations

from collections.abc import Iterable
import functools

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import (get_types_from_idl, get_types_from_msg, get_typestore, Stores,
                             TypesysError)
from rosbags.typesys.store import Typestore

_RULE = '=' * 80 + '\n'     # between the parts of a definition


def typestore_of(connections: Iterable[Connection]) -> Typestore:
    """Return the types that the definitions of connections give.

    They are those of ROS 2 Jazzy where no connection has a definition. Raises rosbags'
    TypesysError where a definition cannot be read, or where its hash (REP 2016) is another than
    the bag states.
    """
    return _typestore(tuple(dict.fromkeys(
        (c.msgtype, c.msgdef, c.digest) for c in connections
        if c.msgdef.format != MessageDefinitionFormat.NONE)))


@functools.lru_cache(maxsize=8)     # 70 ms for those of a drive, and as much when they are used
def _typestore(definitions: tuple[tuple[str, MessageDefinition, str], ...]) -> Typestore:
    if not definitions:
        return get_typestore(Stores.ROS2_JAZZY)
    store = get_typestore(Stores.EMPTY)
    types = {}
    for name, definition, _ in definitions:
        if definition.format == MessageDefinitionFormat.MSG:
            types.update(get_types_from_msg(definition.data, name))
            continue
        for part in filter(None, definition.data.split(_RULE)):
            title, _, rest = part.partition('\n')
            types.update(get_types_from_idl(rest if title.startswith('IDL: ') else part))
    store.register(types)
    for name, _, stated in definitions:
        if stated and stated != (found := store.hash_rihs01(name)):
            raise TypesysError(f'the definition of {name} has the hash {found}; the bag states '
                               f'{stated}')
    return store
