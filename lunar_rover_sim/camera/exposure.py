"""The exposure time before any image was seen: from the light and the ground."""

from __future__ import annotations

import math

from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.illumination.hapke import parameter_set, reflectance
from lunar_rover_sim.illumination.lamp import peak_intensity


def first_exposure_s(sensor: SensorModel, sun: SunConfig, lamp: LampConfig,
                     ground: ReflectanceConfig) -> float:
    """Return the exposure time [s] before any image was seen."""
    if sensor.config.exposure_mode != 'sunlit':
        return sensor.config.exposure_s
    return sensor.exposure_for(max(sunlit_radiance(sun, ground), lamplit_radiance(lamp, ground)))


def sunlit_radiance(sun: SunConfig, ground: ReflectanceConfig) -> float:
    """Return a typical radiance [W m-2 sr-1] of lit ground: relief turned some way to the sun.

    It is that of ground seen at 60 deg from the side, whose slopes of 14 deg face the sun.
    """
    if sun.elevation_deg <= -0.5 * sun.angular_diameter_deg:
        return 0.0
    elevation = math.radians(min(max(sun.elevation_deg, 0.5) + 14.0, 90.0))
    kind = parameter_set(ground.ground)
    return sun.irradiance * float(reflectance(math.sin(elevation), 0.5, 0.5 * math.sin(elevation),
                                              kind, albedo=ground.albedo_scale))


def lamplit_radiance(lamp: LampConfig, ground: ReflectanceConfig) -> float:
    """Return the radiance [W m-2 sr-1] of level ground 0.7 m before the lamp."""
    distance, height = 0.7, lamp.position_m[2] + 0.09
    cosine = height / math.hypot(distance, height)
    irradiance = peak_intensity(lamp) / (distance**2 + height**2)
    return irradiance * float(reflectance(cosine, cosine, 0.998, parameter_set(ground.ground),
                                          albedo=ground.albedo_scale))
