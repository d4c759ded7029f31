"""What is seen of the relief below the grid at low views: textures by direction, cast once.

At a low view only what faces the camera is seen of the relief, up-sun its dark side, and a pixel
is many times as long as it is wide. No mip level of slopes has that. So the brightness of the
relief that is seen is kept as textures of place for nodes of the direction to the camera, each
filtered over a pixel at that view (a bidirectional texture function: Dana et al., Reflectance and
texture of real-world surfaces, ACM Trans. Graph. 18, 1999). Places are those of the ground that is
seen, not those where rays meet a plane: between two nodes features stay where they are.

A texture is filled in along lines towards its camera: what is higher than the line of sight over
all that lies before it is seen, in proportion to how it faces the camera. Lines of any direction
wrap around in the periodic tile, each going on as another one.
"""

from __future__ import annotations

import functools
import math
import threading
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, vectorised
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world import fine_relief
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.illumination.config import ReflectanceConfig
from lunar_rover_sim.image.rendering.relief_tiles import FINER, ReliefTiles

F32 = NDArray[np.float32]

# Nodes of the view: sines of its elevation, each half of the one before, and azimuths. Texels are
# as wide as a pixel of 1 / 554 rad, 0.35 m above the ground, and half as long or less.
FIRST_SINE = 0.28
AZIMUTHS = (16, 32, 64, 64, 64)
_LINES = (2048, 2048, 1024, 512, 256)
_ALONG = (1024, 256, 128, 32, 8)
LEVELS = 3              # mip levels of each
MOST = 8.0              # brightness over the mean that codes have
_TABLE = 48             # nodes of the law along each cosine; of their roots
_BEFORE = 4             # lines begin a part of the period before they are seen: one over this
_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_OF_MOST = np.float32(1.0 / MOST)
# Where the law is read, for each byte of both.
_AT_EMISSION, _AT_INCIDENCE = (one.astype(np.float32) for one in np.meshgrid(
    *2 * [np.linspace(0.0, _TABLE - 1.0, 256)]))
_BESIDE = np.float32(0.1)   # of the mean: what is hidden is as what hides it
_HIGHER, _SPARSE = 2.0, 16  # another sun, as a factor on its tangent; one in so many lines for it


class ViewNodes(NamedTuple):
    """The textures, as compiled loops read them.

    Attributes:
        codes: Of all nodes and levels, roots of the brightness over MOST: (lines + 2, along + 2)
            of each, with the texels that follow at its edges.
        first: (nodes,) where those of a node begin.
        side: (elevations, LEVELS, 3) lines and texels along them of a level, and where it begins.
        number: (elevations,) first node of each; azimuths follow.
        azimuths: (elevations,) their numbers.
        slant: (nodes, 2) slope of the lines of a node, whether they run along y.
        spread: (nodes, LEVELS, 4) log2 of the fall of contrast for a sun twice as high, and from a
            level to the next; a and b of the mean with contrast times c > 1, which is
            1 + (c - 1)^2 (a + b (c - 1)), since what would be below 0 is black.
        unchanged: The brightness that more or less contrast leaves as it is.
    """

    codes: NDArray[np.uint8]
    first: NDArray[np.int32]
    side: NDArray[np.int32]
    number: NDArray[np.int32]
    azimuths: NDArray[np.int32]
    slant: F32
    spread: F32
    unchanged: np.float32


class ReliefViews:
    """Textures of relief under a sun, cast when a view first shows them.

    Attributes:
        nodes: For compiled loops; `ready` fills in those that are asked for.
    """

    def __init__(self, tiles: ReliefTiles, reflectance: ReflectanceConfig, tangent: float,
                 sun_radius_rad: float, *, shares: bool = False) -> None:
        """Lay both tiles over each other.

        Args:
            tangent: Of the elevation of the sun.
            shares: Textures hold the share of the sun that is left, times MOST, in place of the
                brightness.
        """
        self._recipe = tiles, reflectance, tangent, sun_radius_rad
        self._is_shares, self._lock = shares, threading.Lock()
        self._shares: ReliefViews | None = None
        self._ground = hapke.parameter_set(reflectance.ground)
        self._albedo = reflectance.albedo_scale
        heights, texel_m = _together(tiles)
        slope = fine_relief.slopes(heights, texel_m)
        left = (math.tan(math.radians(self._ground.theta_deg))**2
                - 0.25 * math.pi * 2.0 * float(np.mean(np.square(slope))))
        self._theta_deg = math.degrees(math.atan(math.sqrt(max(left, 0.0))))
        suns = [tangent, _HIGHER * tangent]
        self._suns = [_unit(tiles.heading, one) for one in suns]
        horizon = _horizon(heights, texel_m, tiles.heading, suns)
        left_of_sun = [fine_relief.disc_share((own - horizon)
                                              / (sun_radius_rad * (1.0 + own * own)))
                       for own in suns]
        lit = [_roots(share if shares else share * _incidence(slope, sun))
               for share, sun in zip(left_of_sun, self._suns)]
        over = heights / np.float32(texel_m)
        # For lines along x, and along y.
        self._maps = [[turned(one) for one in (over, *lit)] for turned in (
            lambda values: np.ascontiguousarray(values.T), np.ascontiguousarray)]
        self._locks = [threading.Lock() for _ in range(sum(AZIMUTHS))]
        self._ready = np.zeros(sum(AZIMUTHS), np.bool_)
        self.nodes = _empty_nodes(MOST if shares else 1.0)

    @property
    def shares(self) -> ReliefViews:
        """Textures of the share of the sun, of the same views."""
        with self._lock:
            if self._shares is None:
                self._shares = ReliefViews(*self._recipe, shares=True)
        return self._shares

    def ready(self, wanted: NDArray[np.bool_]) -> None:
        """Fill in the nodes that are wanted, (nodes,), and not there yet; in any thread."""
        for node in np.flatnonzero(wanted & ~self._ready):
            with self._locks[node]:
                if not self._ready[node]:
                    self._fill(int(node))
                    self._ready[node] = True

    def _fill(self, node: int) -> None:
        nodes = self.nodes
        k = int(np.searchsorted(nodes.number, node, 'right')) - 1
        azimuth = 2.0 * math.pi * (node - int(nodes.number[k])) / AZIMUTHS[k]
        sine = FIRST_SINE * 0.5**k
        flat = math.sqrt(1.0 - sine * sine)
        view = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), sine])
        along_y = bool(nodes.slant[node, 1])    # at 45 deg processors differ
        seen, *sparse = self._cast(view, along_y, _LINES[k], _ALONG[k])
        deviations = []
        for level in range(LEVELS):
            if level:
                n, m = seen.shape
                seen = seen.reshape(n // 2, 2, m // 2, 2).mean(axis=(1, 3))
            codes, deviation, twice, four_times = _coded(seen)
            at = int(nodes.first[node]) + int(nodes.side[k, level, 2])
            codes = _with_edges(cv2.transpose(codes), float(nodes.slant[node, 0]))
            nodes.codes[at:at + codes.size] = codes.ravel()
            if self._is_shares:
                continue
            deviations.append(max(deviation, 1e-3))
            b = (four_times - 1.0 - 9.0 * (twice - 1.0)) / 18.0
            nodes.spread[node, level, 2:] = twice - 1.0 - b, b
        # What is in shadow stands for the contrast of shares.
        low, high = (max(MOST - float(part.mean()) if self._is_shares else float(part.std()), 1e-3)
                     for part in sparse)
        falls = math.log2(low / high) / math.log2(_HIGHER)
        coarser = 0.0 if self._is_shares else math.log2(deviations[0] / deviations[1])
        nodes.spread[node, :, :2] = min(max(falls, 0.0), 2.0), min(max(coarser, 0.0), 1.0)

    def _cast(self, view: Array, along_y: bool, lines: int, along: int) -> tuple[F32, F32, F32]:
        """Return the brightness over its mean of what is seen from a direction, or the share.

        (along, lines) of the sun; of it and of the higher one on one in _SPARSE lines.
        """
        if self._is_shares:
            laws = np.tile(MOST * np.linspace(0.0, 1.0, 256, dtype=np.float32)[:, None]**2,
                           (2, 1, 2))
        else:
            root = np.linspace(0.0, 1.0, _TABLE)**2
            laws = np.stack([cv2.remap(hapke.reflectance(
                root[:, None], np.maximum(root, 0.02)[None, :], float(view @ sun), self._ground,
                albedo=self._albedo, theta_deg=self._theta_deg).astype(np.float32),
                _AT_EMISSION, _AT_INCIDENCE, cv2.INTER_LINEAR) for sun in self._suns])
        seen = np.empty((along, lines), np.float32)
        sparse = np.empty((2, along, lines // _SPARSE), np.float32)
        _follow(*self._maps[along_y], (view[[1, 0, 2]] if along_y else view).astype(np.float32),
                laws, seen, sparse)
        if self._is_shares:
            return seen, sparse[0], sparse[1]
        one, other, higher = (part / max(float(part.mean()), 1e-9) for part in (seen, *sparse))
        return one, other, higher


@functools.lru_cache(maxsize=2)     # for the next renderer of the same scene, and the next window
def relief_views(tiles: ReliefTiles, reflectance: ReflectanceConfig, tangent: float,
                 sun_radius_rad: float) -> ReliefViews:
    """Return the textures of tiles under a sun; arguments as for `ReliefViews`."""
    return ReliefViews(tiles, reflectance, tangent, sun_radius_rad)


def _together(tiles: ReliefTiles) -> tuple[F32, float]:
    """Return (n, n) heights of both tiles, and the side of a texel, both in metres."""
    coarse, fine = tiles.coarse, tiles.fine
    side = len(fine.heights) >> FINER
    part = fine.heights.reshape(side, 1 << FINER, side, 1 << FINER).mean(axis=(1, 3))
    times = max(len(coarse.heights) // side, 1)
    heights = coarse.heights + np.tile(part, (times, times))[:len(coarse.heights),
                                                             :len(coarse.heights)]
    return np.asarray(heights, np.float32), coarse.texel_m


def _unit(heading: Array, tangent: float) -> Array:
    return np.array([*heading, tangent]) / math.hypot(1.0, tangent)


def _horizon(heights: F32, texel_m: float, heading: Array, suns: list[float]) -> F32:
    """Return (n, n) tangents of the horizon towards two suns, the second one higher."""
    # Both are among the tangents: there their horizon is exact.
    step = 0.25 * (suns[1] - suns[0])
    return fine_relief.horizon(heights, texel_m, math.atan2(heading[1], heading[0]),
                               suns[0] + step * np.arange(-4.0, 9.0))


def _incidence(slope: F32, sun: Array) -> F32:
    """Return (n, n) cosines of incidence, 0 where slopes turn away."""
    p, q = slope[..., 0], slope[..., 1]
    x, y, z = sun.astype(np.float32)
    cosine = (z - x * p - y * q) / np.sqrt(p * p + q * q + np.float32(1.0))
    return np.asarray(np.clip(cosine, 0.0, 1.0))


def _roots(light: F32) -> NDArray[np.uint8]:
    return np.rint(255.0 * np.sqrt(light)).astype(np.uint8)


def _empty_nodes(unchanged: float) -> ViewNodes:
    side = np.zeros((len(AZIMUTHS), LEVELS, 3), np.int32)
    for k, (lines, along) in enumerate(zip(_LINES, _ALONG)):
        for level in range(LEVELS):
            side[k, level, :2] = lines >> level, along >> level
            if level:
                side[k, level, 2] = side[k, level - 1, 2] + np.prod(side[k, level - 1, :2] + 2)
    sizes = np.repeat([int(np.prod(one[-1, :2] + 2) + one[-1, 2]) for one in side], AZIMUTHS)
    first = np.cumsum([0, *sizes])
    angles = np.concatenate([np.arange(n) * (2.0 * np.pi / n) for n in AZIMUTHS])
    x, y = np.cos(angles), np.sin(angles)
    along_y = np.abs(y) > np.abs(x)
    slant = np.where(along_y, x / np.where(along_y, y, 1.0), y / np.where(along_y, 1.0, x))
    return ViewNodes(np.zeros(first[-1], np.uint8), first[:-1].astype(np.int32),
                     side,
                     np.cumsum([0, *AZIMUTHS[:-1]]).astype(np.int32),
                     np.array(AZIMUTHS, np.int32),
                     np.stack([slant, along_y], axis=-1).astype(np.float32),
                     np.zeros((sum(AZIMUTHS), LEVELS, 4), np.float32), np.float32(unchanged))


def _with_edges(codes: NDArray[np.uint8], slant: float) -> NDArray[np.uint8]:
    """Return (lines, along) codes with a texel more on each side, which wrap around."""
    wide = np.pad(codes, 1, 'wrap')
    # A line that leaves the tile goes on as another one.
    lines = len(codes)
    for column, other, turns in ((0, -1, -slant), (-1, 0, slant)):
        at = np.arange(-1, lines + 1) + turns * lines
        south = np.floor(at).astype(int)
        edge = codes[:, other].astype(float)
        low, high = edge[south % lines], edge[(south + 1) % lines]
        wide[:, column] = np.rint(low + (at - south) * (high - low))
    return wide


@compiled
def _roll(row, first, out):  # type: ignore[no-untyped-def]
    """Fill in a row that wraps around: from the texel before a place on, and two more."""
    n = len(row)
    first = (first - 1) % n
    out[:n - first] = row[first:]
    out[n - first:n] = row[:first]
    for k in range(n, len(out)):
        out[k] = out[k - n]


@vectorised
def _step(here, nearest, east, west, part, view,  # type: ignore[no-untyped-def]
          sight, facing, root):
    """Follow lines over one texel: what is seen there, and how it faces the camera.

    Args:
        here: Heights along y, as `_roll` has them; lines are `part` of a texel further on.
        nearest, east, west: Of the nearest texel, and of those beside it along the lines.
        sight: (lines,) height of the line of sight over what lies before; it goes on.
        facing: (lines,) filled in: area that is seen, over that of the ground.
        root: (lines,) of the cosine of emission.
    """
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    vx, vy, vz = view[0], view[1], view[2]
    falls = vz / abs(vx)        # of the line of sight, over a texel of x
    for k in range(len(sight)):
        height = here[k + 1] + part * (here[k + 2] - here[k + 1])
        before = sight[k] - falls
        p, q = half * (east[k + 1] - west[k + 1]), half * (nearest[k + 2] - nearest[k])
        area = vz - p * vx - q * vy
        area = area if height >= before else zero
        sight[k] = max(height, before)
        facing[k] = max(area, zero)
        root[k] = np.sqrt(min(facing[k] / np.sqrt(p * p + q * q + one), one))


@vectorised
def _add(lit, facing, root, thin, law, light):  # type: ignore[no-untyped-def]
    """Add the light of what is seen to that of lines, of one in `thin` of those."""
    steps = np.float32(law.shape[1] - 1)
    for k in range(0, len(facing), thin):
        light[k] += facing[k] * law[lit[k + 1], np.uint32(steps * root[k] + _HALF)]


@compiled
def _follow(heights, lit, higher, view, laws, seen, sparse):  # type: ignore[no-untyped-def]
    """Fill in the mean radiance of what is seen of relief, along lines that run towards x.

    Args:
        heights: (n, n) periodic, in texels, along y in a row.
        lit, higher: (n, n) as `_roots`, of the sun and of a higher one.
        view: Unit vector to the camera, which is more along x than along y.
        laws: (2, 256, m) reflectance by roots of cosines of incidence and emission, of both suns.
        seen: (along, lines) filled in, the mean of n / lines of them.
        sparse: (2, along, fewer lines) filled in: of both suns, on the first lines of groups.
    """
    n, zero = len(heights), np.float32(0.0)
    along, lines = seen.shape
    long, before, mask = n // along, n // _BEFORE, n - 1
    thin = n // sparse.shape[2]
    slant, from_east = np.float64(view[1]) / np.float64(view[0]), view[0] > zero
    here, east, west = (np.empty(n + 3, np.float32), np.empty(n + 3, np.float32),
                        np.empty(n + 3, np.float32))
    share, other = np.empty(n + 3, np.uint8), np.empty(n + 3, np.uint8)
    sight, facing, root = (np.full(n, np.float32(-1e9)), np.empty(n, np.float32),
                           np.empty(n, np.float32))
    light, faces = np.zeros(n, np.float32), np.zeros(n, np.float32)
    of_higher = np.zeros(n, np.float32)
    areas = np.empty((along, lines), np.float32)
    sparse_areas = np.empty(sparse.shape[1:], np.float32)
    for step in range(-before, n):
        x = n - 1 - step if from_east else step
        i = x & mask
        y = slant * x
        row = int(np.floor(y))
        part = np.float32(y - row)
        nearest = 1 if part >= _HALF else 0
        _roll(heights[i], row, here)
        _roll(heights[(i + 1) & mask], row, east)
        _roll(heights[(i - 1) & mask], row, west)
        _step(here, here[nearest:], east[nearest:], west[nearest:], part, view, sight, facing,
              root)
        if step < 0:
            continue
        _roll(lit[i], row, share)
        _roll(higher[i], row, other)
        _add(share[nearest:], facing, root, 1, laws[0], light)
        _add(other[nearest:], facing, root, thin, laws[1], of_higher)
        faces += facing
        if (step + 1) % long == 0:
            u = x // long
            seen[u] = light.reshape(lines, n // lines).sum(axis=1)
            areas[u] = faces.reshape(lines, n // lines).sum(axis=1)
            sparse[0, u], sparse[1, u] = light[::thin], of_higher[::thin]
            sparse_areas[u] = faces[::thin]
            light[:], faces[:], of_higher[:] = zero, zero, zero
    _divide(seen, areas, from_east)
    for k in range(2):
        _divide(sparse[k], sparse_areas, from_east)


@vectorised
def _divide(light, areas, from_east):  # type: ignore[no-untyped-def]
    """Replace the light of what is seen, (along, lines), by its mean over that, in place.

    What is hidden looks as what hides it.
    """
    along, lines = light.shape
    beside, last = _BESIDE * areas.mean(), np.zeros(lines, np.float32)
    for k in range(2 * along):      # twice around: the first of a line is hidden by the last
        u = k % along
        u = along - 1 - u if from_east else u
        own, seen = light[u], areas[u]
        for line in range(lines):
            last[line] = ((own[line] + beside * last[line])
                          / max(seen[line] + beside, np.float32(1e-9)))
        if k >= along:      # the first time around what follows still takes the light
            own[:] = last


@vectorised
def _coded(seen):  # type: ignore[no-untyped-def]
    """Return the codes of a texture, its standard deviation, its means with contrast times 2, 4.
    """
    codes, zero = np.empty(seen.shape, np.uint8), np.float32(0.0)
    squares = of_two = of_four = 0.0
    for row in range(len(seen)):
        values, out = seen[row], codes[row]
        square = two = four = zero
        for k in range(len(values)):
            off = values[k] - _ONE
            square += off * off
            two += max(np.float32(2.0) * off + _ONE, zero)
            four += max(np.float32(4.0) * off + _ONE, zero)
            out[k] = np.uint8(np.float32(255.0) * np.sqrt(min(values[k] * _OF_MOST, _ONE)) + _HALF)
        squares += float(square)
        of_two += float(two)
        of_four += float(four)
    return codes, math.sqrt(squares / seen.size), of_two / seen.size, of_four / seen.size
