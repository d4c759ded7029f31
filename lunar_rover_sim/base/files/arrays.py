"""Arrays in files of NumPy. Files are untrusted: nothing is unpickled, sizes are bounded."""

from __future__ import annotations

import io
from pathlib import Path
import threading

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import LunarRoverSimError, one_line
from lunar_rover_sim.base.files.paths import check_regular

# NumPy parses the headers of files by `ast`, which fails now and then in Python 3.11 where two
# threads do so at once (CPython's issue 106905).
_HEADERS = threading.Lock()


def npy_bytes(array: NDArray) -> bytes:
    """Return an array as a .npy file.

    To a file `np.save` and `tofile` write in C: they do not say that a disk is full, and lose the
    last block in silence.
    """
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return stream.getvalue()


def map_array(path: Path, error: type[LunarRoverSimError]) -> NDArray:
    """Return the array of a .npy file, mapped and read-only; raise `error` if there is none."""
    check_regular(path, error)
    try:
        with _HEADERS:
            return np.lib.format.open_memmap(path, mode='r')
    except Exception as reason:  # whatever NumPy makes of a damaged file
        raise error(f'{path}: {one_line(reason)}') from None


def read_archive(path: Path, error: type[LunarRoverSimError],
                 most_bytes: int) -> dict[str, NDArray]:
    """Return the arrays of a .npz file, read-only, by name.

    Args:
        most_bytes: Of one array.
        error: Class that is raised if the file is damaged or an array is larger.
    """
    check_regular(path, error)
    try:
        with _HEADERS, np.load(path, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise error(f'{path}: not an npz archive')
            for info in archive.zip.infolist():  # type: ignore[union-attr]
                if info.file_size > most_bytes:
                    raise error(f'{path}: {info.filename}: larger than {most_bytes} bytes')
            arrays = {name: archive[name] for name in archive.files}
    except error:
        raise
    except Exception as reason:  # whatever NumPy and zipfile make of a damaged file
        raise error(f'{path}: {one_line(reason)}') from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise error(f'{path}: {name}: not an array')
        array.setflags(write=False)
    return arrays
