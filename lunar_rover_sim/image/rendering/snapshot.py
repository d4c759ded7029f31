"""Single frames: a rover that stands on the ground, exposure at rest, views of a world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.image.illumination.config import LampConfig, SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.renderer import FurtherCamera, Renderer
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import Posed, RoverPose

HEIGHT_M = 0.09         # of base_link above the ground, for a rover that stands
_REACH_M = 0.15         # the slope under a rover is taken over this distance, to both sides
_SETTLED, _MOST_FRAMES = 0.01, 60
_LAMP_W = 20.0          # for views without sunlight


def standing(world: World, x_m: float, y_m: float, yaw_deg: float,
             height_m: float = HEIGHT_M) -> Array:
    """Return T_world_base (4, 4) of a rover that stands upright on the slope at a place.

    Args:
        height_m: Of base_link above the ground, square to the slope.

    Raises:
        ConfigError: Outside the world.
    """
    outside = world.outside(x_m, y_m)
    if outside:
        raise ConfigError(f'pose: {outside}')
    ground = float(world.height_at((x_m, y_m)))
    reach = _REACH_M
    slope = [(float(world.height_at((x_m + reach * dx, y_m + reach * dy)))
              - float(world.height_at((x_m - reach * dx, y_m - reach * dy)))) / (2 * reach)
             for dx, dy in ((1, 0), (0, 1))]
    up = np.array([-slope[0], -slope[1], 1.0])
    up /= np.linalg.norm(up)
    yaw = np.radians(yaw_deg)
    left = np.cross(up, [np.cos(yaw), np.sin(yaw), 0.0])
    left /= np.linalg.norm(left)
    rotation = np.stack([np.cross(left, up), left, up], axis=1)
    return se3(rotation, np.array([x_m, y_m, ground]) + height_m * up)


def settle(renderer: Renderer, state: Posed) -> None:
    """Draw a state until automatic exposure is at rest; with a fixed exposure, do nothing."""
    if renderer.config.sensor.exposure_mode == 'auto':
        settled(renderer, state)


def settled(camera: Renderer | FurtherCamera, state: Posed) -> StereoFrame:
    """Return the left image of a state, drawn until automatic exposure is at rest."""
    last = 0.0
    for k in range(_MOST_FRAMES):
        frame = camera.render(state, k, ('left',))
        if abs(frame.exposure_s - last) < _SETTLED * frame.exposure_s:
            break
        last = frame.exposure_s
    return frame


def four_views(world: World, azimuth_deg: float,
               elevation_deg: float) -> list[tuple[str, NDArray[np.generic]]]:
    """Return titles and (h, w) images of the rover's left camera, in four directions to the sun.

    Where the sun is below the horizontal the rover's lamp is on.

    Raises:
        RenderError: If there is no usable EGL device.
    """
    night = elevation_deg < 0.0
    sensor = SensorConfig(exposure_mode='auto', auto_lag=0.0, auto_max_s=0.05)
    config = RenderConfig(sun=SunConfig(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg),
                          sensor=sensor, lamp=LampConfig(power_w=_LAMP_W if night else 0.0))
    away = azimuth_deg + 180.0
    spot = 0.12 * world.ground.half_extent_m
    places = [('sun behind', 0.0, 0.0, away, HEIGHT_M),
              ('sun from the right', spot, -spot, azimuth_deg + 90.0, HEIGHT_M),
              ('towards the sun', -spot, spot, azimuth_deg + 15.0, HEIGHT_M),
              ('from 3 m above the ground', 0.0, 0.0, away + 40.0, 3.0)]
    views = []
    east, north = world.ground.middle_m
    with Renderer(world, RoverDescription(), config, world.config.seed) as renderer:
        for title, x, y, yaw, height in places:
            x, y = x + east, y + north
            state = RoverPose(standing(world, x, y, yaw, height))
            settle(renderer, state)
            left = renderer.render(state, 0, ('left',)).picture('left')
            views.append((f'{title}, at ({x:.1f}, {y:.1f}) m', left))
    return views
