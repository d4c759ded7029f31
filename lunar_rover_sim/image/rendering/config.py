"""Parameters of the image: camera, light, and how much is drawn."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.image.camera.config import (CameraConfig, check_mosaic, LensConfig,
                                                 MiscalibrationConfig, SensorConfig)
from lunar_rover_sim.image.illumination.config import (EarthConfig, LampConfig, ReflectanceConfig,
                                                       SunConfig)


@dataclasses.dataclass(frozen=True)
class DetailConfig(Parameters):
    """How much is drawn."""

    gone = {'full_resolution_m': 2.5, 'exact_m': 14.0, 'cells_per_distance': 64.0,
            'rock_min_px': 0.7, 'contrast_by_view': False}

    relief_rms_slope: float = param(
        0.11, 'of each of the two tiles of relief below the grid; facets of rocks in proportion',
        low=0.0, high=0.6)
    pebble_cover: float = param(0.035, 'share of the ground under pebbles below the grid',
                                low=0.0, high=0.4)
    pit_cover: float = param(0.16, 'share of the ground under craters below the grid', low=0.0,
                             high=1.0)
    relief_shape_m: float = param(
        0.0, 'up to this distance relief below the grid has shape (depth, parallax, occlusion); '
        'farther away it is light only', unit='m', low=0.0, high=2.5)
    far_rocks_m: float = param(
        300.0, 'rocks from 0.3 m are drawn beyond the fine ground up to this x or y; 0: none',
        unit='m', low=0.0, high=2000.0)
    smooth_outlines: bool = param(
        True, 'edges are drawn without steps')
    supersampling: int = param(
        1, 'samples of light along a side of a pixel', low=1, high=4)
    bounce: bool = param(True, 'lit ground scatters light into shadows')

    def with_samples(self, least: int) -> DetailConfig:
        """Return it with at least so many samples along a side of a pixel.

        Raises:
            ConfigError: If the number is not valid.
        """
        wanted = dataclasses.replace(self, supersampling=least)
        return wanted if least > self.supersampling else self


@dataclasses.dataclass(frozen=True)
class RenderConfig(Parameters):
    """Everything about the image."""

    gone = {'tracks': {'compacted_darkening': 0.06, 'loose_darkening': 0.08,
                       'compacted_theta_deg': 12.0, 'compacted_c': -0.25}}

    camera: CameraConfig = group(CameraConfig)
    miscalibration: MiscalibrationConfig = group(MiscalibrationConfig)
    lens: LensConfig = group(LensConfig)
    sun: SunConfig = group(SunConfig)
    earth: EarthConfig = group(EarthConfig)
    reflectance: ReflectanceConfig = group(ReflectanceConfig)
    sensor: SensorConfig = group(SensorConfig)
    detail: DetailConfig = group(DetailConfig)
    lamp: LampConfig = group(LampConfig)

    def validate(self) -> None:
        """Check parameters that depend on each other."""
        check_mosaic(self.camera, self.sensor)
        if self.earth.lights_ground and not self.sun.date:
            raise ConfigError('earth.lights_ground: true is not valid without a date, which says '
                              'where the Earth is; set sun.date')
