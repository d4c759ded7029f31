"""The recipe of a world: its source, relief, craters, rocks, albedo and surroundings.

The defaults are the `baseline` world: a landing site, cratered, with few large rocks, and smoother
than the average highland. The source of each default that is a property of the Moon is cited.
"""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import check, group, param, Parameters, ParamInfo

PROCEDURAL, DEM, MESH = 'procedural', 'dem', 'mesh'

# Cells of the ground per cell of the first coarse level; the side of the ground must hold an even
# number of the latter, so that the corners of both levels meet.
LEVEL_RATIO = 8


@dataclasses.dataclass(frozen=True)
class DemConfig(Parameters):
    """The window of an elevation model, and how the file is read."""

    center_mode: str = param(
        'offset', 'meaning of `center`: metres east and north of the middle of the file; '
        'coordinates of its CRS; longitude and latitude [deg]; column and row [px]',
        choices=('offset', 'crs', 'lonlat', 'pixel'))
    center: tuple[float, ...] = param(
        (0.0, 0.0), 'of the world in the file, as `center_mode` says', length=2)
    band: int = param(1, 'raster band', low=1)
    height_scale: float = param(1.0, 'metres per unit of height; a file of 8 bits is taken as '
                                'heights only if this is not 1', unit='m')
    pixel_m: float = param(0.0, 'of a file that states none; 0: from the file', unit='m', low=0.0)
    nodata: str = param('refuse', 'pixels without data under the ground; in the surroundings they '
                        'are always filled', choices=('refuse', 'fill'))

    def validate(self) -> None:
        """Raise ConfigError if the scale makes all heights equal."""
        if self.height_scale == 0.0:
            raise ConfigError('height_scale: 0.0 is not valid; valid is any other number [m]')


@dataclasses.dataclass(frozen=True)
class MeshConfig(Parameters):
    """How a triangle mesh becomes a height field."""

    up_axis: str = param('auto', 'auto: y for GLB and glTF, else z',
                         choices=('auto', 'x', 'y', 'z'))
    scale: float = param(1.0, 'metres per unit of length', unit='m', low=0.0, open_low=True)
    center: tuple[float, ...] = param(
        (0.0, 0.0), 'of the world: metres east and north of the middle of the mesh',
        unit='m', length=2)
    resolution_m: float = param(
        0.0, 'spacing of samples of the mesh; relief and craters are added below it; 0: the cell '
        'of the world, nothing is added', unit='m', low=0.0)
    holes: str = param('refuse', 'parts of the ground without mesh', choices=('refuse', 'fill'))


@dataclasses.dataclass(frozen=True)
class ReliefConfig(Parameters):
    """Self-affine relief: RMS deviation ~ baseline^hurst (Shepard et al. 2001).

    The relief of the regolith acts at all scales. Helfenstein & Shepard (1999) measured Hurst
    exponents of 0.5 to 0.7 on undisturbed regolith in Apollo stereo close-ups; the RMS slope falls
    to a few degrees at decimetres. The relief of the terrain acts at large scales: Rosenburg et
    al. (2011) found, with LOLA, median slopes at 17 m of 7.5 deg in highlands and 2.0 deg in
    maria, with median Hurst exponents of 0.95 and 0.76. The default lies between, as at a landing
    site. Craters add their own slopes: the median at 17 m is 3.4 deg with the default, 7.6 deg, as
    in the average highland, with `far_rms_slope_deg` 6.5.
    """

    hurst: float = param(0.65, 'exponent of the regolith', low=0.05, high=0.99)
    rms_slope_deg: float = param(2.0, 'of the regolith at `baseline_m`', unit='deg',
                                 low=0.0, high=45.0)
    baseline_m: float = param(0.3, 'of `rms_slope_deg`', unit='m', low=0.0, open_low=True)
    far_hurst: float = param(0.95, 'exponent of the terrain', low=0.05, high=0.99)
    far_rms_slope_deg: float = param(2.5, 'of the terrain at `far_baseline_m`, without craters: '
                                     '2.5 is a landing site, 6.5 the average highland',
                                     unit='deg', low=0.0, high=45.0)
    far_baseline_m: float = param(17.0, 'the terrain has no wavelength below it',
                                  unit='m', low=0.0, open_low=True)
    longest_wavelength_m: float = param(1000.0, 'of the relief', unit='m', low=1.0)


@dataclasses.dataclass(frozen=True)
class CraterConfig(Parameters):
    """A population of craters in equilibrium.

    N(>D) = density 1.54 D0^-2 (D / D0)^-slope per m2 with D0 = 10 m. 1.54 D^-2 is geometric
    saturation (Gault 1970); small lunar craters are in equilibrium at a few per cent of it with
    a slope near 2 (Gault 1970; Xiao & Werner 2015; Minton et al. 2019). Fresh depth and rim
    height are those of Pike (1977) for simple craters. Diffusion degrades them (Fassett & Thomson
    2014) to the depth of the oldest crater that is still counted.
    """

    density: float = param(0.03, 'fraction of geometric saturation; 0: no craters', low=0.0,
                           high=0.5)
    slope: float = param(2.0, 'exponent of the cumulative size distribution', low=1.0, high=4.0)
    min_diameter_m: float = param(0.15, 'smallest crater', unit='m', low=0.0, open_low=True)
    max_diameter_m: float = param(200.0, 'largest crater', unit='m', low=0.0, open_low=True)
    fresh_depth: float = param(0.2, 'from rim to floor, in diameters', low=0.02, high=0.4)
    fresh_rim: float = param(0.04, 'height, in diameters', low=0.0, high=0.1)
    oldest_depth: float = param(0.03, 'in diameters', low=0.005, high=0.2)
    age_exponent: float = param(1.0, 'age = u^(1/age_exponent) of the lifetime, u uniform: 1 is '
                                'equilibrium, a larger value makes more old craters', low=0.1,
                                high=10.0)
    irregularity: float = param(0.05, 'RMS deviation of the outline from a circle, in radii',
                                low=0.0, high=0.15)


# Fragments per 100 m2 larger than y mm, K y^-b, at the landing sites of Surveyor (Shoemaker and
# Morris, in Surveyor Program Results, NASA SP-184, 1969): K and b.
SITES: dict[str, tuple[float, float]] = {
    'surveyor_1': (5.0e5, 2.11), 'surveyor_3': (3.3e6, 2.56), 'surveyor_5': (1.25e6, 2.65),
    'surveyor_6': (1.91e6, 2.51), 'surveyor_7': (7.9e5, 1.82)}
# Share of angular blocks there. A choice: those on the rim of Tycho, 0.1 Ga old, are fresh; on the
# old maria many are worn.
ANGULAR_AT = {'surveyor_1': 0.5, 'surveyor_3': 0.4, 'surveyor_5': 0.4, 'surveyor_6': 0.5,
              'surveyor_7': 0.85}


@dataclasses.dataclass(frozen=True)
class RockConfig(Parameters):
    """Rocks on the ground.

    Cumulative fractional area F(>D) = k exp(-q D), the form of Golombek & Rapp (1997), with
    q(k) = 0.5648 + 0.01258 / k as fitted to the Moon by Li & Wu (2018); Di et al. (2016) counted
    k = 0.0125 at the Chang'e-3 site. That form has few stones of 3 to 10 cm; `site` takes the
    power law that was counted at a Surveyor instead. Rocks rise above the ground by about 0.6 of
    their diameter or less (Demidov & Basilevsky 2014).
    """

    gone = {'max_number': 20000}

    site: str = param('', 'number and shapes as counted there; empty: abundance, decay_per_m and '
                      'angular', choices=('', *SITES))

    abundance: float = param(0.0125, 'k: area covered by rocks of all sizes', low=0.0, high=0.3)
    decay_per_m: float = param(0.0, 'q; 0: follows from the abundance', unit='1/m', low=0.0)
    min_diameter_m: float = param(0.03, 'smallest rock', unit='m', low=0.005, high=2.0)
    max_diameter_m: float = param(2.0, 'largest rock', unit='m', low=0.005, high=20.0)
    max_per_m2: float = param(8.0, 'on the plain; beyond it the smallest are left out',
                              unit='1/m2', low=0.0, high=100.0)
    size_classes: int = param(28, 'logarithmic', low=1, high=64)
    angular: float = param(0.55, 'share of fresh, angular blocks; others are rounded; a `site` '
                           'has its own', low=0.0, high=1.0)
    burial: float = param(0.3, 'mean share of the height below ground', low=0.02, high=0.9)
    near_craters: float = param(4.0, 'density around the rim of a fresh crater, relative to that '
                                'of the plain, minus 1', low=0.0, high=100.0)
    max_height: float = param(0.6, 'above the ground, in diameters; what would stand out more is '
                              'buried deeper', low=0.05, high=2.0)
    fillet: float = param(0.06, 'mean height of soil around rocks of five cells and more, in '
                          'diameters', low=0.0, high=0.2)
    tilt_deg: float = param(8.0, 'RMS, against the ground', unit='deg', low=0.0, high=90.0)
    albedo_variation: float = param(0.06, 'RMS among rocks', low=0.0, high=0.3)


@dataclasses.dataclass(frozen=True)
class AlbedoConfig(Parameters):
    """Variation of the albedo factor over the ground; its mean is 1.

    The mean albedo of the ground belongs to the reflectance of the rendering. Fresh craters
    excavate brighter, immature soil (e.g. Lucey et al. 2000).
    """

    variation: float = param(0.035, 'RMS of patches from decimetres to metres', low=0.0, high=0.3)
    grain: float = param(0.02, 'RMS from cell to cell', low=0.0, high=0.3)
    fresh_crater: float = param(0.10, 'brightening at the centre of a fresh crater', low=0.0,
                                high=1.0)


@dataclasses.dataclass(frozen=True)
class SurroundingsConfig(Parameters):
    """Coarse levels around the ground."""

    extent_m: float = param(1000.0, 'least distance from the origin in x and in y',
                            unit='m', low=0.0, high=20000.0)
    samples: int = param(2049, 'along a side of a coarse level', low=65, high=4097)


@dataclasses.dataclass(frozen=True)
class WorldConfig(Parameters):
    """The complete recipe of one world."""

    source: str = param(PROCEDURAL, 'of the large-scale shape', choices=(PROCEDURAL, DEM, MESH))
    path: str = param('', 'GeoTIFF, folder with dem.npy and dem.yaml, or mesh file')
    seed: int = param(-1, '-1: that of the scenario', low=-1)
    size_m: float = param(51.2, 'side of the fine ground', unit='m', low=0.0, open_low=True,
                          high=1000.0)
    cell_m: float = param(0.025, 'of the fine ground', unit='m', low=0.001, high=10.0)
    clear_radius_m: float = param(0.6, 'no rocks and no steep crater this near to the origin',
                                  unit='m', low=0.0)
    site_km: float = param(4.0, 'side of the site, all of which can be driven; measured ground '
                           'may end before', unit='km', low=0.0, high=40.0)
    dem: DemConfig = group(DemConfig)
    mesh: MeshConfig = group(MeshConfig)
    relief: ReliefConfig = group(ReliefConfig)
    craters: CraterConfig = group(CraterConfig)
    rocks: RockConfig = group(RockConfig)
    albedo: AlbedoConfig = group(AlbedoConfig)
    surroundings: SurroundingsConfig = group(SurroundingsConfig)

    def validate(self) -> None:
        """Raise ConfigError if sizes do not fit together or the source has no path."""
        step = 2 * LEVEL_RATIO
        cells = self.size_m / self.cell_m
        if abs(cells - round(cells)) > 1e-6 or round(cells) % step or not 0 < cells <= 8192:
            near = min(max(round(cells / step), 1), 8192 // step) * step * self.cell_m
            raise ConfigError(f'size_m: {self.size_m:g} is not a multiple of {step} cells of '
                              f'{self.cell_m:g} m up to 8192; the nearest is {near:g}')
        for what in (self.craters, self.rocks):
            if what.min_diameter_m > what.max_diameter_m:
                name = 'craters' if what is self.craters else 'rocks'
                raise ConfigError(f'{name}.min_diameter_m: {what.min_diameter_m:g} is not '
                                  f'valid; valid is <= max_diameter_m = {what.max_diameter_m:g} '
                                  '[m]')
        if self.craters.oldest_depth > self.craters.fresh_depth:
            raise ConfigError(f'craters.oldest_depth: {self.craters.oldest_depth:g} is not '
                              f'valid; valid is <= fresh_depth = {self.craters.fresh_depth:g}')
        if self.craters.fresh_rim >= self.craters.fresh_depth:
            raise ConfigError(f'craters.fresh_rim: {self.craters.fresh_rim:g} is not valid; '
                              f'valid is < fresh_depth = {self.craters.fresh_depth:g}')
        if self.source != PROCEDURAL and not self.path:
            raise ConfigError(f'path: empty; source {self.source} needs a file')

    def with_seed(self, seed: int) -> WorldConfig:
        """Return these parameters with `seed` where their own is -1.

        Raises:
            ConfigError: If `seed` is not a whole number >= 0.
        """
        seed = check('seed', seed, int, ParamInfo('seed of everything random', low=0))
        return self if self.seed >= 0 else dataclasses.replace(self, seed=seed)

    @property
    def samples(self) -> int:
        """Samples along a side of the ground."""
        return round(self.size_m / self.cell_m) + 1
