"""Parameters of a star tracker."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.parameters import param, Parameters


@dataclasses.dataclass(frozen=True)
class StarTrackerConfig(Parameters):
    """A star tracker on the deck.

    Errors, rate, largest turn rate and exclusion angle of the sun are those of a Sinclair
    Interplanetary (Rocket Lab) ST-16RT2, from memory of its data sheet. The exclusion angles of
    Earth and ground are choices.
    """

    enabled: bool = param(True, 'false publishes the true attitude, where stars can be seen')
    rate_hz: int = param(2, 'its period is a whole number of state periods', unit='Hz', low=1,
                         high=1000)
    position_m: tuple[float, ...] = param((-0.1, 0.0, 0.06), 'in base_link, for the light of the '
                                          'sun that falls on it', unit='m', length=3, low=-10.0,
                                          high=10.0)
    yaw_deg: float = param(180.0, 'where it looks, from ahead towards the left', unit='deg',
                           low=-360.0, high=360.0)
    elevation_deg: float = param(80.0, 'how far it looks up', unit='deg', low=-90.0, high=90.0)
    cross_arcsec: float = param(5.0, 'standard deviation across the line of sight, per axis',
                                unit='arcsec', low=0.0, high=36000.0)
    roll_arcsec: float = param(55.0, 'standard deviation about the line of sight', unit='arcsec',
                               low=0.0, high=36000.0)
    largest_rate_degps: float = param(3.0, 'turning faster it loses the stars', unit='deg/s',
                                      low=0.0, high=1000.0)
    sun_exclusion_deg: float = param(34.0, 'it is blind with the sun nearer to its line of sight, '
                                     'where the sun shines on it', unit='deg', low=0.0, high=180.0)
    earth_exclusion_deg: float = param(25.0, 'the same for the middle of the Earth, whose place '
                                       'follows from a date', unit='deg', low=0.0, high=180.0)
    ground_exclusion_deg: float = param(25.0, 'the same for the horizontal, where the bright '
                                        'ground begins', unit='deg', low=0.0, high=90.0)
