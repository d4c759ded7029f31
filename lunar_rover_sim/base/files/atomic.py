"""Writing a file or a folder whole or not at all.

The content goes to a temporary name in the same folder and takes its place by a rename. A reader
sees the old file or the new one, never a part. `atomic_write` forces a file to the disk before, so
that this holds after a crash of the machine too. `partial_folder` is for what libraries write by
its name, and for what consists of several files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import errno
import os
from pathlib import Path
import secrets
import shutil
from typing import BinaryIO

from lunar_rover_sim.base.errors import LunarRoverSimError


def atomic_write(path: str | Path, content: str | bytes | Callable[[BinaryIO], object],
                 error: type[LunarRoverSimError] | None = None) -> None:
    """Write a file, replacing an existing one.

    Raises `error`, or OSError where none is given, if the file cannot be written, or is a folder
    or a device. What `content` raises is passed on. In each case the file is as it was, and no
    temporary file is left.

    Args:
        path: The file; its folder must exist.
        content: Text (written as UTF-8), bytes, or a function that writes to the open binary file.
        error: Class of the package that is raised in place of OSError, with the path in its
            message.
    """
    path = Path(path)
    temporary = _partial(path)
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
        raise error(_in_words(path, reason)) from None


@contextlib.contextmanager
def partial_folder(path: Path, error: type[LunarRoverSimError]) -> Iterator[Path]:
    """Make a temporary folder beside `path`, for what is renamed to `path` once it is complete.

    Folders above it are made. At the end it is removed, with what is left in it.
    Raises `error` in place of each OSError meanwhile, with `path` in its message, and names `path`
    where an `error` that comes from within names the temporary folder.
    """
    folder = _partial(path)
    try:
        folder.mkdir(parents=True)
        yield folder
    except OSError as reason:
        raise error(_in_words(path, reason)) from None
    except error as reason:
        if str(folder) not in str(reason):
            raise
        raise error(str(reason).replace(str(folder), str(path))) from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _partial(path: Path) -> Path:
    return path.with_name(f'.{path.name}.{secrets.token_hex(4)}.partial')


def _in_words(path: Path, reason: OSError) -> str:
    return f'{path}: cannot be written: {reason.strerror or reason}'


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk; raise OSError if that fails."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
