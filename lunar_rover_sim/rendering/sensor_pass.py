"""The pass of the sensor: radiance to the numbers that a camera puts out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import moderngl
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.camera.blooming import bloom
from lunar_rover_sim.camera.distorted_image import source_pixels
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.frames import Array
from lunar_rover_sim.rendering.context import load_program, release_all, set_uniform
from lunar_rover_sim.rendering.frame_targets import attachment
from lunar_rover_sim.rendering.scene import Uniforms


class DevelopedCamera(Protocol):
    """A camera as its sensor knows it: a `PinholeCamera` or a `FisheyeCamera`."""

    width: int
    height: int

    def falloff(self, places_px: Array) -> Array:
        """Return the irradiance of (..., 2) pixels under even light, over that on the axis."""


class SensorPass:
    """Turns pairs of radiance images, the left above the right, into pixels of the sensors."""

    def __init__(self, context: moderngl.Context, rig: DevelopedCamera, sensor: SensorModel,
                 seed: int, padding: tuple[int, int] = (0, 0)) -> None:
        """Draw the fixed patterns and compile the program.

        seed: of all noise; padding: columns and rows of radiance beyond each edge of the image
        """
        self._context, self._rig, self._sensor = context, rig, sensor
        c = sensor.config
        self._type = 'nu2' if sensor.output_type is np.uint16 else 'f1'
        size = (rig.width, 2 * rig.height)
        self._image = context.texture(size, 1, dtype=self._type)
        self._target = context.framebuffer([self._image])
        gain, offset = self._patterns(seed)
        # Sixteen bits each: fewer bytes per pixel are read faster.
        span = np.array([gain.max(), max(2.0 * np.abs(offset).max(), 1e-6)])
        pattern = np.stack([gain / span[0], offset / span[1] + 0.5], axis=-1)
        self._pattern = context.texture(size, 2, np.rint(65535.0 * pattern).astype(np.uint16),
                                        dtype='nu2')
        self._pattern.filter = (context.NEAREST, context.NEAREST)
        self._pattern.repeat_x = self._pattern.repeat_y = False
        noisy = c.shot_noise or (c.read_noise and c.read_noise_e > 0.0)
        light = {**({'SPREAD': 1} if c.psf_sigma_px > 0.0 else {}),
                 **({'DISTORTED': 1} if sensor.camera.distorted else {})}
        numbers = {**({'NOISE': 1} if noisy else {}), **({'ROOT': 1} if sensor.companded else {})}
        constants = dict(
            u_spread=sensor.neighbour_weight, u_pattern_span=tuple(span),
            u_texel=(1.0 / size[0], 1.0 / size[1]),
            u_noise=(float(c.shot_noise), c.read_noise_e * c.read_noise),
            u_well=sensor.well_e, u_out=sensor.output_scale,
            u_adc=(1.0 / c.full_well_e, c.black_level, float(sensor.largest_number)))
        # Charge runs along columns before it is read: then the sensor is drawn in two steps.
        self._charge = (_ChargePass(context, size, dict(light, CHARGE=1), constants)
                        if c.blooming > 0.0 else None)
        self._programs = [load_program(context, 'screen', 'sensor', **numbers,
                                       **({'COLLECTED': 1} if self._charge else light))]
        # The second one adds short motion to the point spread.
        if self._charge is None and not sensor.camera.distorted:
            self._programs.append(load_program(context, 'screen', 'sensor', **numbers, SPREAD=1,
                                               MOVING=1))
        for program in self._programs:
            set_uniform(program, **constants)
        self._seed = seed
        self._source: moderngl.Texture | None = None
        if sensor.camera.distorted:
            source = source_pixels(sensor.camera) + padding
            lower = source + [0, rig.height + 2 * padding[1]]
            both = np.concatenate([source, lower]).astype(np.float32)
            self._source = context.texture(size, 2, both.tobytes(), dtype='f4')
            self._source.filter = (context.NEAREST, context.NEAREST)
        self._screens = [context.vertex_array(program, []) for program in self._programs]

    def _patterns(self, seed: int) -> tuple[Array, Array]:
        """Return vignetting times gain of each pixel, and its offset [e-]; both (2 h, w)."""
        c = self._sensor.config
        v, u = np.indices((self._rig.height, self._rig.width))
        falloff = self._rig.falloff(np.stack([u, v], axis=-1))
        gain = np.tile(falloff**c.vignetting, (2, 1))
        offset = np.zeros_like(gain)
        if c.fixed_pattern:
            rng = np.random.default_rng([seed, 4141])
            gain *= np.maximum(1.0 + c.prnu * rng.standard_normal(gain.shape), 0.0)
            offset = c.dsnu_e * rng.standard_normal(gain.shape)
        return gain, offset

    def draw(self, radiance: moderngl.Texture, sides: Sequence[int], exposure_s: float,
             frame_index: int, smear: dict[int, Uniforms] | None = None) -> NDArray[Any]:
        """Return (2, h, w) pixels; only those of `sides` (0 left, 1 right) are valid.

        radiance: texture of float32 [W m-2 sr-1], w columns and 2 h rows, plus the padding
        frame_index: gives each frame its own noise; smear: see `motion_pass.Blurred`
        """
        h, w = self._rig.height, self._rig.width
        self._context.enable_only(self._context.NOTHING)
        radiance.use(0)
        self._pattern.use(1)
        if self._source is not None:
            self._source.use(2)
        light = dict(u_radiance=0, u_pattern=1, u_source=2,
                     u_electrons=self._sensor.electrons_per_radiance_second * exposure_s,
                     u_dark=self._sensor.config.dark_current_e_s * exposure_s)
        if self._charge is not None:
            self._charge.draw(light, self._sensor, sides)
        self._target.use()
        kind = 0 if smear is None else 1
        set_uniform(self._programs[kind], **light, u_charge=3,
                    u_frame=int(np.random.SeedSequence(
                        [self._seed, frame_index % (1 << 63)]).generate_state(1)[0]))
        for side in sides:
            self._target.viewport = (0, side * h, w, h)
            set_uniform(self._programs[kind], u_rows=(side * h, (side + 1) * h - 1),
                        **(smear[side] if smear else {}))
            self._screens[kind].render(vertices=3)
        data = self._target.read(components=1, alignment=1, dtype=self._type,
                                 viewport=(0, 0, w, 2 * h))
        return np.frombuffer(data, self._sensor.output_type).reshape(2, h, w)

    def release(self) -> None:
        """Release the GL objects."""
        for item in (*self._screens, self._target, self._image, self._pattern,
                     *self._programs, self._source, self._charge):
            if item is not None:
                item.release()


class _ChargePass:
    """Collects the electrons of all pixels and lets them bloom, on texture unit 3."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int], defines: dict[str, int],
                 constants: dict[str, Any]) -> None:
        self._electrons = attachment(context, size)
        self._target = context.framebuffer([self._electrons])
        self._program = load_program(context, 'screen', 'sensor', **defines)
        set_uniform(self._program, **constants)
        self._screen = context.vertex_array(self._program, [])

    def draw(self, light: dict[str, Any], sensor: SensorModel, sides: Sequence[int]) -> None:
        """Draw the images `sides` of a pair; the light is bound."""
        self._target.use()
        set_uniform(self._program, **light)
        w, h = self._electrons.width, self._electrons.height // 2
        for side in sides:
            self._target.viewport = window = (0, side * h, w, h)
            set_uniform(self._program, u_rows=(side * h, (side + 1) * h - 1))
            self._screen.render(vertices=3)
            data = self._target.read(viewport=window, components=1, alignment=1, dtype='f4')
            image = np.frombuffer(data, np.float32).reshape(h, w)
            bloomed = bloom(image, sensor.well_e, sensor.config.blooming)
            self._electrons.write(bloomed.astype(np.float32).tobytes(), viewport=window)
        self._electrons.use(3)

    def release(self) -> None:
        """Release the GL objects."""
        release_all(self._screen, self._program, self._target, self._electrons)
