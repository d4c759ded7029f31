"""A site: ground of one recipe and seed, everywhere within some kilometres, in windows."""

from __future__ import annotations

import collections
from collections.abc import Sequence
import logging
import math
import pathlib
import threading
from typing import Protocol, TYPE_CHECKING

import numpy as np

from lunar_rover_sim.base.errors import WorldError
from lunar_rover_sim.ground.world import cache
from lunar_rover_sim.ground.world.config import LEVEL_RATIO, PROCEDURAL, WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.world_folder import content_hash, load_world, RECIPE

if TYPE_CHECKING:
    from lunar_rover_sim.ground.world.build import Builder

logger = logging.getLogger(__name__)

Middle = tuple[float, float]

STEP_M = 12.8           # of the middles of windows, for cells that divide it
_MOST_LOADED = 4        # windows in memory; their arrays are mapped
LEAVE = 0.75            # steps from the middle of a window at which the next one is taken
_ROOM_M = 3.0           # around the rover, which a window must hold where it is left
_AROUND_PIXELS = 4.0    # of a source around a window, which must have heights


class Windows(Protocol):
    """The windows of a site, whose middles are multiples of `step_m` in x and in y.

    All functions may be called from any thread.

    Attributes:
        step_m: Distance between the middles of neighbouring windows [m].
        half_extent_m: Where the last window ends: places with |x| and |y| below it lie on the
            site.
        hole_margin_m: Nearer to a hole of the ground than this, in x or y, a rover may come into a
            window that holds it, which cannot be made.
    """

    step_m: float
    half_extent_m: float
    hole_margin_m: float

    def middle(self, xy_m: Sequence[float], now_m: Middle | None = None) -> Middle:
        """Return the middle of the window for a rover at a place [m].

        Args:
            xy_m: (2,) of the rover.
            now_m: Middle of its present window, which stays until the rover is three quarters of a
                step from it, in x or in y: a rover that turns back and forth changes nothing.
        """

    def window(self, middle_m: Middle) -> World:
        """Return a window, which is made if it is not there.

        Args:
            middle_m: As `middle` has it.

        Raises:
            WorldError: If it is not on the site, lacks heights, or cannot be built or kept.
        """

    def close(self) -> None:
        """Release what builds windows."""


class OneWindow:
    """A world that is never left: its own only window."""

    step_m = STEP_M
    hole_margin_m = 0.0

    def __init__(self, world: World) -> None:
        self._world, self.half_extent_m = world, world.ground.half_extent_m

    def middle(self, xy_m: Sequence[float], now_m: Middle | None = None) -> Middle:
        """Return the middle of the world."""
        return self._world.ground.middle_m

    def window(self, middle_m: Middle) -> World:
        """Return the world; raise WorldError for another place."""
        if tuple(middle_m) != self._world.ground.middle_m:
            raise WorldError('(%g, %g) is not the middle of a window; ' % tuple(middle_m)
                             + 'valid are (%g, %g)' % self._world.ground.middle_m)
        return self._world

    def close(self) -> None:
        """Do nothing."""


class Site:
    """Ground of one recipe and seed, everywhere within `world.site_km`; windows are worlds.

    Windows are built when they are first asked for, and kept in the cache on disk. The ground of
    two windows is the same, bit by bit, where they overlap. See `Windows`.
    """

    def __init__(self, config: WorldConfig, seed: int = 0) -> None:
        """Find out how far the site reaches.

        Args:
            seed: As for `build_world`.

        Raises:
            ConfigError: If the seed is not valid.
            WorldError: If the source cannot be read, or does not hold the first window.
        """
        self.config = config.with_seed(seed)
        cell = LEVEL_RATIO * config.cell_m
        self.step_m = max(round(STEP_M / cell), 1) * cell
        self._builder: Builder | None = None
        self._busy = threading.Lock()
        self._loaded: collections.OrderedDict[Middle, World] = collections.OrderedDict()
        half, room = 0.5 * config.size_m, 500.0 * config.site_km
        self.hole_margin_m = 0.0
        if config.source != PROCEDURAL:
            source = self._opened().source
            assert source is not None
            self.hole_margin_m = half + self.step_m + _AROUND_PIXELS * source.pixel_m
            # Half of the outermost pixels is extrapolated.
            holds = min(map(abs, source.area_m)) - source.pixel_m
            if holds < room:
                logger.info('world.site_km: %g; %s holds %.3g m on each side of the origin, and '
                            'the site ends there', config.site_km, config.path, holds)
                room = holds
        self._most = max(math.floor((room - half) / self.step_m + 1e-9), 0)
        self.half_extent_m = half + self._most * self.step_m

    @classmethod
    def of(cls, world: World) -> Site | OneWindow:
        """Return the site that a world is a window of.

        A world that was made by hand, that was changed, or that another recipe made is its own
        only window, and so is one that is too small to hold what is around a rover where windows
        change.
        """
        if (world.hash and world.report.get('recipe') == RECIPE and world.config.seed >= 0
                and content_hash(world) == world.hash):
            try:
                site = cls(world.config)
                if world.ground.half_extent_m >= LEAVE * site.step_m + _ROOM_M:
                    site._loaded[world.ground.middle_m] = world
                    return site
                site.close()
            except WorldError as error:
                logger.info('%s; the world is its own only window', error)
        return OneWindow(world)

    def middle(self, xy_m: Sequence[float], now_m: Middle | None = None) -> Middle:
        """See `Windows`."""
        xy = np.asarray(xy_m, float)
        if now_m is not None and np.abs(xy - now_m).max() < LEAVE * self.step_m:
            return float(now_m[0]), float(now_m[1])
        number = np.clip(np.rint(xy / self.step_m), -self._most, self._most)
        x, y = (number * self.step_m + 0.0).tolist()
        return x, y

    def window(self, middle_m: Middle) -> World:
        """See `Windows`."""
        middle_m = self._checked(middle_m)
        known = self._loaded.get(middle_m)
        if known is not None:
            return known
        with self._busy:
            if middle_m not in self._loaded:
                try:
                    world = load_world(self._made(middle_m), verify=False)
                except WorldError:      # another process has dropped it meanwhile
                    world = load_world(self._made(middle_m), verify=False)
                self._loaded[middle_m] = world
                if len(self._loaded) > _MOST_LOADED:
                    self._loaded.popitem(last=False)
            return self._loaded[middle_m]

    def folder(self, middle_m: Middle) -> pathlib.Path:
        """Return the folder of a window in the cache, whose content is verified; it is built if it
        is not there.

        Those that were used last stay there, see `cache.window_folder`.

        Raises:
            WorldError: As for `window`.
        """
        with self._busy:
            return self._made(self._checked(middle_m))

    def close(self) -> None:
        """Release what builds windows."""
        with self._busy:
            if self._builder is not None:
                self._builder.close()
                self._builder = None

    def _made(self, middle_m: Middle) -> pathlib.Path:
        return cache.cached(self.config, middle_m=middle_m,
                            build=lambda: self._opened().window(middle_m))

    def _opened(self) -> Builder:
        if self._builder is None:
            # Its libraries take half a second to import.
            from lunar_rover_sim.ground.world.build import Builder
            self._builder = Builder(self.config)
        return self._builder

    def _checked(self, middle_m: Middle) -> Middle:
        """Return the middle of a window as `middle` has it; raise WorldError for another place."""
        x, y = float(middle_m[0]), float(middle_m[1])
        near = self.middle((x, y))
        if not max(abs(x - near[0]), abs(y - near[1])) < 1e-6:
            raise WorldError(f'({x:g}, {y:g}) is not the middle of a window; valid are multiples '
                             f'of {self.step_m:g} m within {self._most * self.step_m:g} m')
        return near
