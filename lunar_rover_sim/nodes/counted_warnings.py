"""Warnings that may come a thousand times a second: told once a second, and in full at the end."""

from __future__ import annotations

import math
import time

from rclpy.impl.rcutils_logger import RcutilsLogger

_PERIOD_S = 1.0


class CountedWarnings:
    """Counts warnings by kind and logs the count with the newest one.

    The first warning of a kind is logged at once, later ones at most once a second [wall time].
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._counts: dict[str, int] = {}
        self._told_s: dict[str, float] = {}
        self._untold: dict[str, str] = {}

    def add(self, kind: str, what: str, rest: str = '') -> None:
        """Count a warning; it reads `WHAT (N so far)REST`."""
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        self._untold[kind] = f'{what} ({count} so far){rest}'
        if time.monotonic() - self._told_s.get(kind, -math.inf) >= _PERIOD_S:
            self._tell(kind)

    def tell_rest(self) -> None:
        """Log the last warning of each kind with its count, where it was held back."""
        for kind in list(self._untold):
            self._tell(kind)

    def _tell(self, kind: str) -> None:
        self._told_s[kind] = time.monotonic()
        self._logger.warning(self._untold.pop(kind))
