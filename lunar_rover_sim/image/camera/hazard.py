"""Hazard cameras, those on the rover besides the stereo pair: parameters, places and frames."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
from lunar_rover_sim.base.parameters import group, param
from lunar_rover_sim.image.camera import equidistant
from lunar_rover_sim.image.camera.config import (CameraConfig, FurtherCameraConfig, LensConfig,
                                                 SensorConfig)
from lunar_rover_sim.image.camera.mount import BodyMount

PINHOLE, EQUIDISTANT = 'pinhole', 'equidistant'
_MOST_PINHOLE_DEG = 150.0


@dataclasses.dataclass(frozen=True)
class HazardCameraConfig(CameraConfig):
    """A camera of either model; a fisheye by default."""

    model: str = param(EQUIDISTANT, 'equidistant: a fisheye; pinhole: as the stereo pair',
                       choices=(EQUIDISTANT, PINHOLE))
    width: int = param(320, 'image width', unit='px', low=16, high=8192)
    height: int = param(240, 'image height', unit='px', low=16, high=8192)
    horizontal_fov_deg: float = param(180.0, 'field of view across the width of the image; with '
                                      'model pinhole at most 150', unit='deg', low=1.0, high=185.0)
    distortion: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0, 0.0), 'with model pinhole: Brown-Conrady k1, k2, p1, p2, k3',
        low=-2.0, high=2.0, length=5)
    fisheye_distortion: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0), 'with model equidistant: k1, k2, k3, k4 of theta (1 + k1 theta^2 + '
        'k2 theta^4 + ...)', low=-2.0, high=2.0, length=4)
    image_circle_deg: float = param(
        185.0, 'with model equidistant: no light arrives from outside this cone about the axis',
        unit='deg', low=1.0, high=185.0)

    gone = {'near_m': 0.01, 'far_m': 20e3}
    near_m: ClassVar[float] = 0.01

    @property
    def is_fisheye(self) -> bool:
        """Whether it is a fisheye."""
        return self.model == EQUIDISTANT

    @property
    def focal_px(self) -> float:
        """Focal length [px]; pixels are square."""
        if not self.is_fisheye:
            return super().focal_px
        half = math.radians(0.5 * self.horizontal_fov_deg)
        return 0.5 * self.width / float(equidistant.radius(half, self.fisheye_distortion))

    def validate(self) -> None:
        """Check that model, field of view and distortion go together."""
        other = self.distortion if self.is_fisheye else self.fisheye_distortion
        if any(other):
            name = 'distortion' if self.is_fisheye else 'fisheye_distortion'
            raise ConfigError(f'{name}: {list(other)} is not valid with model {self.model}; valid '
                              'are zeros')
        if not self.is_fisheye:
            if self.horizontal_fov_deg > _MOST_PINHOLE_DEG:
                raise ConfigError(
                    f'horizontal_fov_deg: {self.horizontal_fov_deg:g} is not valid with model '
                    f'pinhole; valid is <= {_MOST_PINHOLE_DEG:g} [deg], or model equidistant')
            super().validate()
        elif not equidistant.grows(self.fisheye_distortion, math.radians(
                0.5 * max(self.image_circle_deg, self.horizontal_fov_deg))):
            raise ConfigError(
                f'fisheye_distortion: {list(self.fisheye_distortion)} is not valid; valid is one '
                f'with which the radius grows with the angle over {self.image_circle_deg:g} deg '
                'of view; use smaller coefficients')


@dataclasses.dataclass(frozen=True)
class HazardLensConfig(LensConfig):
    """A lens whose stray light has the shape of that of the pair."""

    fixed = {'scatter_exponent', 'scatter_core_deg', 'ghost_share'}


@dataclasses.dataclass(frozen=True)
class HazardSensorConfig(SensorConfig):
    """A sensor with the filters and the control of exposure of the default one."""

    fixed = {'red_response', 'green_response', 'blue_response', 'auto_lag',
             'pixel_well'}


@dataclasses.dataclass(frozen=True)
class HazardConfig(FurtherCameraConfig):
    """A hazard camera: where it is on the rover, and what it is made of."""

    rate_hz: int = param(5, 'images per second; a divisor of frame_rate_hz', unit='Hz', low=1,
                         high=200, live=True)
    position_m: tuple[float, ...] = param(
        (0.17, 0.0, 0.02), 'of the lens in base_link; of a pair, of the middle between both',
        unit='m', low=-10.0, high=10.0, length=3)
    orientation_rpy_deg: tuple[float, ...] = param(
        (0.0, 20.0, 0.0), 'about fixed axes of base_link; pitch > 0 looks down, yaw 180 back',
        unit='deg', low=-360.0, high=360.0,
        length=3)
    stereo_baseline_m: float = param(
        0.0, 'distance between two such cameras, left and right; 0: one camera', unit='m', low=0.0,
        high=5.0)
    camera: HazardCameraConfig = group(HazardCameraConfig)
    lens: HazardLensConfig = group(HazardLensConfig)
    sensor: HazardSensorConfig = group(HazardSensorConfig)

    @property
    def stereo(self) -> bool:
        """Whether it is a pair."""
        return self.stereo_baseline_m > 0.0


class HazardRig:
    """A hazard camera, or a pair of them, on the rover.

    Attributes:
        T_base_left, T_base_right: (4, 4) optical frames in base_link; of one camera, twice the
            same.
    """

    def __init__(self, config: HazardConfig) -> None:
        self._config = config
        turn = se3(R_BODY_OPTICAL, np.zeros(3))
        left, right = self.link_poses()
        self.T_base_left, self.T_base_right = left @ turn, right @ turn

    def link_poses(self) -> tuple[Array, Array]:
        """Return T_base_camera (4, 4) of left and right: x along the optical axis, y left."""
        c = self._config
        turn = matrix_from_wxyz(wxyz_from_rpy(*np.radians(c.orientation_rpy_deg)))
        half = 0.5 * c.stereo_baseline_m * turn[:, 1]
        return se3(turn, np.array(c.position_m) + half), se3(turn, np.array(c.position_m) - half)


class HazardMount(BodyMount):
    """Carries a hazard camera."""

    def __init__(self, config: HazardConfig) -> None:
        super().__init__(HazardRig(config))


def sides(name: str, config: HazardConfig) -> tuple[str, ...]:
    """Return the names of the cameras below `hazard/`: the one, or the left and the right one."""
    return (f'{name}/left', f'{name}/right') if config.stereo else (name,)


def fixed_frames(name: str, config: HazardConfig) -> tuple[tuple[str, str, Array], ...]:
    """Return (parent, child, (4, 4) T_parent_child) of the frames of a hazard camera."""
    turn = se3(R_BODY_OPTICAL, np.zeros(3))
    result: list[tuple[str, str, Array]] = []
    for camera, T_base_link in zip(sides(name, config), HazardRig(config).link_poses()):
        optical = topics.hazard_frame(camera)
        link = optical.replace('_optical_frame', '_link')
        result += [(frames.BASE_FRAME, link, T_base_link), (link, optical, turn)]
    return tuple(result)
