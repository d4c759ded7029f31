"""The sensor at work: radiance on the GPU to the numbers that a camera puts out."""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.distorted_image import source_pixels
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.context import load_program, set_uniform

if TYPE_CHECKING:
    import moderngl

F32 = NDArray[np.float32]


class Imager:
    """Develops pairs of images, the left above the right in one texture."""

    def __init__(self, context: moderngl.Context, rig: StereoRig, sensor: SensorModel,
                 seed: int, padding: tuple[int, int] = (0, 0)) -> None:
        """Prepare; padding: columns and rows of radiance beyond each edge of the image."""
        self._context, self._rig, self.sensor = context, rig, sensor
        c = sensor.config
        self._type = 'nu2' if sensor.output_type is np.uint16 else 'f1'
        size = (rig.width, 2 * rig.height)
        self._image = context.texture(size, 1, dtype=self._type)
        self._target = context.framebuffer([self._image])
        gain, offset = self._patterns(seed)
        # Sixteen bits each: what is read for every pixel had better be small.
        span = np.array([gain.max(), max(2.0 * np.abs(offset).max(), 1e-6)])
        pattern = np.stack([gain / span[0], offset / span[1] + 0.5], axis=-1)
        self._pattern = context.texture(size, 2, np.rint(65535.0 * pattern).astype(np.uint16),
                                        dtype='nu2')
        self._pattern.filter = (context.NEAREST, context.NEAREST)
        self._pattern.repeat_x = self._pattern.repeat_y = False
        noisy = c.shot_noise or (c.read_noise and c.read_noise_e > 0.0)
        self._program = load_program(context, 'screen', 'sensor',
                                     **({'SPREAD': 1} if c.psf_sigma_px > 0.0 else {}),
                                     **({'NOISE': 1} if noisy else {}),
                                     **({'DISTORTED': 1} if sensor.camera.distorted else {}),
                                     **({'ROOT': 1} if sensor.companded else {}))
        set_uniform(self._program, u_spread=sensor.neighbour_weight, u_pattern_span=tuple(span),
                    u_height=float(rig.height), u_texel=(1.0 / size[0], 1.0 / size[1]),
                    u_noise=(float(c.shot_noise), c.read_noise_e * c.read_noise),
                    u_adc=(1.0 / c.full_well_e, c.black_level, float(sensor.largest_number)),
                    u_out=sensor.output_scale)
        self._seed = seed
        self._source: Any = None
        if sensor.camera.distorted:
            source = source_pixels(sensor.camera) + padding
            lower = source + [0, rig.height + 2 * padding[1]]
            both = np.concatenate([source, lower]).astype(np.float32)
            self._source = context.texture(size, 2, both.tobytes(), dtype='f4')
            self._source.filter = (context.NEAREST, context.NEAREST)
        self._screen = context.vertex_array(self._program, [])

    def _patterns(self, seed: int) -> tuple[Array, Array]:
        """Return (2 h, w) fall-off times gain of each pixel, and its offset [e-]."""
        c, K = self.sensor.config, self._rig.K
        v, u = np.indices((self._rig.height, self._rig.width))
        tangent2 = ((u - K[0, 2])**2 + (v - K[1, 2])**2) / K[0, 0]**2
        gain = np.tile((1.0 + tangent2)**(-2.0 * c.vignetting), (2, 1))
        offset = np.zeros_like(gain)
        if c.fixed_pattern:
            rng = np.random.default_rng([seed, 4141])
            gain *= np.maximum(1.0 + c.prnu * rng.standard_normal(gain.shape), 0.0)
            offset = c.dsnu_e * rng.standard_normal(gain.shape)
        return gain, offset

    def develop(self, radiance: moderngl.Texture, eyes: list[int], exposure_s: float,
                frame_index: int) -> NDArray[Any]:
        """Return (2, h, w) pixels of a (w, 2 h) texture of radiance; only `eyes` are valid."""
        h, w = self._rig.height, self._rig.width
        first, last = min(eyes), max(eyes)
        self._target.use()
        self._target.viewport = (0, first * h, w, (last - first + 1) * h)
        self._context.enable_only(self._context.NOTHING)
        radiance.use(0)
        self._pattern.use(1)
        if self._source is not None:
            self._source.use(2)
            set_uniform(self._program, u_source=2)
        set_uniform(self._program, u_radiance=0, u_pattern=1,
                    u_electrons=self.sensor.electrons_per_radiance_second * exposure_s,
                    u_dark=self.sensor.config.dark_current_e_s * exposure_s,
                    u_frame=int(np.random.SeedSequence(
                        [self._seed, frame_index % (1 << 63)]).generate_state(1)[0]))
        self._screen.render(vertices=3)
        data = self._target.read(components=1, alignment=1, dtype=self._type,
                                 viewport=(0, 0, w, 2 * h))
        return np.frombuffer(data, self.sensor.output_type).reshape(2, h, w)

    def release(self) -> None:
        """Release the GL objects."""
        for item in (self._screen, self._target, self._image, self._pattern, self._program,
                     self._source):
            if item is not None:
                item.release()


class AutoExposure:
    """Follows the brightness of lit ground, with lag.

    The bright end (92nd percentile) of the pixels that are not black is brought to twice the
    target level, at most 0.8 of full scale. State: the exposure of the next frame [s].
    """

    def __init__(self, sensor: SensorModel) -> None:
        self._sensor = sensor
        self.exposure_s = sensor.config.exposure_s
        self.started = False

    @property
    def aim(self) -> float:
        """Level, of full scale, that the bright end is brought to."""
        return min(2.0 * self._sensor.config.target_level, 0.8)

    def start(self, radiance: F32) -> None:
        """Set the first exposure from the (h, w) ideal image."""
        self.started = True
        lit = radiance[radiance > 0.02 * float(radiance.max(initial=0.0))]
        if len(lit):
            bright = float(np.percentile(lit, 92))
            self.exposure_s = self._bounded(
                self.aim * self._sensor.config.full_well_e
                / (bright * self._sensor.electrons_per_radiance_second))

    def follow(self, image: NDArray[Any]) -> None:
        """Take in a developed (h, w) image."""
        c = self._sensor.config
        # By counts of levels: sorting as many values takes ten times as long.
        counts = np.bincount(image[::2, ::2].ravel(), minlength=np.iinfo(image.dtype).max + 1)
        signal = self._sensor.linear(np.arange(len(counts)).astype(image.dtype))
        counts[signal <= 0.02] = 0
        lit = int(counts.sum())
        # With nothing to be seen, open up.
        bright = _quantile(signal, counts, 0.92) if lit > 50 else 0.05
        wanted = self._bounded(self.exposure_s * self.aim / max(bright, 0.02))
        self.exposure_s = float(self.exposure_s**c.auto_lag * wanted**(1.0 - c.auto_lag))

    def _bounded(self, exposure_s: float) -> float:
        return float(np.clip(exposure_s, 1e-5, self._sensor.config.auto_max_s))


def _quantile(values: F32, counts: NDArray[np.int64], share: float) -> float:
    """Return the quantile of increasing values that occur so many times."""
    last = np.cumsum(counts)
    rank = share * (last[-1] - 1)
    below = np.searchsorted(last, np.floor(rank), side='right')
    above = np.searchsorted(last, np.ceil(rank), side='right')
    return float(values[below] + (rank - np.floor(rank)) * (values[above] - values[below]))
