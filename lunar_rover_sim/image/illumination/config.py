"""Parameters of the light: sun, lamp, reflectance of the ground."""

from __future__ import annotations

import dataclasses
import math

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.image.illumination.dates import parse_date

SETS_OF_SOIL = 'highland', 'forward', 'mare', 'rock', 'basalt'
OF_WORLD, GIVEN = 'world', 'given'
# Of the sun: none of a disc of up to 2 deg is above the horizontal. At this elevation it is off.
LOWEST_DEG = -1.0


@dataclasses.dataclass(frozen=True)
class SunSiteConfig(Parameters):
    """Where on the Moon the rover is, for the sun of a date."""

    source: str = param(OF_WORLD, 'world: from the elevation model; given: the values below',
                        choices=(OF_WORLD, GIVEN))
    lon_deg: float = param(0.0, 'east longitude', unit='deg', low=-360.0, high=360.0)
    lat_deg: float = param(0.0, 'latitude', unit='deg', low=-90.0, high=90.0)
    grid_north_deg: float = param(0.0, 'direction of y, from true north towards east', unit='deg',
                                  low=-360.0, high=360.0)

    def validate(self) -> None:
        """Raise ConfigError if a place is given and not used."""
        for name in ('lon_deg', 'lat_deg', 'grid_north_deg'):
            value = getattr(self, name)
            if self.source == OF_WORLD and value:
                raise ConfigError(f'{name}: {value:g} is not valid with source {OF_WORLD}; set '
                                  f'source to {GIVEN}')


@dataclasses.dataclass(frozen=True)
class SunConfig(Parameters):
    """The position and the light of the sun. It stands still unless it has a date."""

    azimuth_deg: float = param(60.0, 'from x (east) towards y (north)',
                               unit='deg', low=-360.0, high=360.0, live=True)
    elevation_deg: float = param(6.0, 'of the centre of the disc',
                                 unit='deg', low=LOWEST_DEG, high=90.0, live=True)
    angular_diameter_deg: float = param(0.533, 'of the disc', unit='deg', low=0.01, high=5.0)
    irradiance: float = param(1361.0, 'at normal incidence; 0: no sun',
                              unit='W/m^2', low=0.0, high=1e5)
    date: str = param('', 'UTC, such as 2026-11-22T06:00:00Z: azimuth and elevation follow from '
                      'it and from `site`; empty: as given')
    site: SunSiteConfig = group(SunSiteConfig)
    rate: float = param(1.0, 'seconds of the sky of a date per second of the run; 0: it stands '
                        'still', low=0.0, high=1e5)
    allow_night: bool = param(False, 'the date may be one at which the sun is down')
    step_deg: float = param(0.05, 'all light is computed anew when the sun of a date has moved by '
                            'this', unit='deg', low=0.005, high=5.0)

    def validate(self) -> None:
        """Raise ConfigError if the date is none, or out of range, or the sky has none to go on."""
        if self.date:
            parse_date('date', self.date)
        elif self.rate not in (0.0, 1.0):
            raise ConfigError(f'rate: {self.rate:g} is not valid without a date; valid is 1, or '
                              'set sun.date')

    @property
    def shines(self) -> bool:
        """Whether any of the disc is above the horizontal."""
        return self.irradiance > 0.0 and self.elevation_deg > -0.5 * self.angular_diameter_deg


@dataclasses.dataclass(frozen=True)
class EarthConfig(Parameters):
    """The Earth, where the sun has a date."""

    gone = {'geometric_albedo': 0.434}

    drawn: bool = param(True, 'draw its disc; without a date there is none')
    lights_ground: bool = param(False, 'earthshine, at most 1.3e-4 of sunlight; needs sun.date')


@dataclasses.dataclass(frozen=True)
class ReflectanceConfig(Parameters):
    """Kind and brightness of the regolith; the parameter sets are in `hapke`."""

    ground: str = param('highland', 'parameter set', choices=SETS_OF_SOIL)
    rocks: str = param('rock', 'parameter set', choices=SETS_OF_SOIL)
    albedo_scale: float = param(1.0, 'factor on the single-scattering albedo of the ground',
                                low=0.0, high=3.0)
    colour_spread: float = param(0.012, 'RMS variation of red over green, and of blue the other '
                                 'way round, in patches of 5 to 23 m: titanium, iron', low=0.0,
                                 high=0.3)
    colour_of_fresh: float = param(0.15, 'how much less red, and more blue, brighter ground is, '
                                   'as powers of its albedo',
                                   low=0.0, high=2.0)


@dataclasses.dataclass(frozen=True)
class LampConfig(Parameters):
    """A spot light with inverse square fall-off and a shadow of its own.

    It sits low and to the left of the cameras, since light from their position shows no relief.
    """

    power_w: float = param(0.0, 'radiant flux; 0: off', unit='W', low=0.0, high=1e4)
    position_m: tuple[float, ...] = param((0.15, 0.08, 0.08), 'in base_link', unit='m', length=3)
    pitch_deg: float = param(0.0, 'downward tilt', unit='deg', low=-90.0, high=90.0)
    cone_deg: float = param(60.0, 'full angle at half intensity', unit='deg', low=1.0, high=150.0)
    temperature_k: float = param(5000.0, 'black body of its colour', unit='K',
                                 low=1000.0, high=20000.0)

    @property
    def beam_exponent(self) -> float:
        """Exponent m of the beam, whose intensity falls as cos^m of the angle to its axis.

        The intensity is halved at half of the cone angle.
        """
        return math.log(0.5) / math.log(math.cos(0.5 * math.radians(self.cone_deg)))

    @property
    def peak_intensity(self) -> float:
        """Radiant intensity on the axis [W/sr]; the whole beam has the configured flux."""
        return self.power_w * (self.beam_exponent + 1.0) / (2.0 * math.pi)
