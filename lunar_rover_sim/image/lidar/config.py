"""Parameters of a LiDAR or time-of-flight camera."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.image.illumination.config import ReflectanceConfig
from lunar_rover_sim.image.lidar.optics import LidarOptics, MAX_POINTS, OWN, PARTS

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
