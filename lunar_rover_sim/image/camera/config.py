"""Parameters of the cameras: geometry, lens, image sensor."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.image.camera.distortion import is_invertible
from lunar_rover_sim.image.camera.encoding import ENCODINGS, is_bayer
from lunar_rover_sim.image.illumination.colours import BLUE, GREEN, RED, WAVELENGTHS_NM


@dataclasses.dataclass(frozen=True)
class CameraConfig(Parameters):
    """Two equal pinhole cameras; the rover's description says where they are mounted."""

    width: int = param(640, 'image width', unit='px', low=16, high=8192)
    height: int = param(480, 'image height', unit='px', low=16, high=8192)
    horizontal_fov_deg: float = param(70.0, 'horizontal field of view', unit='deg', low=1.0,
                                      high=150.0)
    distortion: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0, 0.0), 'Brown-Conrady k1, k2, p1, p2, k3; all zero: rectified images',
        low=-2.0, high=2.0, length=5)

    gone = {'near_m': 0.02, 'far_m': 20e3}
    near_m: ClassVar[float] = 0.02      # nearest drawn depth
    far_m: ClassVar[float] = 20e3       # farthest drawn depth

    @property
    def focal_px(self) -> float:
        """Focal length [px]; pixels are square."""
        return 0.5 * self.width / math.tan(0.5 * math.radians(self.horizontal_fov_deg))

    @property
    def distorted(self) -> bool:
        """Whether the images are distorted."""
        return any(self.distortion)

    def validate(self) -> None:
        """Check that the distortion can be inverted everywhere in the image."""
        if not self.distorted:
            return
        if not is_invertible(self.distortion, 0.5 * self.width / self.focal_px,
                             0.5 * self.height / self.focal_px):
            raise ConfigError(f'distortion: {list(self.distortion)} is not valid; valid is one '
                              f'that can be inverted over {self.horizontal_fov_deg:g} deg of '
                              'view; use smaller coefficients')


@dataclasses.dataclass(frozen=True)
class MiscalibrationConfig(Parameters):
    """Bounds of how the right camera differs from its CameraInfo; each seed draws one within."""

    rotation_deg: float = param(0.0, 'rotation about each axis', unit='deg', low=0.0, high=2.0)
    focal_percent: float = param(0.0, 'focal length', unit='%', low=0.0, high=5.0)
    gain_percent: float = param(0.0, 'gain', unit='%', low=0.0, high=50.0)

    @property
    def moves(self) -> bool:
        """Whether its image lies elsewhere."""
        return self.rotation_deg > 0.0 or self.focal_percent > 0.0

    @property
    def perfect(self) -> bool:
        """Whether there is nothing to draw."""
        return not self.moves and self.gain_percent == 0.0


@dataclasses.dataclass(frozen=True)
class LensConfig(Parameters):
    """Stray light of the lens; all light that strays is missing in the image proper.

    The scattered light follows the glare that Alam et al. (2026, arXiv:2604.16200, camera_gsf.m
    of their published code) measured of a machine-vision camera (IDS): 0.11 % of the light within
    the image, falling as the power 1.4 to 1.7 of the distance. Their pixels were scaled to the
    default field of view here. Other lenses there scatter 0.007 to 0.7 %, and a dusty one more.
    The veil is that of 45 double reflections between surfaces that reflect 0.5 %, as in a lens of
    five parts; 3.2 of them make ghosts, as in a traced wide-angle lens (`ghosts.py`).
    """

    gone = {'lateral_colour': 0.0}

    scatter_share: float = param(
        0.0015, 'share of the light scattered around its image; 0: off',
        low=0.0, high=0.3)
    scatter_exponent: float = param(
        1.55, 'power of the distance that scattered light falls with', low=1.0, high=4.0)
    scatter_core_deg: float = param(
        0.1, 'within this distance scattered light is even', unit='deg', low=1e-3, high=20.0)
    veil_share: float = param(
        0.0011, 'share of the light that veils the whole image; 0: off', low=0.0,
        high=0.3)
    hood_deg: float = param(
        15.0, 'angle beyond the edge of the image from which the hood hides the sun',
        unit='deg', low=0.0, high=90.0)
    ghost_share: float = param(
        0.07, 'share of the veiling sunlight that is gathered in ghosts', low=0.0, high=1.0)


@dataclasses.dataclass(frozen=True)
class SensorConfig(Parameters):
    """A machine-vision camera; defaults follow a Sony IMX273 binned 2 x 2.

    Values are of the order of that sensor's EMVA 1288 figures (3.45 um pixels, 10.7 ke- full
    well, 2.3 e- read noise), summed over four pixels. The other encodings than mono have a mosaic
    of filters in front, red and green in even rows, green and blue in odd ones.
    """

    gone = {'transmission': 0.9, 'blooming': 0.0, 'low_pass_filter': True}

    encoding: str = param('mono8', 'mono: no colour filters; bayer: one colour a pixel, as read; '
                          'rgb8: bayer_rggb8, interpolated',
                          choices=ENCODINGS)
    bits: int = param(12, 'of the converter', low=8, high=16)
    companding: str = param(
        'sqrt', 'images of 8 bits: linear, the upper 8 of the converter; sqrt, the root of the '
        'signal above black',
        choices=('sqrt', 'linear'))
    exposure_mode: str = param(
        'sunlit', 'sunlit: once, from the sun and the ground; fixed: exposure_s; '
        'auto: follows the images', choices=('sunlit', 'fixed', 'auto'), live=True)
    exposure_s: float = param(1e-3, 'of mode fixed, and the first of mode auto',
                              unit='s', low=0.0, open_low=True, high=10.0, live=True)
    target_level: float = param(0.40, 'what sunlit and auto aim at, of full scale', low=0.01,
                                high=0.95, live=True)
    auto_lag: float = param(0.6, 'share of the old exposure that auto keeps per frame', low=0.0,
                            high=0.99, live=True)
    auto_max_s: float = param(0.02, 'longest exposure of auto', unit='s', low=1e-5, high=10.0,
                              live=True)
    motion_blur: bool = param(True, 'light is gathered while the rover moves')
    line_time_s: float = param(
        0.0, 'rolling shutter: from the exposure of one row to the next; 0: global',
        unit='s', low=0.0, high=1e-3)
    f_number: float = param(4.0, 'aperture', low=0.5, high=64.0)
    pixel_pitch_m: float = param(6.9e-6, 'side of a pixel', unit='m', low=0.5e-6, high=1e-4)
    electrons_per_joule: float = param(
        6.5e17, 'photo-electrons per joule of sunlight on a pixel without colour filter',
        unit='1/J', low=1e14, high=1e19)
    red_response: tuple[float, ...] = param(
        RED, 'quantum efficiency of red pixels at 400, 420, ... 700 nm',
        low=0.0, high=1.0, length=len(WAVELENGTHS_NM))
    green_response: tuple[float, ...] = param(
        GREEN, 'that of green pixels', low=0.0, high=1.0, length=len(WAVELENGTHS_NM))
    blue_response: tuple[float, ...] = param(
        BLUE, 'that of blue pixels', low=0.0, high=1.0, length=len(WAVELENGTHS_NM))
    white_balance: str = param(
        'sun', 'sun: a grey card under the sun is grey; none: gains of 1', choices=('sun', 'none'))
    full_well_e: float = param(42800.0, 'electrons at full scale', unit='e-', low=10.0, high=1e7)
    pixel_well: float = param(
        1.05, 'electrons that a pixel holds, over full_well_e; more are lost', low=0.1,
        high=10.0)
    read_noise_e: float = param(4.6, 'standard deviation per read', unit='e-', low=0.0, high=1e4)
    dark_current_e_s: float = param(20.0, 'dark signal', unit='e-/s', low=0.0, high=1e7)
    prnu: float = param(0.006, 'fixed-pattern gain, standard deviation', low=0.0, high=0.5)
    dsnu_e: float = param(1.5, 'fixed-pattern offset, standard deviation', unit='e-', low=0.0,
                          high=1e4)
    vignetting: float = param(1.0, 'exponent share of the cos^4 fall-off; 0: off',
                              low=0.0, high=2.0)
    psf_sigma_px: float = param(0.45, 'point spread; 0: off', unit='px', low=0.0, high=0.6)
    black_level: float = param(0.004, 'offset of the converter, of full scale', low=0.0, high=0.5)
    shot_noise: bool = param(True, 'photon and dark shot noise')
    read_noise: bool = param(True, 'read noise')
    fixed_pattern: bool = param(True, 'gain and offset of each pixel')

    def validate(self) -> None:
        """Check that a colour sensor sees all three colours."""
        for name in ('red_response', 'green_response', 'blue_response'):
            if not any(getattr(self, name)):
                raise ConfigError(f'{name}: all zeros are not valid; valid is a response that is '
                                  'above 0 at some wavelength')


def check_mosaic(camera: CameraConfig, sensor: SensorConfig) -> None:
    """Raise ConfigError if an image of this size has no whole cells of its mosaic."""
    for name in ('width', 'height'):
        size = getattr(camera, name)
        if is_bayer(sensor.encoding) and size % 2:
            raise ConfigError(f'camera.{name}: {size} is not valid with encoding '
                              f'{sensor.encoding}, whose cells have 2 x 2 px; valid is an even '
                              'number')


@dataclasses.dataclass(frozen=True)
class FurtherCameraConfig(Parameters):
    """A camera besides the stereo pair."""

    camera: CameraConfig = group(CameraConfig)
    lens: LensConfig = group(LensConfig)
    sensor: SensorConfig = group(SensorConfig)

    def validate(self) -> None:
        """Check camera and sensor against each other."""
        check_mosaic(self.camera, self.sensor)


@dataclasses.dataclass(frozen=True)
class CompressionConfig(Parameters):
    """Parameters of one compressed image, with the names of compressed_image_transport."""

    format: str = param('jpeg', 'compression; png is lossless', choices=('jpeg', 'png'),
                        live=True)
    jpeg_quality: int = param(95, 'quality of jpeg, higher is better', unit='%', low=1, high=100,
                              live=True)
    png_level: int = param(3, 'effort of png; higher is smaller and slower', low=0, high=9,
                           live=True)
