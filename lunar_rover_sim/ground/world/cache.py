"""The cache of built worlds: one folder for each recipe, built when it is first needed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import contextlib
import fcntl
import hashlib
import json
import logging
import os
import pathlib
import shutil
from typing import Any

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.ground.world.config import PROCEDURAL, WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import FORMAT, load_world, RECIPE, save_world

logger = logging.getLogger(__name__)

_MOST_WINDOWS = 40      # around other places than the origin; 70 MB each


def cache_folder() -> pathlib.Path:
    """Return the folder of built worlds, in $LUNAR_ROVER_SIM_CACHE or the cache of the user.

    The latter is $XDG_CACHE_HOME, by default ~/.cache.

    Raises:
        ConfigError: Neither these variables nor a home folder are there.
    """
    named = os.environ.get('LUNAR_ROVER_SIM_CACHE')
    if named:
        return pathlib.Path(named) / 'worlds'
    of_user = pathlib.Path(os.environ.get('XDG_CACHE_HOME', ''))
    if of_user.is_absolute():       # the specification says to ignore another one
        return of_user / 'lunar_rover_sim' / 'worlds'
    try:
        return pathlib.Path.home() / '.cache' / 'lunar_rover_sim' / 'worlds'
    except RuntimeError:
        raise ConfigError('there is no home folder to keep worlds in; name a folder in the '
                          'environment variable LUNAR_ROVER_SIM_CACHE') from None


def cache_key(config: WorldConfig, seed: int,
              middle_m: tuple[float, float] = (0.0, 0.0)) -> str:
    """Return the name of a window in the cache.

    It depends on the parameters, the seed, the identity of the source file (path, size, time of
    change), the version of the recipe and the middle of the window.
    """
    config = config.with_seed(seed)
    identity: list[Any] = []
    if config.source != PROCEDURAL:
        path = pathlib.Path(config.path)
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            with contextlib.suppress(OSError):
                stat = file.stat()
                identity.append([str(file.resolve()), stat.st_size, stat.st_mtime_ns])
    text = json.dumps([FORMAT, RECIPE, config.to_mapping(), identity, list(middle_m)],
                      sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def window_folder() -> pathlib.Path:
    """Return the folder of windows around other places than the origin, beside that of worlds.

    Of those the last ones that were used stay.
    """
    return cache_folder().parent / 'windows'


def cached(config: WorldConfig, seed: int = 0, progress: Any = None,
           middle_m: tuple[float, float] = (0.0, 0.0),
           build: Callable[[], World] | None = None) -> pathlib.Path:
    """Return the folder of the world, whose content is verified; it is built if it is not there.

    A damaged world is built again. One process builds a world at a time, others wait for it.

    Args:
        progress: As for `build_world`.
        middle_m: Of the window.
        build: Builds it; needed for other windows than that around the origin.

    Raises:
        ConfigError: If it cannot be built.
        WorldError: If it cannot be built.
    """
    at_origin = tuple(middle_m) == (0.0, 0.0)
    folder = ((cache_folder() if at_origin else window_folder())
              / cache_key(config, seed, middle_m))
    if _is_whole(folder):
        _used(folder)
        return folder
    with contextlib.ExitStack() as lock:
        with contextlib.suppress(OSError):      # where there are no locks, both build it
            folder.parent.mkdir(parents=True, exist_ok=True)
            _lock(folder, lock, logging.WARNING if at_origin else logging.INFO)
        if _is_whole(folder):
            return folder
        for left in folder.parent.glob(f'.{folder.name}.*.partial'):    # by one that was killed
            shutil.rmtree(left, ignore_errors=True)
        # Its libraries take half a second to import: each run and each renderer would wait.
        if build is None:
            from lunar_rover_sim.ground.world.build import build_world
            world = build_world(config, seed, progress)
        else:
            world = build()
        _remove(folder)
        if not at_origin:
            _drop_old(folder.parent)
        try:
            return save_world(world, folder)
        except WorldError as error:
            if _is_whole(folder):
                return folder
            raise WorldError(f'{error}; LUNAR_ROVER_SIM_CACHE names another folder for built '
                             'worlds') from None


def _used(folder: pathlib.Path) -> None:
    """Note the time, by which old windows are dropped."""
    with contextlib.suppress(OSError):
        os.utime(folder)


def _drop_old(parent: pathlib.Path) -> None:
    """Remove windows but those used last."""
    for folder in used_longest_ago(parent.glob('[0-9a-f]' * 24), _MOST_WINDOWS):
        _remove(folder)
        with contextlib.suppress(OSError):
            (parent / f'.{folder.name}.lock').unlink()


def used_longest_ago(paths: Iterable[pathlib.Path], most: int) -> list[pathlib.Path]:
    """Return files or folders beyond the number that is kept; another process may drop some."""
    used = []
    for path in paths:
        with contextlib.suppress(OSError):
            used.append((path.stat().st_mtime_ns, path))
    return [path for _, path in sorted(used)[:-most]]


def _is_whole(folder: pathlib.Path) -> bool:
    """Return whether a world is there and is what it was when it was built."""
    if not folder.is_symlink() and not folder.exists():
        return False
    try:
        load_world(folder)
    except WorldError as error:
        logger.warning('%s; building it again', error)
        return False
    return True


def _lock(folder: pathlib.Path, stack: contextlib.ExitStack, level: int) -> None:
    """Wait until no other process builds this world; the lock ends with the process.

    Args:
        level: Of the line that tells of the wait.
    """
    file = stack.enter_context((folder.parent / f'.{folder.name}.lock').open('w'))
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        logger.log(level, '%s: another process builds it; waiting', folder)
        fcntl.flock(file, fcntl.LOCK_EX)


def _remove(folder: pathlib.Path) -> None:
    """Remove what stands in the place of a world; who has its files open keeps them."""
    if folder.is_dir() and not folder.is_symlink():
        shutil.rmtree(folder, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            folder.unlink()
