"""Writing a file whole or not at all."""

from __future__ import annotations

import os
import pathlib
import tempfile

from lunar_rover_sim.errors import WorldError


def write_whole(path: str | pathlib.Path, content: bytes) -> None:
    """Write a file and put it in place when it is complete; raise WorldError if that fails."""
    path = pathlib.Path(path)
    try:
        handle, temporary = tempfile.mkstemp(prefix=f'.{path.name}.', dir=path.parent)
        try:
            with os.fdopen(handle, 'wb') as stream:
                stream.write(content)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise WorldError(f'{path}: cannot be written: {error.strerror or error}') from None
