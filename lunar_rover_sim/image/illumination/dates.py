"""Dates as users write them."""

from __future__ import annotations

import datetime

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import brief, ConfigError

# UTC has had its present form since 1972; the series of the Earth's orbit ends with 2099.
FIRST = np.datetime64('1972-01-01T00:00:00', 'us')
LAST = np.datetime64('2100-01-01T00:00:00', 'us')
VALID = '1972-01-01 to 2100-01-01 [UTC]'


def parse_date(name: str, text: str) -> np.datetime64:
    """Return the date in UTC that a text in ISO 8601 states, `2026-11-22T06:00:00Z`.

    Without a zone it is UTC.

    Raises:
        ConfigError: If the text is no date or the date is out of range; it calls the parameter
            `name`.
    """
    try:
        date = datetime.datetime.fromisoformat(
            text[:-1] + '+00:00' if text.endswith(('Z', 'z')) else text)
        if date.tzinfo is not None:
            date = date.astimezone(datetime.timezone.utc).replace(tzinfo=None)
    except (ValueError, OverflowError):
        raise ConfigError(f'{name}: {brief(text)} is not a date; valid is ISO 8601 in UTC, for '
                          'example 2026-11-22T06:00:00Z') from None
    utc = np.datetime64(date, 'us')
    check_dates(name, np.asarray(utc))
    return utc


def check_dates(name: str, dates: NDArray[np.datetime64]) -> NDArray[np.datetime64]:
    """Return (...) dates; raise ConfigError if one is outside what the series cover."""
    for date in (dates.min(), dates.max()):
        if not FIRST <= date <= LAST:
            raise ConfigError(f'{name}: {shown(date)} is not valid; valid is {VALID}')
    return dates


def shown(date: np.datetime64) -> str:
    """Return a date in ISO 8601, to the second."""
    return f'{np.datetime_as_string(date, unit="s")}Z'
