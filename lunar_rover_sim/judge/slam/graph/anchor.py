"""The place of the graph's map on a site, by the site's maps from orbit.

One more pose of the graph is the site in the graph's map. In the beginning it is known to a
radius of doubt. What the rover has seen of the relief is compared with the map's heights every few
metres, first everywhere within the doubt, later around the estimate; where it fits, it becomes a
factor between the site and the keyframe in the middle of what was seen. Where other places are as
likely, or a wrong part of the map would fit as well, it is too early to tell. What does not fit is
counted: by geometry where the heights differ by more than their errors, or where two looks in a
row contradict each other; by covariance where it contradicts the graph. After some of these in a
row the place is not known any more, and is looked for anew.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import math

import numpy as np
from scipy.stats import chi2

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.ground.world.orbital_map import OrbitalMap
from lunar_rover_sim.judge.slam.graph.map_match import (chance, LEAST_CELLS, LEAST_SIDE,
                                                        Likelihood, Match, match)
from lunar_rover_sim.judge.slam.graph.photo import Photo
from lunar_rover_sim.judge.slam.graph.pose_graph import PoseGraph
from lunar_rover_sim.judge.slam.graph.relief import Cells, Relief

# What is known of the place: not yet; since the first fix; not any more; the heading is not known.
PLACES = LOOKING, FIXED, LOST, NOT_USED = 'looking', 'fixed', 'lost', 'not used'
_SITE = 1 << 30             # key of the first pose of the site; one more after each loss
_FIRST_M, _EVERY_M = 15.0, 5.0      # way before the first look, and between looks
_MOST_M = 80.0              # of way whose relief is compared
_MOST_CELL_M = 2.5          # side of what was seen: the way is not much wider
_STRETCH_M = 25.0           # of each look after the first fix
# A fix: largest deviation, most share of other places, and how likely a wrong area fits as well.
_SURE_M, _OTHERS, _CHANCE = 2.0, 1e-2, 0.01
_AROUND_M = 4.0             # beyond three deviations, where it looks after the first fix
_ROUGHER = 4.0              # residuals over those of the first fix, squared, that are believed
_MOST_REFUSED = 3           # in a row, before the place is lost
_HEIGHT_M = 30.0            # standard deviation of the height before the first fix
_EXACT_RAD, _LOOSE_RAD = 1e-5, 1.0
_GATE = 0.999


@dataclasses.dataclass(frozen=True)
class Doubt:
    """What is known of the start: it lies within a radius of a place, (x, y) of the site [m]."""

    place_m: tuple[float, float]
    radius_m: float

    def __post_init__(self) -> None:
        if not (all(map(math.isfinite, self.place_m)) and 1.0 <= self.radius_m <= 500.0):
            raise SlamError(f'doubt: {self.radius_m:g} m around {self.place_m} is not valid; '
                            'valid is a place and 1 to 500 [m]')


class Anchor:
    """Looks for the place of the graph's map on the site, and holds it.

    Attributes:
        fixes, looks: How often a place was found anew, and compared.
        refused, contradicted: Looks that geometry and that the covariance refused.
        losses: How often the place was lost.
        is_fixed: Whether it knows the place now.
    """

    def __init__(self, orbital: OrbitalMap, doubt: Doubt) -> None:
        """Begin without a fix.

        Raises:
            SlamError: If the map does not hold the place, or is small beside the doubt.
        """
        west, south, east, north = orbital.bounds_m
        (x, y), r = doubt.place_m, doubt.radius_m
        if not (west <= x <= east and south <= y <= north):
            raise SlamError(f'near: ({x:g}, {y:g}) m is not on the map from orbit, which reaches '
                            f'from ({west:g}, {south:g}) to ({east:g}, {north:g}) m')
        if min(east - west, north - south) < LEAST_SIDE * r:
            raise SlamError(f'doubt: {r:g} m is not valid; valid is at most '
                            f'{min(east - west, north - south) / LEAST_SIDE:.3g} [m] on a map of '
                            f'{east - west:g} x {north - south:g} m, whose other parts tell how '
                            'well a wrong place may fit')
        self._orbital, self._radius_m = orbital, r
        height = float(np.nan_to_num(orbital.height_at([x, y])))
        self._shift_m = np.array([x, y, height])        # what is believed before it looks
        self._relief, self._photo = Relief(_MOST_M), Photo.of(orbital)
        self._next_m = _FIRST_M
        self._key = _SITE
        self._seen_before: Match | None = None      # the last look without a fix
        self._in_a_row, self._scale = 0, math.inf       # mean square of the first fix's residuals
        self.fixes = self.looks = self.refused = self.contradicted = self.losses = 0
        self.is_fixed = self.is_blind = False

    @property
    def place(self) -> str:
        """What is known of the place now, one of PLACES."""
        if self.is_blind:
            return NOT_USED
        return FIXED if self.is_fixed else LOST if self.losses else LOOKING

    @property
    def words(self) -> str:
        """All of it in a line."""
        if self.is_blind:
            return 'map from orbit: not used, since neither sun nor stars told the heading'
        return (f'map from orbit: {self.looks} looks, {self.fixes} fixes, {self.refused} refused '
                f'by geometry, {self.contradicted} by covariance, lost {self.losses} times')

    def begin(self, graph: PoseGraph, knows_heading: bool, T_map_site: Array | None = None,
              covariance: Array | None = None) -> None:
        """Add the site to a graph, by the doubt or as it was known in the graph before."""
        if T_map_site is None or covariance is None:
            self.is_blind = not knows_heading
            self._loosen(graph)
            return
        graph.add(self._key, T_map_site)
        graph.prior(self._key, T_map_site, covariance)

    def told(self, graph: PoseGraph, key: int) -> tuple[Array, Array]:
        """Return T_site_base of a keyframe and its covariance (6, 6) in its axes."""
        T = inverse(graph.pose(self._key)) @ graph.pose(key)
        P = graph.relative_covariance(self._key, key)
        # The error of the map's heights that is the same everywhere.
        up = T[2, :3]
        P[3:, 3:] += self._everywhere_m2(T[:2, 3]) * np.outer(up, up)
        return T, 0.5 * (P + P.T)

    def site(self, graph: PoseGraph) -> tuple[Array, Array]:
        """Return T_map_site and its covariance (6, 6)."""
        return graph.pose(self._key), graph.covariance(self._key)

    def add(self, key: int, T_map_base: Array, points_m: Array, T_base_left: Array) -> None:
        """Take the points (n, 3) of a keyframe, in its left camera."""
        self._relief.add(key, T_map_base, points_m, T_base_left)

    def look(self, graph: PoseGraph, poses: Mapping[int, Array] | None = None) -> str:
        """Compare what was seen with the map, if it is time; return what moves the estimate.

        A factor that is added is not solved yet.
        """
        if self.is_blind or self._relief.way_m < self._next_m:
            return ''
        if self.is_fixed and self._relief.seen_m < _STRETCH_M:
            return ''
        self._next_m = self._relief.way_m + _EVERY_M
        poses = graph.poses() if poses is None else poses
        cells = self._relief.cells(poses, min(self._orbital.pixel_m, _MOST_CELL_M))
        if cells is None or len(cells) < LEAST_CELLS:
            return ''
        facets = None if self._photo is None else self._relief.facets(
            poses, min(self._photo.pixel_m, _MOST_CELL_M))
        likelihood = Likelihood(self._orbital, cells, self._photo, facets)
        self.looks += 1
        if self.is_fixed:
            return self._follow(graph, cells, likelihood)
        return self._find(graph, cells, likelihood)

    def _find(self, graph: PoseGraph, cells: Cells, likelihood: Likelihood) -> str:
        """Look everywhere within the doubt."""
        found = match(likelihood, self._shift_m[:2], self._radius_m)
        before, self._seen_before = self._seen_before, None
        if found is None:
            return ''
        if not found.fits:
            self.refused += 1
            return ''
        # One look in a hundred at a wrong map is sure; two in a row hardly ever are.
        is_sure = (found.others <= _OTHERS and found.sigma_m <= _SURE_M
                   and chance(likelihood, self._shift_m[:2], self._radius_m,
                              found) <= _CHANCE)
        if not is_sure:
            return ''
        self._seen_before = found
        if before is None:
            return ''       # not told yet
        apart = (found.shift_m - before.shift_m)[:2]
        P = (found.covariance + before.covariance)[:2, :2]
        if apart @ np.linalg.solve(P, apart) > float(chi2.ppf(_GATE, 2)):
            self.refused += 1
            return ''
        moved = math.dist(found.shift_m[:2], self._shift_of(graph)[:2])
        self._hold(graph, cells, found)
        self.is_fixed, self._in_a_row, self._scale = True, 0, found.scale
        self.fixes += 1
        return (f'its place on the map from orbit is found, {moved:.1f} m from where it was '
                f'believed, to {found.sigma_m:.1f} m')

    def _follow(self, graph: PoseGraph, cells: Cells, likelihood: Likelihood) -> str:
        """Look around the estimate."""
        T, P = self.told(graph, cells.key)
        R = T[:3, :3]
        here = R @ P[3:, 3:] @ R.T
        reach = _AROUND_M + 3.0 * math.sqrt(max(0.0, np.linalg.eigvalsh(here[:2, :2])[-1]))
        believed = self._shift_of(graph)
        found = match(likelihood, believed[:2], reach)
        self._relief.forget()
        if found is None:
            return ''
        error = (found.shift_m - believed)[:2]
        S = (found.covariance + here)[:2, :2]
        if not found.fits or found.scale > _ROUGHER * self._scale:
            self.refused += 1
        elif error @ np.linalg.solve(S, error) > float(chi2.ppf(_GATE, 2)):
            self.contradicted += 1
        else:
            # A place that is not the only one says nothing.
            if found.others < _OTHERS:
                self._in_a_row = 0
                self._hold(graph, cells, found)
            return ''
        self._in_a_row += 1
        if self._in_a_row < _MOST_REFUSED:
            return ''
        return self._lose(graph)

    def _lose(self, graph: PoseGraph) -> str:
        self._shift_m = self._shift_of(graph)
        self._key += 1
        self._loosen(graph)
        self.is_fixed, self._seen_before, self._in_a_row = False, None, 0
        self._next_m = self._relief.way_m + _FIRST_M
        self.losses += 1
        return ('lost on the map from orbit: what is seen does not fit it; the place is looked '
                f'for within {self._radius_m:g} m')

    def _loosen(self, graph: PoseGraph) -> None:
        """Add a pose of the site that is known to the doubt."""
        T = inverse(se3(np.eye(3), self._shift_m))
        # Of a disc that is as likely everywhere, half of the radius along each axis.
        sigma = np.array([*3 * [_EXACT_RAD], *2 * [0.5 * self._radius_m], _HEIGHT_M])
        graph.add(self._key, T)
        graph.prior(self._key, T, np.diag(sigma**2))

    def _hold(self, graph: PoseGraph, cells: Cells, found: Match) -> None:
        T = graph.pose(cells.key)
        R = T[:3, :3]
        covariance = _LOOSE_RAD**2 * np.eye(6)
        covariance[3:, 3:] = R.T @ found.covariance @ R
        graph.between(self._key, cells.key, se3(R, T[:3, 3] + found.shift_m), covariance)
        self._relief.forget()

    def _shift_of(self, graph: PoseGraph) -> Array:
        return np.asarray(inverse(graph.pose(self._key))[:3, 3])

    def _everywhere_m2(self, xy_m: Array) -> float:
        """Return the variance of bias and tilt of the map's heights at a place [m^2]."""
        return max(0.0, float(self._orbital.variance_m2(xy_m))
                   - self._orbital.config.height_stddev_m**2)
