"""Waiting for other processes: for what comes sooner or later, at any speed of the machine."""

from collections.abc import Callable
import time

# For what never comes. Not how long anything takes: a machine may have a quarter of the speed, and
# eight such tests at a time.
LIMIT_S = 240.0


def wait_until(condition: Callable[[], object], what: str = 'nothing came',
               meanwhile: Callable[[], object] = lambda: None, pause_s: float = 0.02) -> None:
    """Return when the condition holds; call `meanwhile` in between; else fail with `what`."""
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, what
        meanwhile()
        time.sleep(pause_s)
