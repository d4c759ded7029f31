"""Writing a file whole or not at all.

The content goes to a temporary file in the same folder, is forced to the disk, and takes the
place of the file by a rename. A reader sees the old file or the new one, never a part, also
after a crash of the machine.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import errno
import os
from pathlib import Path
import secrets
from typing import BinaryIO

from lunar_rover_sim.errors import LunarRoverSimError


def atomic_write(path: str | Path, content: str | bytes | Callable[[BinaryIO], object],
                 error: type[LunarRoverSimError] | None = None) -> None:
    """Write a file, replacing an existing one.

    path: the file; its folder must exist.
    content: text (written as UTF-8), bytes, or a function that writes to the open binary file.
    error: class of the package that is raised in place of OSError, with the path in its message.

    Raises `error`, or OSError where none is given, if the file cannot be written, or is a folder
    or a device. What `content` raises is passed on. In each case the file is as it was, and no
    temporary file is left.
    """
    path = Path(path)
    temporary = path.with_name(f'.{path.name}.{secrets.token_hex(4)}.partial')
    try:
        if path.exists() and not path.is_file() and not path.is_dir():
            raise OSError(errno.EEXIST, 'it is not a regular file')
        with temporary.open('xb') as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except BaseException as reason:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if error is None or not isinstance(reason, OSError):
            raise
        raise error(f'{path}: cannot be written: {reason.strerror or reason}') from None


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk; raise OSError if that fails."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
