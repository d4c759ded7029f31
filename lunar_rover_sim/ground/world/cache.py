"""The cache of built worlds: one folder for each recipe, built when it is first needed."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import pathlib
from typing import Any

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.ground.world.config import PROCEDURAL, WorldConfig
from lunar_rover_sim.ground.world.world_folder import FORMAT, load_world, RECIPE, save_world

logger = logging.getLogger(__name__)


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


def cache_key(config: WorldConfig, seed: int) -> str:
    """Return the name of the world in the cache.

    It depends on the parameters, the seed, the identity of the source file (path, size, time of
    change) and the version of the recipe.
    """
    config = config.with_seed(seed)
    identity: list[Any] = []
    if config.source != PROCEDURAL:
        path = pathlib.Path(config.path)
        for file in sorted(path.iterdir()) if path.is_dir() else [path]:
            with contextlib.suppress(OSError):
                stat = file.stat()
                identity.append([str(file.resolve()), stat.st_size, stat.st_mtime_ns])
    text = json.dumps([FORMAT, RECIPE, config.to_mapping(), identity], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def cached(config: WorldConfig, seed: int = 0, progress: Any = None) -> pathlib.Path:
    """Return the folder of the world, which is built if the cache lacks it.

    Two processes may build the same world at once; the first to finish puts it in place.

    Args:
        progress: As for `build_world`.

    Raises:
        ConfigError: If it cannot be built.
        WorldError: If it cannot be built.
    """
    folder = cache_folder() / cache_key(config, seed)
    if (folder / 'world.yaml').is_file():
        try:
            load_world(folder, verify=False)
            return folder
        except WorldError as error:
            logger.warning('%s; building it again', error)
            with contextlib.suppress(OSError):
                folder.rename(folder.with_name(f'.{folder.name}.damaged.{os.getpid()}'))
    # Its libraries take half a second to import: each run and each renderer would wait for them.
    from lunar_rover_sim.ground.world.build import build_world
    world = build_world(config, seed, progress)
    try:
        return save_world(world, folder)
    except WorldError as error:
        if (folder / 'world.yaml').is_file():
            return folder
        raise WorldError(f'{error}; LUNAR_ROVER_SIM_CACHE names another folder for built '
                         'worlds') from None
