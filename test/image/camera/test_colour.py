"""Colour sensors: filters, white balance, mosaic and its interpolation."""

import dataclasses

import camera_scene as scene
import cv2
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.mosaic import interpolated, TINT_ONE
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.camera.sensor import ImageSensor, SensorModel, Tint
from lunar_rover_sim.image.illumination import colours

CAMERA = CameraConfig(width=320, height=240)
RIG = StereoRig(scene.ROVER, CAMERA)
RAW = dataclasses.replace(scene.IDEAL, encoding='bayer_rggb16', bits=16)
# Apollo 16 soil 62231 at WAVELENGTHS_NM (Pieters, 1999, New Views of the Moon II, 8025).
SOIL_62231 = (.10331, .10901, .11472, .12004, .12562, .13049, .13523, .13970, .14404, .14815,
              .15204, .15616, .15981, .16350, .16674, .17002)


def mosaic(config, share=0.3, red=1.0, blue=1.0, own=1.0):
    """Return the mosaic of a flat field of one colour; share: of full scale, of green."""
    model = SensorModel(CAMERA, config)
    light = share * config.full_well_e / (model.electrons_per_radiance_second * 1e-3)
    shape = CAMERA.height, CAMERA.width
    low, high = np.rint(np.array([red, blue]) * TINT_ONE * 65535.0).astype(np.uint32)
    return ImageSensor(RIG, model, 0).pixels(
        np.full(shape, light, np.float32), 0, 1e-3, 0,
        Tint(np.full(shape, low | high << 16, np.uint32),
             np.full(shape, own * light, np.float32)))


def channels(pixels):
    """Return the mean red, green, blue of a mosaic."""
    return np.array([pixels[::2, ::2].mean(), 0.5 * (pixels[::2, 1::2].mean()
                                                     + pixels[1::2, ::2].mean()),
                     pixels[1::2, 1::2].mean()])


def test_a_grey_card_under_the_sun_is_grey_after_white_balance():
    red, green, blue = channels(mosaic(RAW)) / 65535
    assert green == pytest.approx(0.3, abs=1e-3)
    assert red == pytest.approx(green, abs=1e-3) and blue == pytest.approx(green, abs=1e-3)


def test_without_white_balance_channels_are_as_their_responses():
    raw = dataclasses.replace(RAW, white_balance='none')
    bands = colours.Bands().electrons_per_joule()
    np.testing.assert_allclose(channels(mosaic(raw)) / 65535, 0.3 * bands / bands[1], rtol=1e-3)


def test_colour_of_a_surface_is_in_the_pixels_and_the_veil_is_white():
    red, green, blue = channels(mosaic(RAW, red=1.2, blue=0.7))
    assert (red / green, blue / green) == pytest.approx((1.2, 0.7), rel=2e-3)
    red, green, blue = channels(mosaic(RAW, red=1.2, blue=0.7, own=0.5))
    assert (red / green, blue / green) == pytest.approx((1.1, 0.85), rel=2e-3)


@pytest.mark.parametrize(('middles_nm', 'width_nm'), [
    ((650, 540, 450), 15.0), ((600, 540, 480), 80.0), ((450, 540, 650), 30.0)])
def test_colours_are_those_that_the_response_sees(middles_nm, width_nm):
    """Soil is drawn as the default bands see it; narrow, wide and swapped ones see others."""
    responses = [tuple(0.5 * np.exp(-0.5 * ((np.array(colours.WAVELENGTHS_NM) - middle)
                                            / width_nm)**2)) for middle in middles_nm]
    raw = dataclasses.replace(RAW, **dict(zip(
        ('red_response', 'green_response', 'blue_response'), responses)))
    for kind in ('highland', 'mare'):
        drawn = colours.ground_colour(kind)
        red, green, blue = channels(mosaic(raw, red=drawn[0], blue=drawn[1]))
        expected = colours.Bands(tuple(responses)).colour(colours.albedo(kind))
        assert (red / green, blue / green) == pytest.approx(tuple(expected), rel=0.015)


def test_warm_light_has_the_colour_of_its_black_body():
    """Bands that see one wavelength each have the ratios of Planck's law; the sun's are 1."""
    nm = np.array(colours.WAVELENGTHS_NM)
    seen = np.array([600.0, 540.0, 440.0])
    lines = colours.Bands(tuple(map(tuple, 0.5 * (nm == seen[:, None]))))
    np.testing.assert_allclose(lines.colour_of_light(colours.SUN_K), 1.0)
    warm, sun = (colours.planck(1e-9 * seen, kelvin) for kelvin in (3000.0, colours.SUN_K))
    np.testing.assert_allclose(lines.colour_of_light(3000.0),
                               (warm / sun)[[0, 2]] / (warm / sun)[1])


def test_equal_responses_see_no_colours():
    even = (0.5,) * len(colours.WAVELENGTHS_NM)
    raw = dataclasses.replace(RAW, red_response=even, green_response=even, blue_response=even)
    red, green, blue = channels(mosaic(raw, red=1.3, blue=0.6))
    assert (red / green, blue / green) == pytest.approx((1.0, 1.0), rel=1e-3)


def test_electrons_are_those_of_the_response():
    """A monochromatic response: photons of that wavelength times quantum efficiency."""
    wavelengths = np.array(colours.WAVELENGTHS_NM)
    line = tuple(np.where(wavelengths == 540, 0.5, 0.0))
    electrons = colours.Bands((line, line, line)).electrons_per_joule()
    photon_j = 6.626e-34 * 2.998e8 / 540e-9
    share = float(colours.planck(540e-9, colours.SUN_K)) * 20e-9
    np.testing.assert_allclose(electrons, 0.5 * share / photon_j, rtol=1e-3)
    # The shares of all wavelengths are 1.
    metres = np.arange(150e-9, 2e-4, 2e-9)
    assert float(colours.planck(metres, colours.SUN_K).sum()) * 2e-9 == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize('kind', ['mare', 'highland'])
def test_soil_is_as_red_as_measured(kind):
    """The colours of the ground against a laboratory spectrum that they do not come from."""
    red, blue = colours.Bands().colour(SOIL_62231)
    own = colours.ground_colour(kind)
    assert own[0] == pytest.approx(red, rel=0.03) and own[1] == pytest.approx(blue, rel=0.03)
    # Blue, green, red at 443, 560 and 653 nm: about 0.78, 1, 1.14 on the Moon.
    albedo = np.interp((443, 560, 653), colours.WAVELENGTHS_NM, colours.albedo(kind))
    assert albedo[0] / albedo[1] == pytest.approx(0.78, abs=0.02)
    assert albedo[2] / albedo[1] == pytest.approx(1.14, abs=0.02)


def test_rocks_are_less_red_than_soil():
    for rocks, ground in (('rock', 'highland'), ('basalt', 'mare')):
        assert 1.0 < colours.rock_colour(rocks)[0] < colours.ground_colour(ground)[0]
        assert 1.0 > colours.rock_colour(rocks)[1] > colours.ground_colour(ground)[1]


def test_rgb8_is_the_interpolated_mosaic_and_places_are_kept():
    eight = dataclasses.replace(RAW, encoding='bayer_rggb8', bits=12)
    image = interpolated(mosaic(eight, red=1.3, blue=0.6))
    assert image.shape == (240, 320, 3) and image.dtype == np.uint8
    assert image[..., 0].min() > image[..., 1].max() > image[..., 2].max()
    # A bright spot stays in its place, in all three colours.
    v, u = np.indices((64, 64)).astype(float)
    spot = np.exp(-0.5 * ((u - 30.3)**2 + (v - 31.6)**2) / 1.5**2)
    seen = interpolated(np.rint(20 + 200 * spot).astype(np.uint8)) - 20.0
    for k in range(3):
        place = [(axis * seen[..., k]).sum() / seen[..., k].sum() for axis in (u, v)]
        assert place == pytest.approx([30.3, 31.6], abs=0.05)


@pytest.mark.parametrize('kind', [np.uint8, np.uint16])
def test_colours_behind_a_mosaic_are_met(kind):
    """Even slopes exactly; stones behind a low-pass filter within half of bilinear errors."""
    v, u = np.indices((63, 64))

    def mosaic_of(colours):
        which = (v & 1) + (u & 1)
        return np.take_along_axis(colours, which[..., None], axis=2)[..., 0].astype(kind)

    slopes = np.stack([20 + u, 30 + 2 * v, 90 - u + v], axis=-1)
    np.testing.assert_array_equal(interpolated(mosaic_of(slopes))[2:-2, 2:-2],
                                  slopes[2:-2, 2:-2])
    stones = np.where(np.random.default_rng(3).random((63, 64)) < 0.05, 180.0, 80.0)
    spots = np.array([0.25, 0.5, 0.25])
    colours = np.rint(cv2.sepFilter2D(stones, -1, spots, spots)[..., None] * [1.1, 1.0, 0.9])
    seen = mosaic_of(colours)
    ours, theirs = (np.std((image - colours)[3:-3, 3:-3]) for image in (
        interpolated(seen), cv2.demosaicing(seen, cv2.COLOR_BayerRGGB2RGB)))
    assert ours < 0.5 * theirs


def test_sixteen_bits_are_interpolated_too():
    image = interpolated(mosaic(RAW, red=1.2, blue=0.8))
    assert image.shape == (240, 320, 3) and image.dtype == np.uint16
    assert image[50, 50, 0] / image[50, 50, 1] == pytest.approx(1.2, rel=0.01)


def test_colours_of_a_sensor_are_noisier_than_grey_at_the_same_exposure():
    """Filters take light: a green pixel has the share of the electrons that its response says."""
    mono = SensorModel(CAMERA, SensorConfig())
    colour = SensorModel(CAMERA, SensorConfig(encoding='rgb8'))
    ratio = colour.electrons_per_radiance_second / mono.electrons_per_radiance_second
    assert ratio == pytest.approx(colours.Bands().electrons_per_joule()[1] / 6.5e17)
    assert 0.3 < ratio < 0.5


def test_green_is_as_sharp_as_grey():
    """Stripes of a quarter of a cycle per pixel, on mono sensors and interpolated mosaics."""
    column = np.arange(320)
    stripes = np.tile(np.float32(0.4 + 0.2 * np.cos(0.5 * np.pi * column + 0.3)), (240, 1))

    def amplitude(encoding):
        config = dataclasses.replace(RAW, encoding=encoding)
        model = SensorModel(CAMERA, config)
        full = np.float32(config.full_well_e / (model.electrons_per_radiance_second * 1e-3))
        pixels = ImageSensor(RIG, model, 0).pixels(stripes * full, 0, 1e-3, 0)
        row = (pixels if encoding == 'mono16' else interpolated(pixels)[..., 1])[120, 40:280]
        return abs((row * np.exp(-0.5j * np.pi * column[40:280])).mean())

    assert 0.95 < amplitude('bayer_rggb16') / amplitude('mono16') < 1.06
