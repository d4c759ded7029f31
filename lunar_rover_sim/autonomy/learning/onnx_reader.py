"""ONNX files of small networks, read without a library of ONNX.

Metadata must be read where onnxruntime is absent, and layers be computed with NumPy there. The
wire format is that of Protocol Buffers (encoding: varint keys, lengths); the field numbers are
those of `onnx.proto` (ONNX IR version 3 and later).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import dataclasses
import struct

import numpy as np

from lunar_rover_sim.base.errors import LearningError

_FLOAT, _DOUBLE = 1, 11         # TensorProto.DataType
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MOST_ELEMENTS = 1 << 20


@dataclasses.dataclass(frozen=True)
class Node:
    """One operation: its type, names of inputs and outputs, numbers among its attributes."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, float]


@dataclasses.dataclass(frozen=True)
class OnnxFile:
    """A network.

    Attributes:
        opset: Version of ONNX's own operators; 0 where it is not said.
        metadata: Key → text.
        nodes: In the order of computation.
        weights: Name → array.
        inputs: Names, those of weights left out.
        outputs: Names.
    """

    opset: int
    metadata: dict[str, str]
    nodes: tuple[Node, ...]
    weights: dict[str, np.ndarray]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @classmethod
    def parse(cls, content: bytes) -> OnnxFile:
        """Read a file's content.

        Raises:
            LearningError: It is truncated, or no ONNX.
        """
        try:
            return _model(content)
        except (ValueError, IndexError, KeyError, struct.error, UnicodeDecodeError,
                OverflowError) as error:
            raise LearningError(f'is truncated or no ONNX file ({error})') from None

    def unknown(self) -> list[str]:
        """Return the kinds of operations that `run` does not know."""
        return sorted({node.kind for node in self.nodes} - set(_OPERATIONS))

    def run(self, observation: np.ndarray) -> np.ndarray:
        """Return the first output for one observation, (n,), as float32."""
        values = {**self.weights, self.inputs[0]: observation[None].astype(np.float32)}
        for node in self.nodes:
            given = [values[name] for name in node.inputs if name]
            values[node.outputs[0]] = _OPERATIONS[node.kind](given, node.attributes)
        return np.asarray(values[self.outputs[0]][0], np.float32)


def _gemm(given: list[np.ndarray], attributes: dict[str, float]) -> np.ndarray:
    a, b = given[:2]
    a = a.T if attributes.get('transA') else a
    b = b.T if attributes.get('transB') else b
    product = np.float32(attributes.get('alpha', 1.0)) * (a @ b)
    return product + np.float32(attributes.get('beta', 1.0)) * given[2] if given[2:] else product


_OPERATIONS: dict[str, Callable[[list[np.ndarray], dict[str, float]], np.ndarray]] = {
    'Gemm': _gemm,
    'MatMul': lambda given, _: given[0] @ given[1],
    'Add': lambda given, _: given[0] + given[1],
    'Tanh': lambda given, _: np.tanh(given[0]),
    'Relu': lambda given, _: np.maximum(given[0], np.float32(0.0)),
    'Elu': lambda given, attributes: np.where(
        given[0] > 0.0, given[0],
        np.float32(attributes.get('alpha', 1.0)) * np.expm1(np.minimum(given[0], 0.0))),
    'Clip': lambda given, _: np.minimum(np.maximum(given[0], given[1]), given[2]),
    'Identity': lambda given, _: given[0]}


def _model(content: bytes) -> OnnxFile:
    opset, metadata, graph = 0, {}, None
    for number, value in _fields(content):
        if number == 7:
            graph = _bytes(value)
        elif number == 8:
            fields = dict(_fields(_bytes(value)))
            if not fields.get(1):       # the domain of ONNX itself
                opset = int(fields.get(2, 0))
        elif number == 14:
            pair = dict(_fields(_bytes(value)))
            metadata[_bytes(pair[1]).decode()] = _bytes(pair.get(2, b'')).decode()
    if graph is None:
        raise ValueError('it has no graph')
    nodes: list[Node] = []
    weights: dict[str, np.ndarray] = {}
    inputs: list[str] = []
    outputs: list[str] = []
    for number, value in _fields(graph):
        if number == 1:
            nodes.append(_node(_bytes(value)))
        elif number == 5:
            name, array = _tensor(_bytes(value))
            weights[name] = array
        elif number in (11, 12):
            name = _bytes(dict(_fields(_bytes(value)))[1]).decode()
            (inputs if number == 11 else outputs).append(name)
    names = tuple(name for name in inputs if name not in weights)
    if not nodes or len(names) != 1 or not outputs:
        raise ValueError('it has no operations, or not one input')
    return OnnxFile(opset, metadata, tuple(nodes), weights, names, tuple(outputs))


def _node(content: bytes) -> Node:
    kind = ''
    inputs: list[str] = []
    outputs: list[str] = []
    attributes: dict[str, float] = {}
    for number, value in _fields(content):
        if number == 1:
            inputs.append(_bytes(value).decode())
        elif number == 2:
            outputs.append(_bytes(value).decode())
        elif number == 4:
            kind = _bytes(value).decode()
        elif number == 5:
            fields = dict(_fields(_bytes(value)))
            number_of = fields.get(2, fields.get(3))
            if isinstance(number_of, (int, float)):
                attributes[_bytes(fields[1]).decode()] = float(number_of)
    return Node(kind, tuple(inputs), tuple(outputs), attributes)


def _tensor(content: bytes) -> tuple[str, np.ndarray]:
    shape: list[int] = []
    kind, name, raw, floats = 0, '', b'', b''
    for number, value in _fields(content):
        if number == 1:
            shape += [value] if isinstance(value, int) else list(_varints(_bytes(value)))
        elif number == 2:
            kind = int(value)
        elif number == 4:
            floats += struct.pack('<f', value) if isinstance(value, float) else _bytes(value)
        elif number == 8:
            name = _bytes(value).decode()
        elif number == 9:
            raw = _bytes(value)
    if kind not in (_FLOAT, _DOUBLE):
        raise ValueError(f'tensor {name[:40]!r} has no floating numbers')
    if int(np.prod(shape, dtype=object)) > _MOST_ELEMENTS:
        raise ValueError(f'tensor {name[:40]!r} is too large')
    array = np.frombuffer(raw or floats, '<f4' if kind == _FLOAT else '<f8')
    return name, array.astype(np.float32).reshape(shape)


def _bytes(value: int | float | bytes) -> bytes:
    if not isinstance(value, bytes):
        raise ValueError('a field has another type')
    return value


def _fields(content: bytes) -> Iterator[tuple[int, int | float | bytes]]:
    """Yield number and value of each field of a message."""
    at = 0
    while at < len(content):
        key, at = _varint(content, at)
        number, wire = key >> 3, key & 7
        value: int | float | bytes
        if wire == _VARINT:
            value, at = _varint(content, at)
        elif wire == _BYTES:
            length, at = _varint(content, at)
            if at + length > len(content):
                raise ValueError('it ends within a field')
            value, at = content[at:at + length], at + length
        elif wire in (_FIXED32, _FIXED64):
            form, size = ('<f', 4) if wire == _FIXED32 else ('<d', 8)
            value, at = struct.unpack_from(form, content, at)[0], at + size
        else:
            raise ValueError(f'wire type {wire}')
        yield number, value


def _varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 0x7f) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError('a number of more than 64 bits')


def _varints(content: bytes) -> Iterator[int]:
    at = 0
    while at < len(content):
        value, at = _varint(content, at)
        yield value
