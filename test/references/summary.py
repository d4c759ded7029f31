"""What is stored of a result, and whether another result is the same.

Text, whole numbers and truth values are compared exactly, floating-point numbers to a tolerance.
Of an array its shape, some of its values and a sum are stored. The sum has a weight of its own for
each element, so that elements cannot change places.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import hashlib
import json
import math
from typing import Any

import numpy as np

# Relative, of a number, or of the largest number of an array. Libraries and processors differ in
# the last bits: 1e-16 of a number in double precision, 6e-8 in single precision, and what sums and
# differences make of that.
DOUBLE, SINGLE = 1e-6, 1e-5
_NOTHING = 1e-12        # absolute: what rounding leaves of a zero
_SAMPLES, _ALL = 2, 6     # values of an array that are stored; of one so small all are


@dataclasses.dataclass(frozen=True)
class Within:
    """A result with a tolerance of its own, for computations that let small differences grow."""

    value: Any
    tolerance: float


def summarised(value: Any, tolerance: float = 0.0) -> Any:
    """Return a result as JSON holds it; tolerance: 0 for that of its type."""
    if isinstance(value, Within):
        return summarised(value.value, value.tolerance)
    if value is None or isinstance(value, (bool, str, int)):
        return value
    if isinstance(value, (np.bool_, np.integer)):
        return value.item()
    if isinstance(value, (float, np.floating)):
        tolerance = tolerance or (SINGLE if isinstance(value, np.float32) else DOUBLE)
        digits = _digits(float(value), tolerance)
        return digits if tolerance == DOUBLE else ['float', tolerance, digits]
    if isinstance(value, np.ndarray):
        return _array(value, tolerance)
    if isinstance(value, Mapping):
        return {str(key): summarised(item, tolerance) for key, item in value.items()}
    if dataclasses.is_dataclass(value):
        return {field.name: summarised(getattr(value, field.name), tolerance)
                for field in dataclasses.fields(value)}
    if hasattr(value, '_asdict'):
        return summarised(value._asdict(), tolerance)
    if isinstance(value, (tuple, list)):
        if value and all(isinstance(item, float) for item in value):
            return _array(np.array(value), tolerance)
        if len(value) > _ALL and all(type(item) is int for item in value):
            return _array(np.array(value), tolerance)
        if all(isinstance(item, (str, bool, int, type(None))) for item in value):
            return str(list(value))
        return {str(k): summarised(item, tolerance) for k, item in enumerate(value)}
    raise TypeError(f'{type(value).__name__} is no result that can be stored')


def difference(stored: Any, found: Any, name: str) -> str:
    """Return how a result differs from what is stored, the first difference only; '' if not."""
    if isinstance(stored, dict) and isinstance(found, dict):
        if list(stored) != list(found):
            changed = sorted(set(stored) ^ set(found)) or ['order']
            return f'{name}: {changed[0]} was stored, or is found, alone'
        for key, value in stored.items():
            text = difference(value, found[key], f'{name}.{key}')
            if text:
                return text
        return ''
    if isinstance(stored, list) and isinstance(found, list) and stored[0] == found[0] == 'float':
        return _float_difference(stored[1], stored[2], found[2], _scale(stored[2]), name)
    if isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found) == 4:
        return _array_difference(stored, found, name)
    if isinstance(stored, float) and isinstance(found, float):
        return _float_difference(DOUBLE, stored, found, abs(stored), name)
    return '' if stored == found else f'{name}: {found!r}, was {stored!r}'


def text_of(cases: Mapping[str, Any]) -> str:
    """Return the stored results of a room as JSON, one value a line."""
    lines: list[str] = []
    for case, value in cases.items():
        lines.append(f'{json.dumps(case)}: ' + _lines(value, ' '))
    return '{\n' + ',\n'.join(lines) + '\n}\n'


def _lines(value: Any, indent: str) -> str:
    text = json.dumps(value, separators=(',', ':'))
    if not isinstance(value, dict) or len(text) < 110:
        return text
    parts = [f'{indent}{json.dumps(key)}: {_lines(item, indent + " ")}'
             for key, item in value.items()]
    return '{\n' + ',\n'.join(parts) + '}'


def _digits(value: float, tolerance: float) -> Any:
    """Return a number to a tenth of its tolerance."""
    if not math.isfinite(value):
        return str(value)
    return float(f'{value:.{max(3, 1 - round(math.log10(tolerance)))}g}')


def _array(values: np.ndarray, tolerance: float) -> Any:
    shape = list(values.shape)
    if values.dtype.kind in 'biu':
        digest = hashlib.blake2b(np.ascontiguousarray(values, np.int64).tobytes(), digest_size=6)
        return {'shape': ' '.join(map(str, shape)), 'sum': int(values.sum()),
                'hash': digest.hexdigest()}
    if values.dtype.kind not in 'fc':
        return {'shape': ' '.join(map(str, shape)),
                'values': ' '.join(map(str, values.ravel().tolist()))}
    if values.dtype.kind == 'c':
        values = np.stack([values.real, values.imag])
    flat = values.astype(float).ravel()
    known = flat[np.isfinite(flat)]
    if len(known) != len(flat):
        others = np.flatnonzero(~np.isfinite(flat))
        shape += ['not finite', len(others), 'negative', int(np.isneginf(flat).sum()), 'at',
                  int(others.sum())]
    numbers: list[float] = []
    if len(known) > _ALL:
        # Multiples of the golden ratio are spread evenly and never repeat.
        weight = np.modf(np.arange(1, len(known) + 1) * 0.6180339887498949)[0] - 0.5
        root = math.sqrt(len(known))
        numbers = [float(known.min()), float(known.max()), float((weight * known).sum()) / root]
    samples = known.tolist()
    if len(known) > _ALL:
        samples = known[(np.linspace(0.4, 0.6, _SAMPLES) * len(known)).astype(int)].tolist()
    single = values.dtype.itemsize <= 4
    tolerance = tolerance or (SINGLE if single else DOUBLE)
    return [f'~{tolerance:g}', ' '.join(map(str, shape)),
            *([_digits(number, tolerance) for number in row] for row in (numbers, samples))]


def _array_difference(stored: list[Any], found: list[Any], name: str) -> str:
    tolerance, shape, numbers, samples = stored
    if shape != found[1]:
        return f'{name}: shape {found[1]}, was {shape}'
    scale = max(map(_scale, [*numbers[:2], *samples]), default=0.0)
    for which, one, other in (*zip(('least', 'greatest', 'weighted sum'), numbers,
                                   found[2]),
                              *(('a sample', *pair) for pair in zip(samples, found[3]))):
        # The rounding of a sum over the root of its number is that of one number.
        text = _float_difference(float(tolerance[1:]), one, other, max(scale, _scale(one)),
                                 f'{name}: {which}')
        if text:
            return text
    return ''


def _scale(number: Any) -> float:
    return abs(number) if isinstance(number, float) else 0.0


def _float_difference(tolerance: float, stored: Any, found: Any, scale: float, name: str) -> str:
    if isinstance(stored, str) or isinstance(found, str):
        same = stored == found
    else:
        same = abs(stored - found) <= tolerance * scale + _NOTHING
    return '' if same else f'{name}: {found!r}, was {stored!r} (tolerance {tolerance:g})'
