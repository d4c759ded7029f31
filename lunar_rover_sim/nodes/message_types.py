"""Message classes by their ROS 2 type names, and tf where tf2_msgs is not installed."""

from __future__ import annotations

from ctypes import (addressof, byref, c_bool, c_char_p, c_size_t, c_uint8, c_uint32, c_uint64,
                    c_void_p, cast, CFUNCTYPE, py_object, pythonapi, sizeof, Structure)
import functools
import importlib
import re
from typing import Any

from geometry_msgs.msg import PoseArray, TransformStamped
import rclpy
from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import GraphError


def message_class(type_name: str) -> Any:
    """Return the class of `package/msg/Name`; raise GraphError where it is not installed."""
    package, _, name = type_name.replace('/msg/', '/').partition('/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        if f'{package}/msg/{name}' == topics.TF.type:
            return tf_message_class()
        raise GraphError(f'{type_name}: no such message type is installed; install the package '
                         f'{package}') from None


def name_of(cls: Any) -> str:
    """Return the `package/msg/Name` of a message class."""
    return f'{cls.__module__.partition(".")[0]}/msg/{cls.__name__}'


_NAMES = {'boolean': 'bool', 'double': 'float64', 'float': 'float32', 'octet': 'byte'}
_RULE = '=' * 80
_SEQUENCE = re.compile(r'sequence<(.+?)(?:, (\d+))?>')
_ARRAY = re.compile(r'(.+)\[(\d+)\]')
_STRING = re.compile(r'(w?string)<(\d+)>')


def definition_of(type_name: str) -> str:
    """Return the definition of `package/msg/Name`, and of the types that it uses, as MCAP has it.

    Raises:
        GraphError: Where one of them is not installed.
    """
    parts: dict[str, str] = {}
    waiting = [type_name.replace('/msg/', '/')]
    while waiting:
        name = waiting.pop(0)
        if name in parts:
            continue
        lines = []
        for field, kind in _fields(message_class(name)).items():
            text, element = _written(kind)
            lines.append(f'{text} {field}')
            if '/' in element:
                waiting.append(element)
        parts[name] = '\n'.join(lines) + '\n'
    first, *rest = parts.items()
    return first[1] + ''.join(f'{_RULE}\nMSG: {name}\n{text}' for name, text in rest)


def _fields(cls: Any) -> dict[str, str]:
    fields: dict[str, str] = cls.get_fields_and_field_types()
    return fields


def _written(kind: str) -> tuple[str, str]:
    """Return a type of rclpy as `.msg` files have it, and the type of its elements."""
    if match := _SEQUENCE.fullmatch(kind):
        text, element = _written(match[1])
        return text + (f'[<={match[2]}]' if match[2] else '[]'), element
    if match := _ARRAY.fullmatch(kind):
        text, element = _written(match[1])
        return f'{text}[{match[2]}]', element
    if match := _STRING.fullmatch(kind):
        return f'{match[1]}<={match[2]}', match[1]
    name = _NAMES.get(kind, kind)
    return name, name


# tf2_msgs/msg/TFMessage where tf2_msgs is not installed: PyPI has no such package. To publish a
# type, rclpy and rmw_fastrtps need its name, its description (REP 2016) and a bound of its size.
# These are put together here, at run time, of the structures of rosidl that TransformStamped has
# with it. Messages are published and read serialised only (`run/transforms.py`).
_RMW = 'rmw_fastrtps_cpp'
_FAST_DDS, _INTROSPECTION = b'rosidl_typesupport_fastrtps_c', b'rosidl_typesupport_introspection_c'
_ELEMENT = 'geometry_msgs/msg/TransformStamped'
_NESTED_SEQUENCE = 145      # type_description_interfaces/msg/FieldType: sequence of messages


def _structure(title: str, /, **fields: Any) -> Any:
    return type(title, (Structure,), {'_fields_': list(fields.items())})


# As in the headers of rosidl_runtime_c and rosidl_typesupport_fastrtps_cpp.
_String = _structure('String', data=c_char_p, size=c_size_t, capacity=c_size_t)
_Sequence = _structure('Sequence', data=c_void_p, size=c_size_t, capacity=c_size_t)
_FieldType = _structure('FieldType', type_id=c_uint8, capacity=c_uint64, string_capacity=c_uint64,
                        nested_type_name=_String)
_Field = _structure('Field', name=_String, type=_FieldType, default_value=_String)
_Individual = _structure('Individual', type_name=_String, fields=_Sequence)
_Description = _structure('Description', described=_Individual, referenced=_Sequence)
_Hash = _structure('Hash', version=c_uint8, value=c_uint8 * 32)
_Find, _Ask = CFUNCTYPE(c_void_p, c_void_p, c_char_p), CFUNCTYPE(c_void_p, c_void_p)
_Support = _structure('Support', identifier=c_char_p, data=c_void_p, find=_Find, hash=_Ask,
                      description=_Ask, sources=_Ask)
_Callbacks = _structure('Callbacks', namespace=c_char_p, name=c_char_p, serialize=c_void_p,
                        deserialize=c_void_p, size=c_void_p, most_size=c_void_p, keys=c_void_p)
_Member = _structure('Member', name=c_char_p, type_id=c_uint8, string_bound=c_size_t,
                     support=c_void_p, is_key=c_bool, is_array=c_bool, array_size=c_size_t,
                     is_bound=c_bool, offset=c_uint32, default=c_void_p, access=c_void_p * 6)
_Members = _structure('Members', namespace=c_char_p, name=c_char_p, count=c_uint32, size=c_size_t,
                      has_key=c_bool, members=c_void_p, start=c_void_p, end=c_void_p)
_Create = CFUNCTYPE(c_void_p)

_pointer_of = pythonapi.PyCapsule_GetPointer
_pointer_of.restype, _pointer_of.argtypes = c_void_p, [py_object, c_char_p]
_capsule_of = pythonapi.PyCapsule_New
_capsule_of.restype, _capsule_of.argtypes = py_object, [c_void_p, c_char_p, c_void_p]


@functools.cache
def tf_message_class() -> Any:
    """Return a class by which rclpy publishes and reads TFMessage, serialised.

    Raises:
        GraphError: There is another middleware than Fast DDS.
    """
    if (found := rclpy.get_rmw_implementation_identifier()) != _RMW:
        raise GraphError(f'{topics.TF.type}: with {found} install the package tf2_msgs; without '
                         f'it, tf needs {_RMW}')
    kept: list[Any] = []        # what C points to

    def keep(value: Any) -> Any:
        kept.append(value)
        return value

    # PoseArray has a sequence of messages, too: copies of what describes it serve here.
    description = keep(_description(_support_of(TransformStamped, _FAST_DDS), keep))
    digest = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(topics.TF.type)
    type_hash = keep(_Hash(1, (c_uint8 * 32)(*bytes.fromhex(digest.removeprefix('RIHS01_')))))
    callbacks = keep(_copy(_Callbacks, _support_of(PoseArray, _FAST_DDS).data))
    callbacks.namespace, callbacks.name = b'tf2_msgs::msg', b'TFMessage'
    members = keep(_copy(_Members, _support_of(PoseArray, _INTROSPECTION).data))
    member = keep(_copy(_Member, members.members + sizeof(_Member)))    # after the header
    member.name, member.offset, member.access = b'transforms', 0, (c_void_p * 6)()
    member.support = addressof(_support_of(TransformStamped, _INTROSPECTION))
    members.namespace, members.name = b'tf2_msgs__msg', b'TFMessage'
    members.count, members.size, members.members = 1, sizeof(_Sequence), addressof(member)
    members.start = members.end = None

    answers = [keep(_Ask(lambda _, told=keep(told): addressof(told)))
               for told in (type_hash, description, _Sequence())]
    supports = {name: keep(_Support(name, addressof(data))) for name, data in (
        (_FAST_DDS, callbacks), (_INTROSPECTION, members))}
    find = keep(_Find(lambda _, name: addressof(supports[name]) if name in supports else None))
    for support in supports.values():
        support.find, (support.hash, support.description, support.sources) = find, answers
    # A message that is to be converted cannot be created: rclpy raises MemoryError.
    refuse = _capsule_of(cast(keep(_Create(lambda: None)), c_void_p), None, None)
    meta = type('Metaclass_TFMessage', (type,), {
        '_TYPE_SUPPORT': _capsule_of(addressof(supports[_FAST_DDS]), None, None),
        **dict.fromkeys(('_CREATE_ROS_MESSAGE', '_CONVERT_FROM_PY', '_CONVERT_TO_PY',
                         '_DESTROY_ROS_MESSAGE'), refuse),
        '_kept': kept})
    return meta('TFMessage', (), {
        '__module__': 'tf2_msgs.msg', '__slots__': ('_transforms',),
        'get_fields_and_field_types': classmethod(
            lambda cls: {'transforms': f'sequence<{_ELEMENT.replace("/msg/", "/")}>'})})


def _support_of(cls: Any, name: bytes) -> Any:
    """Return the type support of a message class for one use of it."""
    cls.__class__.__import_type_support__()
    pointer = _pointer_of(cls.__class__._TYPE_SUPPORT, None)
    return _Support.from_address(_Support.from_address(pointer).find(pointer, name))


def _copy(structure: Any, address: int) -> Any:
    return structure.from_buffer_copy(structure.from_address(address))


def _description(element: Any, keep: Any) -> Any:
    """Return that of TFMessage, with those that TransformStamped refers to."""
    inner = _Description.from_address(element.description(byref(element)))
    parts = (_Individual * inner.referenced.size).from_address(inner.referenced.data)
    referenced = (_Individual * (len(parts) + 1))(
        *sorted([inner.described, *parts], key=lambda one: str(one.type_name.data)))
    field = _Field(_string(b'transforms'), _FieldType(
        _NESTED_SEQUENCE, 0, 0, _string(_ELEMENT.encode())), _string(b''))
    return _Description(
        _Individual(_string(topics.TF.type.encode()), _Sequence(addressof(keep(field)), 1, 1)),
        _Sequence(addressof(keep(referenced)), len(referenced), len(referenced)))


def _string(text: bytes) -> Any:
    return _String(text, len(text), len(text) + 1)
