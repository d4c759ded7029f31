"""Leaving the graph within a time limit."""

from __future__ import annotations

import signal

_LIMIT_S = 10


def bound_leaving() -> None:
    """End this process by SIGALRM if it has not ended in 10 s.

    Call it before the last participant leaves, when nothing else is left to do. Fast DDS 2.14 may
    lock up where the others of a graph leave at the same time (one of 186 killed runs):
    `DomainParticipant::set_listener` waits, at full load, for a callback that waits for its lock.
    No Python code runs meanwhile.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(_LIMIT_S)
