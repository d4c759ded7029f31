"""The mark of a bag that is not finished: `incomplete.yaml` beside its data.

It is there from the first moment of a recording until its clean end, and says why the recording
ended where it did not end cleanly. While a recording runs, its process holds a lock on the mark.
"""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
from typing import BinaryIO

from mcap.writer import MCAP0_MAGIC as MAGIC
import yaml

from lunar_rover_sim.base.errors import one_line
from lunar_rover_sim.base.files.paths import lock as lock_file

MARKER_NAME = 'incomplete.yaml'
METADATA_NAME = 'metadata.yaml'
UNFINISHED = 'the recording was not finished'
_EARLY = 'the recording ended at '

# The mark is written at its full size at once: a reason fits in later, also on a full disk.
_SIZE = 512


def mark(bag: Path, reason: str = UNFINISHED) -> None:
    """Mark the bag folder as incomplete; a reason is cut to one line of 400 characters."""
    line = one_line(reason)[:400]
    text = '# This bag has no clean end. Make it readable with: lunar_rover_sim bag recover\n'
    text += f'reason: {yaml.safe_dump(line, width=1000, default_style=chr(34)).strip()}\n'
    path = bag / MARKER_NAME
    with path.open('r+b' if path.exists() else 'wb') as file:
        file.write(text.encode('ascii', 'replace').ljust(_SIZE)[:_SIZE - 1] + b'\n')


def mark_failed(bag: Path, reason: str) -> None:
    """Mark a bag whose run failed, also where its recorder could finish it.

    A reason that has been written before stays, unless it is only that the recording is short.
    """
    if bag.is_dir():
        known = why_incomplete(bag)
        if known in (None, UNFINISHED) or str(known).startswith(_EARLY):
            mark(bag, reason)


def why_short(end_ns: int, duration_s: float, tolerance_s: float) -> str:
    """Return why a recording is incomplete that should have lasted longer; '' if it is not.

    Args:
        end_ns: Simulated time at which it ended [ns].
        duration_s: Simulated time of the run [s]; 0 for no end.
        tolerance_s: Time before the end that may be without messages [s].
    """
    if not duration_s > 0.0 or end_ns * 1e-9 >= duration_s - tolerance_s:
        return ''
    return f'{_EARLY}{end_ns * 1e-9:.3f} s of {duration_s:g} s'


def lock(bag: Path) -> BinaryIO:
    """Lock the mark of a bag for as long as the returned file is open and its process lives.

    Raises:
        BlockingIOError: Where another process records or recovers the bag.
    """
    return os.fdopen(lock_file(bag / MARKER_NAME, mode=None), 'rb')


def unmark(bag: Path) -> None:
    """Take the mark away."""
    with suppress(FileNotFoundError):
        (bag / MARKER_NAME).unlink()


def why_incomplete(bag: Path) -> str | None:
    """Return why the bag folder is incomplete, or None where it is complete."""
    path = bag / MARKER_NAME
    if path.is_file():
        with suppress(OSError, yaml.YAMLError, AttributeError, ValueError, RecursionError):
            with path.open('rb') as file:
                reason = yaml.safe_load(file.read(2 * _SIZE).decode('utf-8')).get('reason')
            if isinstance(reason, str):
                return reason
        return UNFINISHED
    if not (bag / METADATA_NAME).is_file():
        return f'{METADATA_NAME} is missing'
    return None


def has_end(path: Path) -> bool:
    """Return whether an MCAP file ends as a finished one does; False if it cannot be read."""
    with suppress(OSError), path.open('rb') as file:
        size = file.seek(0, 2)
        file.seek(max(size - len(MAGIC), 0))
        return size >= 2 * len(MAGIC) and file.read() == MAGIC
    return False


def has_beginning(path: Path) -> bool:
    """Return whether a file begins as an MCAP file does; False if it cannot be read."""
    with suppress(OSError), path.open('rb') as file:
        return file.read(len(MAGIC)) == MAGIC
    return False
