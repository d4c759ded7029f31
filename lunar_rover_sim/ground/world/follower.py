"""The window of a site that goes on with a rover."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import Site, Windows

# Offsets of the rover from the middle of its window, in steps of the site: from the first on the
# next window is made ahead; at the second, or a little before, the rover enters it.
_AHEAD, _CHANGE = 0.4, 0.76
_FAR_M = 1e9


class Follower:
    """Says in which window of a site a rover is, and has the next one made ahead in a thread.

    Attributes:
        site: The site.
        world: The present window.
    """

    def __init__(self, world: World, site: Windows | None = None) -> None:
        """Begin in a window.

        Args:
            site: By default the one that the world is a window of.
        """
        self._given = site
        self._pool = ThreadPoolExecutor(1)
        self.enter(world)

    def enter(self, world: World) -> None:
        """Go on in a window that is chosen by hand."""
        self.site: Windows = Site.of(world) if self._given is None else self._given
        self.world = world
        self._coming: tuple[tuple[float, float], Future[World]] | None = None

    def go_to(self, middle_m: tuple[float, float]) -> World:
        """Return a window of the site, which is the present one from now on.

        Raises:
            WorldError: If it cannot be made.
        """
        if middle_m != self.world.ground.middle_m:
            self.world = self.window(middle_m)
        return self.world

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(cancel_futures=True)

    @property
    def bounds_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Least and greatest x, least and greatest y of the fine ground of the site [m]."""
        half = self.world.ground.half_extent_m
        low, high = (self.site.middle((far, far), self.world.ground.middle_m)
                     for far in (-_FAR_M, _FAR_M))
        return (low[0] - half, high[0] + half), (low[1] - half, high[1] + half)

    @property
    def end(self) -> str:
        """Where the site ends, in words."""
        bounds = self.bounds_m
        if (*bounds[0], *bounds[1]) == self.world.ground.box_m:
            return f'the ground ends at {end_of(self.world.ground)}'
        (west, east), (south, north) = bounds
        return f'the site ends at x = {west:g} and {east:g} m, y = {south:g} and {north:g} m'

    def holds(self, x_m: float, y_m: float) -> bool:
        """Return whether a place is on the fine ground of the site."""
        return all(low <= value <= high for value, (low, high) in zip((x_m, y_m), self.bounds_m))

    def at(self, x_m: float, y_m: float) -> World:
        """Return the window for a rover at a place, which is the present one from now on.

        Raises:
            WorldError: If it cannot be made.
        """
        here = self.world.ground.middle_m
        if max(abs(x_m - here[0]), abs(y_m - here[1])) < _AHEAD * self.site.step_m:
            return self.world
        middle = self.site.middle((x_m, y_m), here)
        if middle == here:
            self.look_ahead(x_m, y_m)
        return self.go_to(middle)

    def window(self, middle_m: tuple[float, float]) -> World:
        """Return a window, made ahead or now.

        Raises:
            WorldError: If it cannot be made.
        """
        coming, self._coming = self._coming, None
        return (coming[1].result() if coming is not None and coming[0] == middle_m
                else self.site.window(middle_m))

    def look_ahead(self, x_m: float, y_m: float) -> None:
        """Begin to make the next window where a rover at a place nears it."""
        here, site = self.world.ground.middle_m, self.site
        dx, dy = x_m - here[0], y_m - here[1]
        away = max(abs(dx), abs(dy))
        if away < _AHEAD * site.step_m:
            return
        # Where it changes if the rover goes on, away from the middle.
        ratio = max(_CHANGE * site.step_m / away, 1.0)
        ahead = site.middle((here[0] + ratio * dx, here[1] + ratio * dy), here)
        if ahead != here and (self._coming is None or self._coming[0] != ahead):
            self._coming = ahead, self._pool.submit(site.window, ahead)

    @property
    def next(self) -> World | None:
        """The window that will probably be the next one, once it is there."""
        if self._coming is None or not self._coming[1].done() or self._coming[1].exception():
            return None
        return self._coming[1].result()


def end_of(ground: HeightGrid) -> str:
    """Return where a ground ends, in words."""
    x, y = ground.middle_m
    around = f' around x = {x:g} m, y = {y:g} m' if (x, y) != (0.0, 0.0) else ''
    return f'{ground.half_extent_m:.2f} m{around}'
