"""The chase camera: it shows the rover from outside, and follows it or stands still."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import math
from typing import ClassVar

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.base.parameters import group, param
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.config import (CameraConfig, FurtherCameraConfig, LensConfig,
                                                 SensorConfig)
from lunar_rover_sim.image.camera.encoding import ENCODINGS
from lunar_rover_sim.image.camera.mount import MovingMount
from lunar_rover_sim.rover.pose import Posed

SUN, HEADING, EAST = 'sun', 'heading', 'east'
FOLLOW, TRIPOD = 'follow', 'tripod'
# Along a side of a pixel of films and stills: with one, thin parts of the rover look dashed.
SAMPLES = 2

_CLEARANCE_M = 0.15     # of the camera above the ground and beside rocks
_STILL_M, _FASTEST_MPS = 0.5, 5.0   # a rover that has moved farther was placed anew


@dataclasses.dataclass(frozen=True)
class ChaseCameraConfig(CameraConfig):
    """A pinhole camera as for films: wide image, field of view of a normal lens."""

    width: int = param(960, 'image width', unit='px', low=16, high=8192)
    height: int = param(540, 'image height', unit='px', low=16, high=8192)
    horizontal_fov_deg: float = param(42.0, 'horizontal field of view', unit='deg', low=1.0,
                                      high=150.0)

    gone = {'near_m': 0.05, 'far_m': 20e3}
    near_m: ClassVar[float] = 0.05


@dataclasses.dataclass(frozen=True)
class ChaseSensorConfig(SensorConfig):
    """The same sensor, exposed between dark ground and bright rover."""

    fixed = {field.name for field in dataclasses.fields(SensorConfig)} - {
        'encoding', 'exposure_mode', 'exposure_s', 'target_level'}

    encoding: str = param('rgb8', 'pixel format of the images, as of the pair', choices=ENCODINGS)
    exposure_mode: str = param(
        'auto', 'sunlit: once, from the sun and the ground; fixed: exposure_s; '
        'auto: follows the images', choices=('sunlit', 'fixed', 'auto'))
    target_level: float = param(0.10, 'what sunlit and auto aim at, of full scale', low=0.01,
                                high=0.95)


@dataclasses.dataclass(frozen=True)
class ChaseConfig(FurtherCameraConfig):
    """The chase camera: where it is, and what it is made of.

    A deep hood keeps stray light out: the camera shows the rover, not its own lens.
    """

    fixed = {'lens'}

    enabled: bool = param(False, 'offer chase/image_raw and chase/camera_info')
    rate_hz: int = param(10, 'images per second; a divisor of frame_rate_hz', unit='Hz', low=1,
                         high=200, live=True)
    mode: str = param(FOLLOW, 'follow: it moves with the rover; tripod: it stands at position_m '
                      'and turns towards the rover', choices=(FOLLOW, TRIPOD))
    distance_m: float = param(1.5, 'from the rover', unit='m', low=0.2, high=500.0)
    reference: str = param(SUN, 'what azimuth_deg counts from', choices=(SUN, HEADING, EAST))
    azimuth_deg: float = param(-112.0, 'of the camera from the rover, counter-clockwise; with '
                               'heading, 180 is behind it', unit='deg',
                               low=-360.0, high=360.0)
    elevation_deg: float = param(17.0, 'of the camera above the horizontal through the rover',
                                 unit='deg', low=-30.0, high=89.0)
    position_m: tuple[float, ...] = param(
        (1.5, -1.5, 0.6), 'of the tripod: x and y in the world, and height above the ground',
        unit='m', low=-1e5, high=1e5, length=3)
    aim_m: float = param(0.05, 'it looks at a point so far above base_link', unit='m',
                         low=-10.0, high=10.0)
    smoothing_s: float = param(0.8, 'time constant of following; 0: at once',
                               unit='s', low=0.0, high=60.0)
    camera: ChaseCameraConfig = group(ChaseCameraConfig)
    lens: LensConfig = LensConfig(hood_deg=0.0)
    sensor: ChaseSensorConfig = group(ChaseSensorConfig)


def tripod_problem(position_m: Sequence[float], world: World) -> str:
    """Return why no tripod can stand there, with what is valid; '' where it can.

    Args:
        position_m: x and y in the world, height above the ground [m].
    """
    x, y, height = position_m
    if height <= 0.0:
        return f'{height:g} m above the ground is not valid; valid is a height > 0 m'
    return world.outside(x, y)


class ChaseMount(MovingMount):
    """Carries the chase camera. Call `follow` for every state, in their order, then draw it.

    The camera hangs on a point that follows the rover with a lag of first order, so that the walk
    does not shake the picture. It stays above ground and rocks.
    """

    def __init__(self, config: ChaseConfig, sun_azimuth_deg: float, world: World) -> None:
        """Raise ConfigError for a tripod in the ground or outside the world."""
        super().__init__()
        problem = tripod_problem(config.position_m, world) if config.mode == TRIPOD else ''
        if problem:
            raise ConfigError(f'chase.position_m: {problem}')
        self._config, self._world = config, world
        self._zero_rad = math.radians(sun_azimuth_deg) if config.reference == SUN else 0.0
        self._stamp_ns: int | None = None
        self._centre_m, self._heading_rad, self._raised_m = np.zeros(3), 0.0, 0.0

    def enter(self, world: World) -> None:
        """Stay above ground and rocks of another window of the site from now on."""
        self._world = world

    def follow(self, state: Posed, stamp_ns: int = 0) -> None:
        """Move to where a state wants the camera; stamp_ns: simulated time [ns].

        After a jump of the rover or back in time, the camera is there at once.
        """
        T = state.T_world_base
        centre = T[:3, 3] + [0.0, 0.0, self._config.aim_m]
        heading = math.atan2(T[1, 0], T[0, 0])
        last_ns, self._stamp_ns = self._stamp_ns, stamp_ns
        step_s = 0.0 if last_ns is None else (stamp_ns - last_ns) * 1e-9
        if (last_ns is None or step_s < 0.0
                or np.linalg.norm(centre - self._centre_m) > _FASTEST_MPS * step_s + _STILL_M):
            self._centre_m, self._heading_rad = centre, heading
            self._place(np.zeros(3), 0.0, 1.0)
        elif step_s > 0.0:
            lag_s = self._config.smoothing_s
            share = -math.expm1(-step_s / lag_s) if lag_s > 0.0 else 1.0
            step = share * (centre - self._centre_m)
            swing = share * math.remainder(heading - self._heading_rad, 2.0 * math.pi)
            self._centre_m = self._centre_m + step
            self._heading_rad += swing
            self._place(step / step_s, swing / step_s, share)

    def _place(self, velocity_mps: Array, turn_radps: float, share: float) -> None:
        c, centre = self._config, self._centre_m
        if c.mode == TRIPOD:
            x, y, height = c.position_m
            camera = np.array([x, y, self._top(np.array([x, y])) + height])
            arm = centre - camera
            self.place(looking_at(camera, centre), np.zeros(3),
                       np.cross(arm, velocity_mps) / float(arm @ arm))
            return
        azimuth, rate = math.radians(c.azimuth_deg) + self._zero_rad, np.zeros(3)
        if c.reference == HEADING:
            azimuth += self._heading_rad
            rate[2] = turn_radps
        up = math.radians(c.elevation_deg)
        camera = centre + c.distance_m * np.array([math.cos(up) * math.cos(azimuth),
                                                   math.cos(up) * math.sin(azimuth),
                                                   math.sin(up)])
        # Above rocks and hills, without a jump; but never below them.
        lack = max(self._top(camera[:2]) + _CLEARANCE_M - camera[2], 0.0)
        self._raised_m = max(self._raised_m + share * (lack - self._raised_m), lack)
        camera[2] += self._raised_m
        self.place(looking_at(camera, centre), velocity_mps + np.cross(rate, camera - centre),
                   rate)

    def _top(self, xy_m: Array) -> float:
        """Return the height of ground and rocks around a place [m]; -inf beyond the world."""
        around = xy_m + _CLEARANCE_M * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
        heights = [-np.inf, *self._world.height_at(around)]
        rocks = self._world.rocks
        radius = 0.5 * rocks.diameter_m
        near = np.linalg.norm(rocks.position_m[:, :2] - xy_m, axis=1) < radius + _CLEARANCE_M
        heights.extend(rocks.position_m[near, 2] + radius[near])
        return float(np.nanmax(heights))


def looking_at(camera_m: Array, target_m: Array) -> Array:
    """Return T_world_camera (4, 4) of an optical frame whose image has a level horizon.

    A camera that looks straight down has the north above.
    """
    forward = target_m - camera_m
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(right))
    right = right / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return se3(np.stack([right, np.cross(forward, right), forward], axis=1), camera_m)
