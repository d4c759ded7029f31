"""Arrays that follow from a recipe and take long to compute, kept beside the cache of worlds."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import hashlib
import json
import logging
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.base.files.arrays import read_archive
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.ground.world.cache import cache_folder, used_longest_ago

logger = logging.getLogger(__name__)

_MAX_BYTES = 1 << 30
_MOST_FILES = 64            # of a kind; those that were used longest ago go


def kept(name: str, recipe: Any, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
    """Return what `make` returns, from the file that an earlier call with this recipe left.

    Args:
        name: Of the kind of array.
        recipe: All that the array follows from, as JSON can write it, with a number that rises
            when the computation changes. A damaged file is written again; one that cannot be
            written is logged and left out.
    """
    text = json.dumps([name, recipe], sort_keys=True)
    key = hashlib.blake2b(text.encode(), digest_size=12).hexdigest()
    path = cache_folder().parent / 'arrays' / f'{name}_{key}.npz'
    try:
        array = read_archive(path, WorldError, _MAX_BYTES)['array']     # checks the sums of zip
        array.setflags(write=True)
        with contextlib.suppress(OSError):
            os.utime(path)
        return array
    except (WorldError, KeyError) as error:
        if path.exists():
            logger.warning('%s: %s; computing it again', path, error)
    array = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, lambda file: np.savez(file, array=array))
        for old in used_longest_ago(path.parent.glob(f'{name}_{24 * "?"}.npz'), _MOST_FILES):
            old.unlink(missing_ok=True)
    except OSError as error:
        logger.warning('%s is not kept: %s', path, error)
    return array
