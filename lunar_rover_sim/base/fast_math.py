"""Logarithm, power and arc in single precision, compiled into the loops that call them."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.compiled import inlined

_ZERO, _ONE, _PI = (np.float32(x) for x in (0.0, 1.0, np.pi))
_MANTISSA, _UNIT, _BIAS = np.int32(0x7fffff), np.int32(0x3f800000), np.int32(127)
_L1, _L2, _L3, _L4, _L5, _L6 = (np.float32(x) for x in (
    1.44253477, -0.7180334, 0.45715712, -0.27733943, 0.12147073, -0.02579153))
_E1, _E2, _E3, _E4, _E5 = (np.float32(x) for x in (
    0.693151589, 0.240164372, 0.0557937297, 0.0090311809, 0.00185874787))
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7 = (np.float32(x) for x in (
    1.5707963050, -0.2145988016, 0.0889789874, -0.0501743046, 0.0308918810, -0.0170881256,
    0.0066700901, -0.0012624911))


@inlined
def log2(value):  # type: ignore[no-untyped-def]
    """Return the logarithm of a positive number; error < 3e-6."""
    bits = np.float32(value).view(np.int32)
    m = np.int32((bits & _MANTISSA) | _UNIT).view(np.float32) - _ONE
    whole = np.float32((bits >> np.int32(23)) - _BIAS)
    return whole + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))


@inlined
def exp2(value):  # type: ignore[no-untyped-def]
    """Return a power of two; its error is < 3e-6 of it."""
    whole = np.floor(value)
    m = value - whole
    part = _ONE + m * (_E1 + m * (_E2 + m * (_E3 + m * (_E4 + m * _E5))))
    return np.int32((np.int32(whole) + _BIAS) << np.int32(23)).view(np.float32) * part


@inlined
def arc_cosine(x):  # type: ignore[no-untyped-def]
    """Return the angle of a cosine (Abramowitz and Stegun, 4.4.46, error < 2e-8)."""
    a = abs(x)
    angle = np.sqrt(max(_ONE - a, _ZERO)) * (_A0 + a * (_A1 + a * (_A2 + a * (_A3 + a * (
        _A4 + a * (_A5 + a * (_A6 + a * _A7)))))))
    return _PI - angle if x < _ZERO else angle
