"""Parameters of the ground: rigid, or a soil by name with its numbers."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import param, Parameters
from lunar_rover_sim.ground.regolith.soil import PRESETS, Soil

RIGID, REGOLITH = 'rigid', 'regolith'
FROM_PRESET = -1.0

# Parameter → field of Soil, factor to its unit, least and greatest value.
_OVERRIDES = {
    'bearing_mnpm3': ('zeta_npm3', 1e6, 0.02, 50.0),
    'friction': ('friction', 1.0, 0.1, 1.6),
    'cohesion_kpa': ('cohesion_pa', 1e3, 0.0, 10.0),
    'compacted': ('compacted', 1.0, 0.0, 1.0),
    'repose_deg': ('repose_deg', 1.0, 10.0, 60.0),
    'shear_mm': ('shear_m', 1e-3, 0.1, 50.0),
    'elastic_npm': ('elastic_npm', 1.0, 100.0, 1e6),
    'damping_nspm': ('damping_nspm', 1.0, 0.1, 1e4),
}


def _override(name: str, doc: str, unit: str = '') -> float:
    _, _, low, high = _OVERRIDES[name]
    return param(FROM_PRESET, f'{doc}, {low:g} to {high:g}; -1: from the preset', unit=unit,
                 low=FROM_PRESET, high=high)


@dataclasses.dataclass(frozen=True)
class GroundConfig(Parameters):
    """The ground under the rover.

    `rigid` is MuJoCo's contact with the parameters of `contact`. On `regolith` tips sink, slip and
    leave tracks; `contact` then holds for rocks and chassis. Numbers hold under the gravity of
    their preset (1.62 m/s^2; poppy seeds 9.81) and are scaled to that of the simulation.
    `ground/regolith/soil.py` gives their sources.
    """

    model: str = param(RIGID, 'regolith gives and keeps tracks', choices=(RIGID, REGOLITH))
    preset: str = param('highland', 'soil', choices=tuple(PRESETS))
    bearing_mnpm3: float = _override('bearing_mnpm3', 'pressure per depth of a flat plate pressed'
                                     ' down', 'MN/m^3')
    friction: float = _override('friction', 'tangent of the friction angle')
    cohesion_kpa: float = _override('cohesion_kpa', 'cohesion, beyond what bearing_mnpm3 contains',
                                    'kPa')
    compacted: float = _override('compacted', 'part of the volume of a print that is compacted;'
                                 ' the rest makes its rim')
    repose_deg: float = _override('repose_deg', 'steepest slope of disturbed soil', 'deg')
    shear_mm: float = _override('shear_mm', 'slip over which two thirds of the friction are'
                                ' mobilised', 'mm')
    elastic_npm: float = _override('elastic_npm', 'stiffness of one tip in unloading', 'N/m')
    damping_nspm: float = _override('damping_nspm', 'damping of one tip while the soil does not'
                                    ' yield', 'N s/m')
    weak_slopes: bool = param(True, 'slopes bear less than level ground, by (1 - tan slope)^2'
                              ' (Vesic 1975)')
    variation: float = param(0.0, 'how much looser soil is on slopes, and on rims and ejecta of '
                             'fresh craters: 0 not at all, 1 highland becomes highland_loose',
                             low=0.0, high=2.0)

    def validate(self) -> None:
        """Raise ConfigError if a value is neither physical nor -1."""
        for name, (_, _, low, high) in _OVERRIDES.items():
            value = getattr(self, name)
            if value != FROM_PRESET and not low <= value <= high:
                raise ConfigError(f'{name}: {value:g} is not valid; valid is {low:g} to {high:g},'
                                  ' or -1 for the value of the preset')

    def given(self) -> list[str]:
        """Return the names of the values that are not those of the preset."""
        return [name for name in _OVERRIDES if getattr(self, name) != FROM_PRESET]

    @property
    def name(self) -> str:
        """`rigid`, or the preset."""
        return self.preset if self.deforms else self.model

    @property
    def deforms(self) -> bool:
        """Whether the ground gives."""
        return self.model == REGOLITH

    def soil(self, gravity_mps2: float) -> Soil:
        """Return the soil under a gravity [m/s^2].

        Raises:
            ConfigError: Without gravity, where grains do not hold together.
        """
        if gravity_mps2 <= 0.0:
            raise ConfigError(f'gravity_mps2: {gravity_mps2:g} is not valid on ground.model ='
                              f' {REGOLITH}; valid is > 0')
        return self.unscaled_soil.under(gravity_mps2)

    @property
    def unscaled_soil(self) -> Soil:
        """The soil under the gravity of its preset."""
        changed = {}
        for name in self.given():
            field, factor, _, _ = _OVERRIDES[name]
            changed[field] = getattr(self, name) * factor
        return dataclasses.replace(PRESETS[self.preset], weak_slopes=self.weak_slopes, **changed)
