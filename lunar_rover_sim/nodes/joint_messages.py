"""Joint states and commands as plain numbers, past the messages that Python would make of them.

Two hundred of each come in a second, all alike but for their stamp and numbers: what stands before
the numbers is looked at once.
"""

from __future__ import annotations

import struct

from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from lunar_rover_sim.nodes import conversions
from lunar_rover_sim.nodes.template import AFTER_STAMP, MessageTemplate
from lunar_rover_sim.rover.description import JOINT_NAMES

Four = tuple[float, float, float, float]

_LITTLE_ENDIAN = b'\0\1\0\0'            # CDR's encapsulation
_COUNT = struct.Struct('<I')
_LEGS = struct.Struct('<4d')
_PITCH = _LEGS.size + 8                 # from one field to the next, whose count stands between


class JointReader:
    """Reads angles [rad] and velocities [rad/s] of the legs from serialised joint states."""

    def __init__(self) -> None:
        self._head = b''        # from behind the stamp up to the angles, of the usual message
        self._at = 0            # where they begin

    def read(self, raw: bytes, field: str) -> Four:
        """Return `field` (position, velocity) of the four legs, in their order.

        Joints may come in any order and among others; raise GraphError if one is missing.
        """
        if raw[AFTER_STAMP:self._at] != self._head or not self._head:
            return self._look(raw, field)
        if field == 'position':
            return _LEGS.unpack_from(raw, self._at)
        if _COUNT.unpack_from(raw, self._at + _LEGS.size) != (4,):
            return _legs_of(deserialize_message(raw, JointState), field)
        return _LEGS.unpack_from(raw, self._at + _PITCH)

    def _look(self, raw: bytes, field: str) -> Four:
        """Read any message; keep in mind how one that names the legs alone, in order, begins."""
        msg = deserialize_message(raw, JointState)
        if raw[:4] == _LITTLE_ENDIAN and tuple(msg.name) == JOINT_NAMES \
                and len(msg.position) == 4:
            self._at = _start_of_numbers(raw)
            self._head = raw[AFTER_STAMP:self._at]
        return _legs_of(msg, field)


def _legs_of(msg: JointState, field: str) -> Four:
    a, b, c, d = conversions.legs_of(msg, field).tolist()
    return a, b, c, d


def command_template() -> MessageTemplate:
    """Return joint commands to fill in: first four numbers angles, last four velocities."""
    raw = serialize_message(conversions.joint_state(Time(), [0.0] * 4, [0.0] * 4))
    size = _PITCH + _LEGS.size
    # Behind them the count of no efforts; what the serialiser adds is not part of the message.
    end = _start_of_numbers(raw) + size + _COUNT.size
    return MessageTemplate(raw[:end], size // 8, _COUNT.size)


def _start_of_numbers(raw: bytes) -> int:
    """Return where the angles of a joint state begin; alignment counts from behind byte 4."""
    at = _after_text(raw, AFTER_STAMP)
    count, = _COUNT.unpack_from(raw, _aligned(at, 4))
    at = _aligned(at, 4) + 4
    for _ in range(count):
        at = _after_text(raw, _aligned(at, 4))
    return _aligned(_aligned(at, 4) + 4, 8)


def _after_text(raw: bytes, at: int) -> int:
    length, = _COUNT.unpack_from(raw, at)
    return at + 4 + int(length)


def _aligned(at: int, size: int) -> int:
    return at + (4 - at) % size
