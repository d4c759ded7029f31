"""Exposure by closed forms: levels that the sensor would give at the time that is chosen."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.development import (AutoExposure, first_exposure_s,
                                                      lamplit_radiance, sunlit_radiance)
from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.image.illumination.hapke import reflectance, SETS

GROUND = ReflectanceConfig(albedo_scale=0.8)
NO_SUN = SunConfig(irradiance=0.0)


def sensor(**values):
    return SensorModel(CameraConfig(), SensorConfig(**values))


def electrons(model, radiance, exposure_s):
    """Return electrons in a pixel, from radiance over the pupil (camera equation)."""
    c = model.config
    irradiance = math.pi / 4.0 * radiance * 0.9 / c.f_number**2
    return irradiance * c.pixel_pitch_m**2 * exposure_s * c.electrons_per_joule


@pytest.mark.parametrize('mode', ['fixed', 'auto'])
def test_the_first_exposure_is_the_given_one(mode):
    model = sensor(exposure_mode=mode, exposure_s=0.0037)
    assert first_exposure_s(model, SunConfig(), LampConfig(), GROUND) == 0.0037


@pytest.mark.parametrize('values', [{}, {'target_level': 0.6, 'f_number': 5.6, 'black_level': 0.1},
                                    {'full_well_e': 9000.0, 'f_number': 5.0}])
def test_sunlit_ground_comes_to_the_target_level(values):
    """Black included: the signal above it is the target less the black level."""
    model, sun = sensor(**values), SunConfig(elevation_deg=11.0)
    exposure = first_exposure_s(model, sun, LampConfig(), GROUND)
    signal = electrons(model, sunlit_radiance(sun, GROUND), exposure)
    c = model.config
    assert signal / c.full_well_e + c.black_level == pytest.approx(c.target_level)


@pytest.mark.parametrize('elevation_deg,seen_deg', [(6.0, 20.0), (0.5, 14.5), (-0.2, 14.5),
                                                    (50.0, 64.0), (85.0, 90.0)])
def test_the_typical_slope_faces_the_sun_by_14_deg(elevation_deg, seen_deg):
    """Seen at 60 deg from its normal and across the sun's plane: cos g = cos i cos e."""
    sun = SunConfig(elevation_deg=elevation_deg)
    cos_i = math.sin(math.radians(seen_deg))
    expected = sun.irradiance * reflectance(cos_i, 0.5, 0.5 * cos_i, SETS['highland'], albedo=0.8)
    assert sunlit_radiance(sun, GROUND) == pytest.approx(float(expected))


def test_a_sun_that_is_down_lights_nothing():
    assert sunlit_radiance(SunConfig(elevation_deg=-1.0), GROUND) == 0.0
    assert sunlit_radiance(NO_SUN, GROUND) == 0.0


def test_lamplit_ground_in_front_of_the_lamp():
    """0.7 m ahead and as far below as the lamp is above the ground, seen almost from the lamp."""
    lamp = LampConfig(power_w=3.0, position_m=(0.15, 0.08, 0.11), cone_deg=50.0)
    below = 0.11 + 0.09         # base_link stands 9 cm above the ground
    distance = math.hypot(0.7, below)
    half = math.log(0.5) / math.log(math.cos(math.radians(25.0)))
    intensity = 3.0 * (half + 1.0) / (2.0 * math.pi)
    expected = intensity / distance**2 * reflectance(below / distance, below / distance, 0.998,
                                                     SETS['highland'], albedo=0.8)
    assert lamplit_radiance(lamp, GROUND) == pytest.approx(float(expected))
    # At night the exposure is for the lamp; by day for the brighter of both.
    model = sensor()
    night = first_exposure_s(model, NO_SUN, lamp, GROUND)
    assert night == model.exposure_for(lamplit_radiance(lamp, GROUND))
    assert first_exposure_s(model, SunConfig(), lamp, GROUND) == model.exposure_for(
        sunlit_radiance(SunConfig(), GROUND)) < night


def test_exposures_have_bounds():
    model = sensor(target_level=0.01, black_level=0.3)
    assert model.exposure_for(0.0) == 10.0 and model.exposure_for(1e12) == 1e-6
    # A target below black: half a percent of full scale is wanted all the same.
    assert electrons(model, 5.0, model.exposure_for(5.0)) == pytest.approx(
        0.005 * model.config.full_well_e)


def test_the_constants_of_the_sensor():
    model = sensor(bits=10, black_level=0.02, full_well_e=20000.0, pixel_well=1.5,
                   psf_sigma_px=0.4)
    assert model.electrons_per_radiance_second == pytest.approx(electrons(model, 1.0, 1.0))
    assert (model.well_e, model.largest_number) == (30000.0, 1023)
    # Black plus a full well is the largest number.
    assert 0.02 * 1023 + 20000.0 * model.gain_dn_per_e == pytest.approx(1023)
    # The point spread of five taps has the given deviation along each axis.
    k = model.neighbour_weight
    assert 2.0 * k / (1.0 + 4.0 * k) == pytest.approx(0.4**2)


@pytest.mark.parametrize('bits', [8, 10, 12, 16])
@pytest.mark.parametrize('encoding,kind', [('mono8', np.uint8), ('rgb8', np.uint8),
                                           ('mono16', np.uint16)])
def test_outputs_have_the_range_of_their_type(bits, encoding, kind):
    model = sensor(bits=bits, encoding=encoding)
    assert model.output_type is kind
    scale, unit = model.output_scale
    full = np.iinfo(kind).max + 1
    assert scale * 2**bits == full and unit * (full - 1) == pytest.approx(1.0)
    assert model.companded == (encoding != 'mono16')
    assert not dataclasses.replace(model, config=SensorConfig(encoding=encoding,
                                                              companding='linear')).companded


def test_pixels_are_turned_back_into_the_signal():
    """Companded pixels are its root; linear ones hold the black level."""
    levels = np.array([0, 51, 102, 255], np.uint8)
    assert sensor().linear(levels) == pytest.approx([0.0, 0.04, 0.16, 1.0])
    linear = sensor(companding='linear', black_level=0.2)
    assert linear.linear(levels) == pytest.approx([-0.25, 0.0, 0.25, 1.0])
    deep = sensor(encoding='mono16', black_level=0.2)
    assert deep.linear(np.array([13107, 65535], np.uint16)) == pytest.approx([0.0, 1.0], abs=1e-6)


def image_of(signal, model):
    """Return mono8 pixels, the root of a signal from 0 to 1."""
    assert model.companded
    return np.rint(255.0 * np.sqrt(np.clip(signal, 0.0, 1.0))).astype(np.uint8)


@pytest.mark.parametrize('lag', [0.0, 0.6])
def test_exposure_follows_the_92nd_percentile_of_lit_ground(lag):
    """Black sky counts for nothing; in the logarithm a share of the old exposure stays."""
    model = sensor(exposure_mode='auto', exposure_s=1e-3, auto_lag=lag, auto_max_s=1.0)
    auto = AutoExposure(model)
    assert auto.exposure_s == 1e-3 and not auto.started
    rng = np.random.default_rng(1)
    signal = rng.uniform(0.05, 0.6, (120, 160))
    signal[:40] = 0.0
    image = image_of(signal, model)
    seen = model.linear(image[::2, ::2])
    bright = np.percentile(seen[seen > 0.02], 92)
    auto.follow(image)
    wanted = 1e-3 * auto.aim / bright
    assert auto.exposure_s == pytest.approx(1e-3**lag * wanted**(1.0 - lag), rel=1e-5)


def test_following_ends_where_the_bright_end_is_at_the_aim():
    """A scene of fixed radiance: each image is that at the present exposure."""
    model = sensor(exposure_mode='auto', exposure_s=2e-5, auto_max_s=1.0)
    auto = AutoExposure(model)
    scene = np.random.default_rng(3).uniform(20.0, 60.0, (80, 100))
    for _ in range(25):
        auto.follow(image_of(scene * auto.exposure_s * 10.0, model))
    bright = np.percentile(scene, 92) * auto.exposure_s * 10.0
    assert bright == pytest.approx(auto.aim, rel=0.02)


@pytest.mark.parametrize('lit,grows', [(50, True), (51, False)])
def test_in_the_dark_the_exposure_grows(lit, grows):
    """51 pixels of every third row and column are enough to go by."""
    model = sensor(exposure_mode='auto', exposure_s=1e-3, auto_lag=0.0, auto_max_s=10.0)
    auto = AutoExposure(model)
    signal = np.zeros((80, 100))
    rows, columns = np.divmod(np.arange(lit), 30)
    signal[3 * rows, 3 * columns] = 0.9
    auto.follow(image_of(signal, model))
    level = 0.05 if grows else float(model.linear(image_of(np.array([[0.9]]), model))[0, 0])
    assert auto.exposure_s == pytest.approx(1e-3 * auto.aim / level, rel=1e-4)


def test_at_most_half_a_percent_of_the_ground_is_clipped():
    """Down-sun: a few percent of the ground are several times as bright as the rest.

    The sky, with the sun in it, does not count.
    """
    model = sensor(exposure_mode='auto', exposure_s=2e-3, auto_lag=0.6, auto_max_s=1.0)
    auto = AutoExposure(model)
    scene = np.random.default_rng(3).uniform(2.0, 4.0, (240, 320))
    scene[200:, 150:170] *= np.random.default_rng(4).uniform(2.0, 6.0, (40, 20))
    scene[:60, :100] = 1e4
    ground = np.ones(scene.shape, bool)
    ground[:60] = False
    for _ in range(40):
        image = image_of(scene * auto.exposure_s * 100.0, model)
        auto.follow(image, ground)
    image = image_of(scene * auto.exposure_s * 100.0, model)
    assert np.mean(image[ground] == 255) < 0.005
    assert np.percentile(image[ground], 99.9) > 230


def test_exposures_of_auto_stay_within_their_bounds():
    model = sensor(exposure_mode='auto', exposure_s=1e-3, auto_lag=0.0, auto_max_s=2e-3)
    auto = AutoExposure(model)
    auto.follow(np.zeros((80, 100), np.uint8))
    assert auto.exposure_s == pytest.approx(2e-3)
    for _ in range(30):
        auto.follow(np.full((80, 100), 255, np.uint8))
    assert auto.exposure_s == pytest.approx(1e-5)


def test_it_starts_from_the_radiance_of_lit_ground():
    """The 92nd percentile of what is lit, the sun itself and deep shadow left out."""
    model = sensor(exposure_mode='auto', auto_max_s=10.0)
    auto = AutoExposure(model)
    rng = np.random.default_rng(4)
    radiance = rng.uniform(30.0, 60.0, (200, 200)).astype(np.float32)
    radiance[:50] = 0.0             # sky
    radiance[50:60] = 0.01          # shadow: a six-thousandth of the ground
    radiance[100, 100:110] = 2e7    # the sun, in ten pixels
    auto.start(radiance)
    ground = radiance[60:]
    expected = auto.aim * model.config.full_well_e / electrons(
        model, np.percentile(ground, 92), 1.0)
    assert auto.started and auto.exposure_s == pytest.approx(expected, rel=1e-3)
    dark = AutoExposure(model)
    dark.start(np.zeros((20, 20), np.float32))
    assert dark.started and dark.exposure_s == model.config.exposure_s
