"""Output that C libraries print past Python."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import logging
import os
import sys
import tempfile


@contextmanager
def stderr_to_log(logger: logging.Logger) -> Iterator[None]:
    """Log at level INFO what is written to the standard error output of this process meanwhile.

    Where GDAL calls libgeotiff and that calls PROJ, or a text of GDAL is not UTF-8, messages go
    past all handlers, though rasterio raises an error for what matters. Other threads are heard,
    too: for calls that are short.
    """
    sys.stderr.flush()
    try:
        before = os.dup(2)
    except OSError:     # the process was started without
        yield
        return
    with tempfile.TemporaryFile() as printed:
        os.dup2(printed.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(before, 2)
            os.close(before)
            printed.seek(0)
            for line in printed.read().decode(errors='replace').splitlines():
                logger.info('%s', line)
