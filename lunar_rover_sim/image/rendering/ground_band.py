"""A band of rows of an image of the ground: its light, its colour and its truth, loop by loop.

Pixels lie in chunks of 128: 64 columns of two rows, so that the neighbours of each one of a block
of 2 x 2 are at hand. Loops over a chunk are compiled to vector instructions.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import vectorised
from lunar_rover_sim.image.illumination.hapke import fill_reflectance
from lunar_rover_sim.image.rendering.crater_map import CraterLists
from lunar_rover_sim.image.rendering.grid_rows import light_of_grid
from lunar_rover_sim.image.rendering.lamp_rows import add_lamp, lamp_on, LampLight
from lunar_rover_sim.image.rendering.lighting import LightConstants
from lunar_rover_sim.image.rendering.projection import ViewNumbers
from lunar_rover_sim.image.rendering.relief_brightness import relief_factor
from lunar_rover_sim.image.rendering.relief_map import ReliefShape
from lunar_rover_sim.image.rendering.relief_rows import relief_of
from lunar_rover_sim.image.rendering.relief_views import ReliefViews
from lunar_rover_sim.image.rendering.rover_shadow import CastShadow
from lunar_rover_sim.image.rendering.row_math import CHUNK, COLUMNS
from lunar_rover_sim.image.rendering.shade_rows import may_shade, radiance_of, rover_shadow, shade
from lunar_rover_sim.image.rendering.surface import SurfaceTexels
from lunar_rover_sim.image.rendering.tint_rows import tint_of
from lunar_rover_sim.image.rendering.track_map import add_prints, prints_of, TrackArrays
from lunar_rover_sim.image.rendering.truth_rows import light_of, shape_of
from lunar_rover_sim.image.rendering.view_rows import (factor_of_views, light_of_views, nodes_of,
                                                       seen_relief, shares_of_views)

F32 = NDArray[np.float32]

_PIXELS = 4096          # of a band, about: all of its arrays stay in the cache of a core
# Numbers of a pixel, by the loop that fills them in, which explains them; the last are alone.
_GROUPS = {'at': 'depth x y z vx vy vz',
           'grid': 'slope_x slope_y of_grid albedo below around detail level',
           'relief': 'slope_ax slope_ay slope_bx slope_by horizon_a horizon_b place_x place_y',
           'prints': 'print_x print_y print_horizon print_seen print_coarse pressed loose beside',
           'views': 'far near rank turn',
           'law': 'cos_i cos_e cos_g theta more_c lit',
           'drawn_as': 'normal_x normal_y normal_z sunlit kept',
           'lamp': 'of_beam lamp_i lamp_g',
           '': 'factor of_rover reflectance direct whole of_lamp lamp_r zero seen share upward'}


@dataclasses.dataclass(frozen=True)
class GroundSource:
    """What the ground is lit with by one source of light, the sun or the Earth.

    Attributes:
        constants, texels: Of the source and of the ground under it.
        shadow: Of the rover.
        tracks, lamp: None where there are none.
    """

    constants: LightConstants
    texels: SurfaceTexels
    tracks: TrackArrays | None
    shadow: CastShadow
    lamp: LampLight | None = None


class SeenSource:
    """A source of light, as loops over one image of the ground take it.

    Attributes:
        source: The source.
        centre, grid, factor: Of `shade_rows.shade`, constants of `grid_rows.light_of_grid`, sun of
            `relief_brightness.relief_factor`.
        towards, shadow: As `LightConstants.towards` and `CastShadow.seen_from`.
        lamp: As `LampLight.numbers`, None without one.
    """

    def __init__(self, source: GroundSource, view: ViewNumbers, relief: ReliefShape) -> None:
        constants, texels, lamp = source.constants, source.texels, source.lamp
        sun = constants.sun
        self.source, self.towards = source, constants.towards
        self.centre = np.array([*view.middle, relief.reach_m], np.float32)
        self.grid = np.array([view.pixel, sun[6], *self.centre, texels.fine_log2, texels.last,
                              *sun[:2]], np.float32)
        self.factor = np.array([*sun[:6], texels.sun_tangent], np.float32)
        self.shadow = source.shadow.seen_from(view.camera)
        self.lamp = None if lamp is None else lamp.numbers(view.camera)


@dataclasses.dataclass
class GroundImage:
    """An image of the ground alone, rows of which are filled in.

    Attributes:
        depth_m: (h, w), 0 where there is none [m].
        radiance: (h, w), None where it is not lit [W m-2 sr-1].
        relief: (h, w) factor on radiance, of the relief that is seen at low views; None without.
        of_relief: The source whose relief that is.
        tint: (h, w) as `sensor.Tint`; None without colour.
        label, crater: (h, w) uint16; None where truth is not asked for, as all that follow.
        normal: (h, w, 3) world axes.
        shadow: (h, w, 3) bytes.
    """

    depth_m: F32
    radiance: F32 | None = None
    relief: F32 | None = None
    of_relief: GroundSource | None = None
    tint: NDArray[np.uint32] | None = None
    label: NDArray[np.uint16] | None = None
    crater: NDArray[np.uint16] | None = None
    normal: F32 | None = None
    shadow: NDArray[np.uint8] | None = None


class Band:
    """Memory for a band of an image."""

    def __init__(self, width: int) -> None:
        self.rows = self.rows_of(width)
        self._n = n = self.rows // 2 * -(-width // COLUMNS) * CHUNK
        names = ' '.join(_GROUPS.values()).split()
        # A little apart: arrays at a power of two push each other out of the cache.
        memory = np.zeros((len(names), n + 16), np.float32)
        self._of: dict[str, F32] = dict(zip(names, memory))
        start = 0
        for group, own in _GROUPS.items():
            self._of[group] = memory[start:start + len(own.split())]
            start += len(own.split())
        self._lists: dict[str, list[F32]] = {}
        long = memory.shape[1]
        self._bytes = np.zeros((3, long), np.uint8)
        self._words, self._tint = np.zeros((2, long), np.uint16), np.zeros(long, np.uint32)

    @staticmethod
    def rows_of(width: int) -> int:
        """Return how many rows, an even number, make a band of an image of this width."""
        return 2 * max(_PIXELS // (2 * COLUMNS * -(-width // COLUMNS)), 1)

    def _get(self, names: str) -> list[F32]:
        if names not in self._lists:
            self._lists[names] = [self._of[name] for name in names.split()]
        return self._lists[names]

    def draw(self, image: GroundImage, row: int, view: ViewNumbers, relief: ReliefShape,
             tracks: F32, sources: list[SeenSource], lists: CraterLists | None) -> None:
        """Fill in the rows of a band from its first one.

        Args:
            tracks: (4,) least and greatest x and y of them [m].
            sources: Those that light these rows.
            lists: Of craters, where they are asked for.
        """
        place(view.numbers, image.depth_m, row, self.rows, self._of['at'])
        tracked = any(seen.source.tracks is not None for seen in sources) and self._meets(tracks)
        for number, seen in enumerate(sources):
            present = seen.source.tracks if tracked else None
            if image.radiance is not None:
                self._light(image, row, view, seen, present, relief, add=number > 0)
            if number == 0 and image.label is not None:
                self._tell(image, row, seen, present, relief, lists)

    def _meets(self, box: F32) -> bool:
        """Return whether any place of the band may lie in a box of x and y."""
        if not box[0] <= box[1]:
            return False
        x, y = (self._of[name][:self._n] for name in 'xy')
        return bool(x.max() >= box[0] and x.min() <= box[1]
                    and y.max() >= box[2] and y.min() <= box[3])

    def _light(self, image: GroundImage, row: int, view: ViewNumbers, seen: SeenSource,
               tracks: TrackArrays | None, relief: ReliefShape, *, add: bool) -> None:
        """Light a band; tracks: where it may have some; add: to what is there."""
        get, own, source = self._get, self._of, seen.source
        texels, constants, lamp = source.texels, source.constants, source.lamp
        views = texels.views
        at, grid, law, drawn_as = own['at'], own['grid'], own['law'], own['drawn_as']
        tracked, pixel = tracks is not None, np.float32(view.pixel)
        light_of_grid(at, texels.levels, texels.ground.words, texels.matter.words,
                      texels.ground.side, texels.ground.first, seen.grid, constants.smooth, grid)
        if tracks is not None:
            prints_of(at, own['level'], *tracks, True, own['prints'])
            add_prints(own['depth'], own['prints'], constants.sun, grid)
        wanted = None if views is None else self._find_views(seen, views)
        far = wanted is not None
        # The lamp and truth take slopes of all ground.
        near = own['near' if far and lamp is None and image.shadow is None else 'depth']
        relief_of(at, near, grid, texels.tile, texels.zone, texels.horizon, *texels.coarse,
                  *texels.fine, own['relief'])
        if may_shade(at, seen.towards, seen.shadow, source.shadow.bounds):
            rover_shadow(at, view.numbers, seen.towards, source.shadow.silhouette(), seen.shadow,
                         own['of_rover'])
        else:
            own['of_rover'][:] = 1.0
        relief_factor(at, own['near' if far else 'depth'], grid, seen.factor, texels.factor,
                      own['factor'])
        shade(at, near, grid, *get('relief prints'), tracked, *get('factor of_rover'),
              constants.sun, seen.centre, texels.scales, texels.least_scales, constants.trodden,
              law, drawn_as)
        if lamp is not None:
            lamp_on(at, grid, drawn_as, seen.lamp, lamp.clip, lamp.shadow, relief.shape,
                    relief.numbers, seen.centre, own['lamp'])
            fill_reflectance(*get('lamp_i cos_e lamp_g theta albedo more_c'), constants.law,
                             own['lamp_r'])
        if views is not None and wanted is not None:
            of_pixels = at, grid, *get('relief views'), pixel, seen.factor
            seen_relief(*of_pixels, *views.nodes, own['seen'])
            light_of_views(at, grid, *get('views prints'), tracked, own['of_rover'], drawn_as,
                           constants.sun, constants.theta, constants.trodden, law,
                           *get('seen upward'))
            if image.shadow is not None and not add:
                views.shares.ready(wanted)
                seen_relief(*of_pixels, *views.shares.nodes, own['share'])
                shares_of_views(grid, *get('views prints'), tracked, own['share'], drawn_as)
        fill_reflectance(*get('cos_i cos_e cos_g theta albedo more_c'), constants.law,
                         own['reflectance'])
        radiance_of(*get('reflectance lit'), grid, own['upward' if far else 'normal_z'],
                    constants.irradiance, constants.diffuse, *get('direct whole'))
        if lamp is not None:
            add_lamp(*get('lamp_r of_beam of_lamp whole'))
        if far:
            factor_of_views(*get('seen direct whole'))
            if image.relief is not None and source is image.of_relief:
                spread(self.rows, row, own['seen'], image.relief, False)
            else:
                own['whole'] *= own['seen']
        assert image.radiance is not None
        spread(self.rows, row, own['whole'], image.radiance, add)
        if image.tint is not None and not add:
            lamp_g, of_lamp = ('lamp_g', 'of_lamp') if lamp is not None else 2 * ('zero',)
            tint_of(at, *get(f'albedo cos_g {lamp_g} direct {of_lamp} whole'),
                    constants.soil_tint, constants.tint_spread, constants.tint_place,
                    constants.lamp_tint, self._tint)
            spread(self.rows, row, self._tint, image.tint, False)

    def _find_views(self, seen: SeenSource, views: ReliefViews) -> NDArray[np.bool_] | None:
        """Return which textures a band shows; those are ready then. None: no texture."""
        nodes = views.nodes
        wanted = np.zeros(len(nodes.first), np.bool_)
        found = nodes_of(*self._get('at grid'), seen.centre, nodes.azimuths, nodes.number,
                         self._of['views'], wanted)
        views.ready(wanted)
        return wanted if found else None

    def _tell(self, image: GroundImage, row: int, seen: SeenSource, tracks: TrackArrays | None,
              relief: ReliefShape, lists: CraterLists | None) -> None:
        """Fill in what is true of a band; `_light` has been called where its light is told."""
        own, words, source = self._of, self._words, seen.source
        at, normal = own['at'], own['drawn_as']
        if image.shadow is not None:
            light_of(*self._get('depth sunlit of_rover normal_x normal_y normal_z'),
                     source.constants.sun, bool(source.constants.irradiance > 0.0), *self._bytes)
            for k in range(3):
                spread(self.rows, row, self._bytes[k], image.shadow[..., k], False)
        if tracks is not None:
            prints_of(at, own['level'], *tracks, False, own['prints'])
        texels = source.texels
        none = np.zeros((0, 0, 0, 2), np.float32), np.zeros((0, 4), np.float32)
        shape_of(at, texels.levels, texels.ground.words, int(texels.ground.side[0]),
                 own['prints'], tracks is not None, relief.shape, relief.numbers, seen.centre,
                 *(none if lists is None else lists.of_shape), words[0], words[1], normal)
        told: list[tuple[NDArray[Any], NDArray[Any] | None]] = [(words[0], image.label),
                                                                (words[1], image.crater)]
        if image.normal is not None:
            told += [(normal[k], image.normal[..., k]) for k in range(3)]
        for values, out in told:
            if out is not None:
                spread(self.rows, row, values, out, False)


@vectorised
def place(view, image, row, rows, at):  # type: ignore[no-untyped-def]
    """Fill in depth and place of the pixels of a band.

    Args:
        view: As `ViewNumbers.numbers`.
        image: (h, w) depth of the ground, 0 where there is none [m].
        row, rows: First one of the band, and their number, which is even.
        at: (7, n) filled in: depth, 0 beyond the image, too; place, x and y in the world, z over
            the camera [m]; unit vector to the camera.
    """
    depth, x, y, z, vx, vy, vz = at[0], at[1], at[2], at[3], at[4], at[5], at[6]
    chunk, columns = CHUNK, COLUMNS
    h, w = image.shape
    one = np.float32(1.0)
    blocks = (w + columns - 1) // columns
    ax, ay, az = view[0], view[1], view[2]
    bx, by, bz = view[3], view[4], view[5]
    cx, cy, cz = view[6], view[7], view[8]
    ex, ey = view[9], view[10]
    steps = np.arange(columns).astype(np.float32)
    for c in range(rows // 2 * blocks):
        first = columns * (c % blocks)
        inside = min(columns, w - first)
        for k in range(2):
            r = row + 2 * (c // blocks) + k
            i = chunk * c + columns * k
            own = depth[i:i + columns]
            if r < h:
                source = image[r, first:first + inside]
                for j in range(inside):
                    own[j] = source[j]
                for j in range(inside, columns):
                    own[j] = np.float32(0.0)
            else:
                own[:] = np.float32(0.0)
            down = np.float32(r)
            fx, fy, fz = ax + cx * down, ay + cy * down, az + cz * down
            start = np.float32(first)
            ox, oy, oz = x[i:i + columns], y[i:i + columns], z[i:i + columns]
            for j in range(columns):
                ox[j] = (fx + bx * (start + steps[j])) * own[j] + ex
            for j in range(columns):
                oy[j] = (fy + by * (start + steps[j])) * own[j] + ey
            for j in range(columns):
                oz[j] = (fz + bz * (start + steps[j])) * own[j]
            ux, uy, uz = vx[i:i + columns], vy[i:i + columns], vz[i:i + columns]
            for j in range(columns):
                a, b, d = (fx + bx * (start + steps[j]), fy + by * (start + steps[j]),
                           fz + bz * (start + steps[j]))
                shrink = -one / np.sqrt(a * a + b * b + d * d)
                ux[j] = a * shrink
                uy[j] = b * shrink
                uz[j] = d * shrink


@vectorised
def spread(rows, row, values, image, add):  # type: ignore[no-untyped-def]
    """Write the (n,) values of a band into an (h, w) image, or add them to it."""
    chunk, columns = CHUNK, COLUMNS
    h, w = image.shape
    blocks = (w + columns - 1) // columns
    for c in range(rows // 2 * blocks):
        first = columns * (c % blocks)
        inside = min(columns, w - first)
        for k in range(2):
            r = row + 2 * (c // blocks) + k
            if r < h:
                source, out = values[chunk * c + columns * k:], image[r, first:first + inside]
                if add:
                    for j in range(inside):
                        out[j] += source[j]
                else:
                    for j in range(inside):
                        out[j] = source[j]
