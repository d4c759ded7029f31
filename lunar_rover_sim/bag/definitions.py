"""Message types that ROS 2 Jazzy does not have: learned from the definition that comes along."""

from __future__ import annotations

from rosbags.typesys import get_types_from_msg, get_typestore, Stores, TypesysError
from rosbags.typesys.store import Typestore

from lunar_rover_sim.errors import BagError, one_line


def learn(typestore: Typestore, msgtype: str, definition: str) -> None:
    """Register a type and those it is made of; known ones stay as they are.

    definition: the `.msg` text; the types it uses follow in sections `===…` + `MSG: package/Type`,
        as MCAP files hold it.

    Raises BagError where the definition cannot be read.
    """
    known = typestore.fielddefs
    try:
        types = {name: fields for name, fields in get_types_from_msg(definition, msgtype).items()
                 if name not in known}
        trial = get_typestore(Stores.EMPTY)
        trial.fielddefs.update(known)
        trial.register(types)
        trial.hash_rihs01(msgtype)
    except (TypesysError, KeyError) as error:
        reason = one_line(error)
        raise BagError(f'the definition of {msgtype} cannot be read: {reason}') from None
    typestore.register(types)
