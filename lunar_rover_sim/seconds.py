"""Time in whole nanoseconds, to and from seconds as text."""

from __future__ import annotations

NS_PER_S = 1_000_000_000


def in_seconds(time_ns: int) -> str:
    """Return integer ns as seconds with nine decimals, exactly."""
    sign = '-' if time_ns < 0 else ''
    return f'{sign}{abs(time_ns) // NS_PER_S}.{abs(time_ns) % NS_PER_S:09d}'


def from_seconds(text: str) -> int:
    """Return the integer ns of seconds as text; decimals beyond the ninth are cut off.

    Raises ValueError if the text is no number, OverflowError if it is infinite.
    """
    whole, _, part = text.partition('.')
    digits = whole.lstrip('+-')
    if (digits or part) and (digits + part).isdigit():
        ns = int(digits or '0') * NS_PER_S + int(part[:9].ljust(9, '0') or '0')
        return -ns if text.startswith('-') else ns
    return round(float(text) * NS_PER_S)
