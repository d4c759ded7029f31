"""The sensor: flat fields give back what was configured."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
from scipy import ndimage

from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.camera.sensor import ImageSensor, SensorModel

CAMERA = CameraConfig(width=320, height=240)
RIG = StereoRig(scene.ROVER, CAMERA)
# mono16 at 16 bits, so that the converter adds next to no noise of its own.
RAW = SensorConfig(encoding='mono16', bits=16, vignetting=0.0)


def flat(config, electrons, frame=0, seed=3, exposure_s=1e-3):
    """Return the (2, h, w) pair of a flat field of so many electrons."""
    sensor = SensorModel(CAMERA, config)
    radiance = electrons / (sensor.electrons_per_radiance_second * exposure_s)
    image = np.full((CAMERA.height, CAMERA.width), radiance, np.float32)
    chip = ImageSensor(RIG, sensor, seed)
    return np.stack([chip.pixels(image, side, exposure_s, frame) for side in (0, 1)])


def test_photon_transfer_curve():
    """Gain, read noise and full well within 2 % (EMVA 1288: variance of pairs over mean)."""
    config = dataclasses.replace(RAW, read_noise_e=25.0, dark_current_e_s=0.0)
    means, variances = [], []
    for electrons in (0.0, 500.0, 2000.0, 8000.0, 16000.0, 24000.0, 32000.0):
        pairs = [flat(config, electrons, frame).astype(float) for frame in range(6)]
        means.append(np.mean(pairs))
        variances.append(np.mean([np.var(a - b) / 2 for a, b in zip(pairs[::2], pairs[1::2])]))
    means, variances = np.array(means), np.array(variances)
    gain, dark = np.polyfit(means[1:] - means[0], variances[1:], 1)
    model = SensorModel(CAMERA, config)
    assert gain == pytest.approx(model.gain_dn_per_e, rel=0.02)
    assert np.sqrt(variances[0]) / gain == pytest.approx(config.read_noise_e, rel=0.02)
    assert np.sqrt(dark) / gain == pytest.approx(config.read_noise_e, rel=0.15)
    # Full scale is the full well.
    saturated = flat(config, 3.0 * config.full_well_e)
    assert saturated.min() == saturated.max() == 65535
    assert (65535 - means[0]) / gain == pytest.approx(config.full_well_e, rel=0.02)


def test_fixed_pattern():
    config = dataclasses.replace(RAW, shot_noise=False, read_noise=False, dsnu_e=0.0, prnu=0.01)
    image = flat(config, 20000.0).astype(float)
    signal = image - config.black_level * 65535
    assert signal.std() / signal.mean() == pytest.approx(0.01, rel=0.02)
    assert np.array_equal(image, flat(config, 20000.0, frame=7))
    other = flat(config, 20000.0, seed=4)
    assert abs(np.corrcoef(image.ravel(), other.ravel().astype(float))[0, 1]) < 0.02


def test_noise_is_seeded_and_independent():
    a = flat(RAW, 5000.0, frame=1).astype(float)
    assert np.array_equal(a, flat(RAW, 5000.0, frame=1))
    quiet = dataclasses.replace(RAW, fixed_pattern=False)
    b, c = (flat(quiet, 5000.0, frame=k).astype(float) for k in (1, 2))

    def correlation(x, y):
        return abs(np.corrcoef(x.ravel(), y.ravel())[0, 1])
    # 76,800 pixels: three standard deviations of chance are 0.011.
    assert correlation(b[0], b[1]) < 0.011
    assert correlation(b[0], c[0]) < 0.011
    assert correlation(b[0][:, 1:], b[0][:, :-1]) < 0.011
    assert correlation(b[0][1:], b[0][:-1]) < 0.011


def test_noise_is_gaussian():
    quiet = dataclasses.replace(RAW, fixed_pattern=False)
    x = flat(quiet, 10000.0).astype(float).ravel()
    x = (x - x.mean()) / x.std()
    assert abs(np.mean(x**3)) < 0.03
    assert np.mean(x**4) == pytest.approx(3.0, abs=0.08)


def test_switches_make_an_ideal_image():
    config = dataclasses.replace(scene.IDEAL, encoding='mono8', bits=12, companding='linear')
    image = flat(config, 0.5 * config.full_well_e)
    assert image.min() == image.max() == 128 or image.max() == 127


def test_companding_is_the_root_of_the_signal():
    config = dataclasses.replace(scene.IDEAL, black_level=0.01)
    sensor = SensorModel(CAMERA, config)
    for share in (0.0, 0.01, 0.2, 0.5, 0.9):
        image = flat(config, share * config.full_well_e)
        assert image[0, 0, 0] == pytest.approx(255 * share**0.5, abs=1.0)
        assert sensor.linear(image)[0, 0, 0] == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize('bits,levels', [(8, 256), (10, 1024), (12, 4096)])
def test_converter_resolution(bits, levels):
    config = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=bits)
    values = np.unique([flat(config, e)[0, 0, 0] for e in np.linspace(0, 400, 60)])
    assert np.all(values % (65536 // levels) == 0)


def test_vignetting_is_cos4():
    config = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, vignetting=1.0)
    image = flat(config, 30000.0)[0].astype(float)
    corner = np.array([0 - RIG.K[0, 2], 0 - RIG.K[1, 2]]) / RIG.K[0, 0]
    assert image[0, 0] / image[120, 160] == pytest.approx((1 + corner @ corner)**-2, rel=1e-3)


def spot(config, electrons):
    """Return the left image [electrons] of a single bright pixel in column 150, row 100."""
    sensor = SensorModel(CAMERA, config)
    values = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    values[100, 150] = electrons / (sensor.electrons_per_radiance_second * 1e-3)
    return ImageSensor(RIG, sensor, 0).pixels(values, 0, 1e-3, 0) / sensor.gain_dn_per_e


def test_point_spread_keeps_energy_and_width():
    config = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, psf_sigma_px=0.6)
    image = spot(config, 40000.0)
    assert image.sum() == pytest.approx(40000.0, rel=1e-3)
    offset = np.arange(CAMERA.width) - 150
    assert (image.sum(axis=0) * offset**2).sum() / image.sum() == pytest.approx(0.36, rel=0.01)


def test_a_pixel_holds_what_its_well_holds():
    """With less than the converter's full scale, saturated pixels are not white."""
    config = dataclasses.replace(RAW, pixel_well=0.8, fixed_pattern=False, black_level=0.0)
    image = flat(config, 3.0 * config.full_well_e)
    assert image.min() == image.max() == pytest.approx(0.8 * 65535, abs=2)


def test_the_point_spread_is_that_of_five_taps_up_to_the_borders():
    """What lies beyond a border is what lies at it."""
    config = dataclasses.replace(scene.IDEAL, encoding='mono16', bits=16, psf_sigma_px=0.5)
    sensor = SensorModel(CAMERA, config)
    electrons = np.random.default_rng(2).uniform(0.0, 30000.0, (CAMERA.height, CAMERA.width))
    image = ImageSensor(RIG, sensor, 0).pixels(
        (electrons / (sensor.electrons_per_radiance_second * 1e-3)).astype(np.float32), 0, 1e-3, 0)
    weight = sensor.neighbour_weight
    taps = np.array([[0.0, weight, 0.0], [weight, 1.0, weight], [0.0, weight, 0.0]])
    expected = ndimage.convolve(electrons, taps / taps.sum(), mode='nearest')
    np.testing.assert_allclose(image / sensor.gain_dn_per_e, expected, atol=2.0)
