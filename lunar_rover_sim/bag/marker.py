"""The mark of a bag that is not finished: `incomplete.yaml` beside its data.

It is there from the first moment of a recording until its clean end, and says why the recording
ended where it did not end cleanly.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import yaml

MARKER_NAME = 'incomplete.yaml'
METADATA_NAME = 'metadata.yaml'
UNFINISHED = 'the recording was not finished'

_SIZE = 512  # written whole at once, so that a reason fits in later without needing disk space


def mark(bag: Path, reason: str = UNFINISHED) -> None:
    """Mark the bag folder as incomplete; a reason is cut to one line of 400 characters."""
    line = ' '.join(reason.split())[:400]
    text = '# This bag has no clean end. Mend it with: lunar_rover_sim bag recover\n'
    text += f'reason: {yaml.safe_dump(line, width=1000, default_style=chr(34)).strip()}\n'
    path = bag / MARKER_NAME
    with path.open('r+b' if path.exists() else 'wb') as file:
        file.write(text.encode('ascii', 'replace').ljust(_SIZE)[:_SIZE - 1] + b'\n')


def unmark(bag: Path) -> None:
    """Take the mark away."""
    with suppress(FileNotFoundError):
        (bag / MARKER_NAME).unlink()


def why_incomplete(bag: Path) -> str | None:
    """Return why the bag folder is incomplete, or None where it is complete."""
    path = bag / MARKER_NAME
    if path.is_file():
        with suppress(OSError, yaml.YAMLError, AttributeError):
            reason = yaml.safe_load(path.read_text('utf-8')).get('reason')
            if isinstance(reason, str):
                return reason
        return UNFINISHED
    if not (bag / METADATA_NAME).is_file():
        return f'{METADATA_NAME} is missing'
    return None
