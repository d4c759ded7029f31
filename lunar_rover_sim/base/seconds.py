"""Time in whole nanoseconds, to and from seconds as text."""

from __future__ import annotations

NS_PER_S = 1_000_000_000
# Of exported sequences: 2024-01-01T00:00:00 UTC, when simulated time is 0. With a real date all
# stamps have 19 digits, as those of real sequences.
EPOCH_NS = 1_704_067_200 * NS_PER_S


def is_divisor(rate_hz: float, of_hz: float) -> bool:
    """Return whether a period at rate_hz is a whole number of those at of_hz.

    Their remainder would not tell: 0.1 is a little more than a tenth.
    """
    return float(of_hz / rate_hz).is_integer()


def in_seconds(time_ns: int) -> str:
    """Return integer ns as seconds with nine decimals, exactly."""
    sign = '-' if time_ns < 0 else ''
    return f'{sign}{abs(time_ns) // NS_PER_S}.{abs(time_ns) % NS_PER_S:09d}'


def sortable_ns(time_ns: int) -> str:
    """Return integer ns >= 0 with 19 digits, so that the order of names is that of time."""
    return f'{time_ns:019d}'


def sortable_seconds(time_ns: int) -> str:
    """Return integer ns >= 0 as seconds with ten digits before the point and nine after it."""
    return f'{time_ns // NS_PER_S:010d}.{time_ns % NS_PER_S:09d}'


def from_seconds(text: str) -> int:
    """Return the integer ns of seconds as text; decimals beyond the ninth are cut off.

    Raises:
        ValueError: If the text is no number.
        OverflowError: If it is infinite.
    """
    whole, _, part = text.partition('.')
    digits = whole.lstrip('+-')
    if (digits or part) and (digits + part).isdigit():
        ns = int(digits or '0') * NS_PER_S + int(part[:9].ljust(9, '0') or '0')
        return -ns if text.startswith('-') else ns
    return round(float(text) * NS_PER_S)
