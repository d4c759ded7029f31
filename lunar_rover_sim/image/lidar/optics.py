"""Parameters of a LiDAR or time-of-flight camera: its optics and how it is run; two real parts."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.image.illumination.config import ReflectanceConfig

SCANNING, FLASH = 'scanning', 'flash'
MAX_POINTS = 1_000_000      # of a scan


@dataclasses.dataclass(frozen=True)
class LidarOptics(Parameters):
    """Beams in space and time, and what is known of the ranging.

    A scanning sensor turns about z, counter-clockwise from behind, and fires columns of beams one
    after the other. A flash sensor sees its whole field at once, through a lens without
    distortion.
    """

    kind: str = param(SCANNING, 'scanning turns columns of beams about z; flash sees all pixels '
                      'at once', choices=(SCANNING, FLASH))
    beams: int = param(16, 'beams of a column, or rows of pixels', low=1, high=4096)
    vertical_low_deg: float = param(-15.0, 'elevation of the lowest beam', unit='deg', low=-89.0,
                                    high=89.0)
    vertical_high_deg: float = param(15.0, 'elevation of the highest beam', unit='deg', low=-89.0,
                                     high=89.0)
    elevations_deg: tuple[float, ...] = param(
        (), 'of a scanning sensor, in the order of firing, instead of beams at even angles',
        unit='deg', low=-89.0, high=89.0)
    horizontal_deg: float = param(360.0, 'horizontal field of view; a flash sensor up to 160',
                                  unit='deg', low=0.1, high=360.0)
    columns: int = param(160, 'of pixels of a flash sensor', low=2, high=4096)
    columns_per_s: float = param(18000.0, 'of a scanning sensor', unit='1/s', low=1.0, high=1e6)
    firing_s: float = param(0.0, 'from one beam of a column to the next; 0: all at once', unit='s',
                            low=0.0, high=1.0)
    most_rate_hz: float = param(20.0, 'greatest rate', unit='Hz', low=0.1, high=1000.0)
    min_range_m: float = param(0.5, 'nearest target', unit='m', low=0.0, high=1e4)
    max_range_m: float = param(100.0, 'farthest target', unit='m', low=0.1, high=1e4)
    reference_range_m: float = param(100.0, 'range at which a target of reference_reflectance is '
                                     'detected with a probability of 90 %', unit='m', low=0.1,
                                     high=1e5)
    reference_reflectance: float = param(0.8, 'diffuse reflectance of that target, seen at right '
                                         'angles', low=0.001, high=1.0)
    divergence_mrad: float = param(1.5, 'full angle of a beam, or of a pixel, across the ground',
                                   unit='mrad', low=0.0, high=100.0)
    pulse_m: float = param(0.9, 'length of a pulse, as a range: half of duration times c',
                           unit='m', low=0.001, high=100.0)
    noise_m: float = param(0.02, 'standard deviation of the range with a strong signal', unit='m',
                           low=0.0, high=10.0)
    limit_noise_m: float = param(0.05, 'the same at the reference', unit='m', low=0.0, high=10.0)
    resolution_m: float = param(0.002, 'step of ranges; 0: none', unit='m', low=0.0, high=1.0)

    def validate(self) -> None:
        """Raise ConfigError for optics that cannot be."""
        if self.elevations_deg and self.kind == FLASH:
            raise ConfigError('elevations_deg: is not valid for a flash sensor; valid are '
                              'vertical_low_deg and vertical_high_deg')
        if self.elevations_deg and len(self.elevations_deg) != self.beams:
            raise ConfigError(f'elevations_deg: {len(self.elevations_deg)} elements given; valid '
                              f'is one for each of beams = {self.beams}')
        if self.beams > 1 and self.vertical_low_deg >= self.vertical_high_deg:
            raise ConfigError(f'vertical_low_deg: {self.vertical_low_deg:g} is not valid; valid '
                              f'is < vertical_high_deg = {self.vertical_high_deg:g}')
        if self.kind == FLASH:
            for name, value in (('horizontal_deg', self.horizontal_deg),
                                ('vertical_high_deg - vertical_low_deg',
                                 self.vertical_high_deg - self.vertical_low_deg)):
                if value > 160.0:
                    raise ConfigError(f'{name}: {value:g} is not valid for a flash sensor; valid '
                                      'is <= 160 [deg]')
            if self.beams < 2:
                raise ConfigError('beams: 1 is not valid for a flash sensor; valid is >= 2')
        elif self.firing_s * self.beams * self.columns_per_s > 1.0:
            raise ConfigError(f'firing_s: {self.firing_s:g} is not valid; {self.beams} beams at '
                              f'columns_per_s = {self.columns_per_s:g} leave '
                              f'{1.0 / (self.beams * self.columns_per_s):.3g} s')
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(f'min_range_m: {self.min_range_m:g} is not valid; valid is < '
                              f'max_range_m = {self.max_range_m:g}')
        if self.limit_noise_m < self.noise_m:
            raise ConfigError(f'limit_noise_m: {self.limit_noise_m:g} is not valid; valid is >= '
                              f'noise_m = {self.noise_m:g}')

    def elevations(self) -> np.ndarray:
        """Return the (beams,) elevations [deg] of a scanning sensor in the order of firing."""
        if self.elevations_deg:
            return np.array(self.elevations_deg)
        if self.beams == 1:
            return np.array([self.vertical_low_deg])
        return np.linspace(self.vertical_low_deg, self.vertical_high_deg, self.beams)

    def columns_at(self, rate_hz: float) -> int:
        """Return the columns of one scan."""
        if self.kind == FLASH:
            return self.columns
        # Rounding must not make one column too few of a rate that divides.
        return int(self.columns_per_s / rate_hz * self.horizontal_deg / 360.0 + 1e-6)


# Velodyne Puck VLP-16. User manual 63-9243 Rev. D: 16 beams from -15 to 15 deg, in the order of
# table 9-1; 55.296 us from column to column, 2.304 us from beam to beam (chapter 8); ranges in
# steps of 2 mm. The divergence is that of the VLS-128 of the same maker, 3.0 mrad along the
# horizontal and 1.5 along the vertical (its user manual, table F-1). Choices: 0.5 to 100 m, that
# range on 80 % reflectance, 20 Hz at most, pulses of 6 ns, both noises.
VLP16 = LidarOptics(
    kind=SCANNING, beams=16, vertical_low_deg=-15.0, vertical_high_deg=15.0,
    elevations_deg=(-15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0, -7.0, 9.0, -5.0, 11.0, -3.0,
                    13.0, -1.0, 15.0),
    horizontal_deg=360.0, columns_per_s=1.0 / 55.296e-6, firing_s=2.304e-6, most_rate_hz=20.0,
    min_range_m=0.5, max_range_m=100.0, reference_range_m=100.0, reference_reflectance=0.8,
    divergence_mrad=1.5, pulse_m=0.9, noise_m=0.02, limit_noise_m=0.05,
    resolution_m=0.002)

# ESPROS TOFcam-635, wide field: an indirect time-of-flight camera of 160 x 60 pixels over 50 x 19
# deg, 0.1 to 7.5 m on a white target (the 7.5 m are those of its modulation at 20 MHz), steps of
# 1 mm, up to 50 measurements per second, up to 100 klx of light (its installation and operation
# manual). That white means 90 %, and both noises, are choices. Its light is modulated, without
# pulses; half the wavelength of the modulation stands for their length.
TOFCAM635 = LidarOptics(
    kind=FLASH, beams=60, vertical_low_deg=-9.5, vertical_high_deg=9.5, horizontal_deg=50.0,
    columns=160, most_rate_hz=50.0, min_range_m=0.1, max_range_m=7.5, reference_range_m=7.5,
    reference_reflectance=0.9, divergence_mrad=5.5, pulse_m=7.5, noise_m=0.01,
    limit_noise_m=0.06, resolution_m=0.001)

OWN = 'own'
PARTS = {'velodyne_vlp16': VLP16, 'espros_tofcam635': TOFCAM635}


DROP, END = 'drop', 'end'


@dataclasses.dataclass(frozen=True)
class LidarConfig(Parameters):
    """A part by name, or one of its own; how it is run; and what it measures on."""

    part: str = param('velodyne_vlp16', 'own: by the parameters of `own`', choices=(*PARTS, OWN))
    own: LidarOptics = group(LidarOptics)
    rate_hz: int = param(10, 'its period is a whole number of state periods',
                         unit='Hz', low=1, high=200)
    noise: bool = param(True, 'false: the true range of all that is within reach')
    laser_albedo: float = param(
        1.3, "factor on single-scattering albedos at the laser's wavelength", low=0.1, high=3.0)
    reflectance: ReflectanceConfig = group(ReflectanceConfig)
    horizontal_beam: int = param(-1, 'beam of the LaserScan, 0 the lowest; -1: the one nearest '
                                 'to the horizontal of the sensor', low=-1, high=4095)
    own_body: str = param(DROP, 'beams that meet the rover: drop, no return; end, they return it',
                          choices=(DROP, END))
    organized: bool = param(False, 'clouds have all beams as rows, with NaN where nothing '
                            'returns; false: only what returns')

    @property
    def optics(self) -> LidarOptics:
        """Those of the part."""
        return self.own if self.part == OWN else PARTS[self.part]

    @property
    def period_ns(self) -> int:
        """The period of scans [ns]."""
        return NS_PER_S // self.rate_hz

    def validate(self) -> None:
        """Raise ConfigError for what the part has not, or ignores, and for too many points."""
        if self.part != OWN:
            given, defaults = self.own.to_mapping(), LidarOptics().to_mapping()
            for name in given:
                if given[name] != defaults[name]:
                    raise ConfigError(f'own.{name}: has no effect with part = {self.part}; valid '
                                      f'is part = {OWN}')
        optics = self.optics
        if self.rate_hz > optics.most_rate_hz:
            raise ConfigError(f'rate_hz: {self.rate_hz} is not valid for {self.part}; valid is <= '
                              f'{optics.most_rate_hz:g} [Hz]')
        columns = optics.columns_at(self.rate_hz)
        if columns < 2:
            raise ConfigError(f'rate_hz: {self.rate_hz} is not valid; {columns} columns fit into '
                              'a scan, valid is >= 2')
        if columns * optics.beams > MAX_POINTS:
            raise ConfigError(f'own.beams: {optics.beams} is not valid with {columns} columns of '
                              f'a scan; valid is <= {MAX_POINTS // columns}, up to {MAX_POINTS} '
                              'points of a scan')
        if self.horizontal_beam >= optics.beams:
            raise ConfigError(f'horizontal_beam: {self.horizontal_beam} is not valid for '
                              f'{self.part}; valid is < {optics.beams}')
