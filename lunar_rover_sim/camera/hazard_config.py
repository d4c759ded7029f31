"""Parameters of hazard cameras: cameras on the rover besides the stereo pair."""

from __future__ import annotations

import dataclasses
import math

from lunar_rover_sim.camera import equidistant
from lunar_rover_sim.camera.config import CameraConfig, FurtherCameraConfig
from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.parameters import group, param

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
        'k2 theta^4 + ...), as D of CameraInfo', low=-2.0, high=2.0, length=4)
    image_circle_deg: float = param(
        185.0, 'with model equidistant: no light arrives from outside this cone about the axis',
        unit='deg', low=1.0, high=185.0)
    near_m: float = param(0.01, 'nearest drawn depth', unit='m', low=1e-3, high=10.0)

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
        if self.near_m >= self.far_m:
            raise ConfigError(f'near_m: {self.near_m:g} is not valid; valid is < far_m '
                              f'({self.far_m:g})')
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
class HazardConfig(FurtherCameraConfig):
    """A hazard camera: where it is on the rover, and what it is made of."""

    rate_hz: int = param(5, 'images per second; a divisor of frame_rate_hz', unit='Hz', low=1,
                         high=200)
    position_m: tuple[float, ...] = param(
        (0.17, 0.0, 0.02), 'of the lens in base_link; of a pair, of the middle between both',
        unit='m', low=-10.0, high=10.0, length=3)
    orientation_rpy_deg: tuple[float, ...] = param(
        (0.0, 20.0, 0.0), 'roll, pitch, yaw about fixed axes of base_link; all zero: it looks '
        'ahead; positive pitch looks down, yaw 180 looks back', unit='deg', low=-360.0, high=360.0,
        length=3)
    stereo_baseline_m: float = param(
        0.0, 'distance between two such cameras, left and right; 0: one camera', unit='m', low=0.0,
        high=5.0)
    camera: HazardCameraConfig = group(HazardCameraConfig)

    @property
    def stereo(self) -> bool:
        """Whether it is a pair."""
        return self.stereo_baseline_m > 0.0
