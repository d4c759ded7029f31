"""Stray light of the lens: conserved, of the form that is configured, and the same in both eyes.
"""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.camera.image_geometry import PinholeImage
from lunar_rover_sim.camera.lens import Lens
from lunar_rover_sim.camera.rig import StereoRig
from lunar_rover_sim.camera.stray_light import ImagedSun, StrayLight

CAMERA = CameraConfig(width=320, height=240)
RIG = StereoRig(scene.ROVER, CAMERA)
RAYS = RIG.rays()
COS4 = (RAYS**2).sum(axis=-1)**-2
E = 1361.0


def passed(config, images, sun=None, sky=None):
    """Return the (2, h, w) radiance behind the lens of (2, h, w) images.

    sky: (2, h, w) where it is; by default nowhere
    """
    h, w = CAMERA.height, CAMERA.width
    images = np.asarray(images, np.float32)
    depth = np.where(np.zeros((2, h, w), bool) if sky is None else sky, 0.0, 2.0)
    lens = StrayLight(Lens(config, CAMERA), PinholeImage(RIG.K, w, h), E)
    return np.stack([lens.passed_on(images[side], depth[side].astype(np.float32), sun, side)
                     for side in (0, 1)]).astype(float)


def sun_at(x_px, y_px, irradiance=(E, E)):
    ray = np.linalg.inv(RIG.K) @ [x_px, y_px, 1.0]
    return ImagedSun(ray / np.linalg.norm(ray), np.array(irradiance))


# Steep enough that next to nothing leaves the image.
STEEP = LensConfig(scatter_share=0.2, scatter_exponent=4.0, scatter_core_deg=1.5, veil_share=0.05)


def test_extended_light_is_conserved():
    images = np.zeros((2, 240, 320))
    images[0, 96:160, 128:224] = 40.0
    images[1, 100:150, 110:180] = 20.0
    out = passed(STEEP, images)
    for before, after in zip(images, out):
        assert (after * COS4).sum() == pytest.approx((before * COS4).sum(), rel=0.01)
    assert out[0, 130, 170] < 40.0      # what strays is missing


def test_the_earth_in_the_sky_has_no_glare():
    """Cells are coarser than its disc, and it may be brighter than the ground by far at night."""
    images = np.zeros((2, 240, 320))
    images[:, 40:60, 100:120] = 200.0
    out = passed(STEEP, images, sky=images > 0.0)
    assert not out[images == 0.0].any()
    assert out[images > 0.0] == pytest.approx(200.0 * (1.0 - 0.25))


@pytest.mark.parametrize('ghosts', [0.0, 1.0])
def test_sunlight_is_conserved(ghosts):
    """What is missing of the disc is around it, in the veil, and in ghosts."""
    config = dataclasses.replace(STEEP, ghost_share=ghosts)
    sun = sun_at(170.3, 100.8)
    after = passed(config, np.zeros((2, 240, 320)), sun)
    # On the sensor the sun has the irradiance E cos(angle) times the square of the focal length.
    whole = E * sun.direction[2] * RIG.focal_px**2
    assert (after * COS4).sum(axis=(1, 2)) == pytest.approx([0.25 * whole] * 2, rel=0.01)
    if ghosts:
        assert after[0].max() == pytest.approx(after[1].max())
        assert after[0, 5, 5] < 1e-3 * after[0, 138, 149]     # no veil; a ghost across the middle


def test_scattered_sunlight_has_the_form_of_the_lens():
    config = LensConfig(veil_share=0.0)
    lens, sun = Lens(config, CAMERA), sun_at(80.2, 60.9)
    after = passed(config, np.zeros((2, 240, 320)), sun)
    directions = RAYS / np.linalg.norm(RAYS, axis=-1, keepdims=True)
    apart = np.linalg.norm(directions[..., :2] - sun.direction[:2], axis=-1)
    error = after[0] / (E * sun.direction[2] * lens.scatter(apart)) - 1.0
    assert np.abs(error).max() < 0.06 and np.abs(error).mean() < 0.01
    np.testing.assert_allclose(after[0], after[1], rtol=1e-4)


def test_the_glare_of_each_eye_is_its_own():
    sun = sun_at(80.2, 60.9, (E, 0.25 * E))
    both = passed(LensConfig(), np.zeros((2, 240, 320)), sun)
    np.testing.assert_allclose(both[1], 0.25 * both[0], rtol=1e-4)


def test_the_sun_itself_is_left_out_of_extended_glare():
    """Its glare follows from what is seen of it, not from its pixels a million times as bright."""
    images = np.zeros((2, 240, 320))
    images[:, 60:64, 80:84] = 2e7
    after = passed(LensConfig(), images)
    assert after[0, 200, 300] < 1e-2
    assert after[0, 61, 81] == pytest.approx(2e7 * 0.9974, rel=1e-4)


def test_a_perfect_lens_changes_nothing():
    images = np.random.default_rng(0).uniform(0.0, 30.0, (2, 240, 320)).astype(np.float32)
    config = LensConfig(scatter_share=0.0, veil_share=0.0)
    np.testing.assert_array_equal(passed(config, images, sun_at(1.0, 1.0)), images)


@pytest.mark.parametrize('exponent', [1.2, 1.55, 2.0, 3.0])
def test_all_directions_share_what_is_scattered(exponent):
    lens = Lens(LensConfig(scatter_exponent=exponent), CAMERA)
    d = np.geomspace(1e-7, 1.0, 200001)
    total = np.trapezoid(2.0 * np.pi * d * lens.scatter(d), d) if hasattr(np, 'trapezoid') \
        else np.trapz(2.0 * np.pi * d * lens.scatter(d), d)
    assert total == pytest.approx(lens.config.scatter_share, rel=1e-3)


def test_scattered_sunlight_ends_nowhere_in_the_image():
    """The sun stands beyond the edge, 0.4 to 1.4 from the directions of a row of dark sky."""
    sun = sun_at(-200.0, 100.0)
    config = LensConfig(hood_deg=60.0, veil_share=0.0)
    after = passed(config, np.zeros((2, 240, 320)), sun)[0]
    directions = RAYS / np.linalg.norm(RAYS, axis=-1, keepdims=True)
    apart = np.linalg.norm(directions[..., :2] - sun.direction[:2], axis=-1)
    assert apart[100, 0] < 0.7 and apart[100, -1] > 1.2
    assert np.all(np.diff(np.log(after[100])) < 0.0) and np.diff(np.log(after[100])).min() > -0.02


def test_the_default_lens_is_the_measured_one():
    """The fit of Alam et al. for an IDS camera, G(r) = b exp(-a r^c) per pixel and core of 97.9.

    Its 1936 pixels across were taken as the default field of view, 640 pixels across.
    """
    lens = Lens(LensConfig(), CameraConfig())
    for radius in (2.0, 5.0, 10.0, 30.0, 100.0, 300.0):
        r = radius * 1936.0 / 640.0
        measured = 1.1503e19 * np.exp(-51.9673 * r**0.0271011) / 97.8896 * (1936.0 / 640.0)**2
        ours = lens.scatter(radius / lens.camera.focal_px) / lens.camera.focal_px**2
        assert ours == pytest.approx(measured, rel=0.4)


def test_the_hood_cuts_smoothly():
    lens = Lens(LensConfig(hood_deg=12.0), CAMERA)
    edge = np.arctan2(0.5 * CAMERA.width, CAMERA.focal_px)
    angles = edge + np.radians(np.linspace(-5.0, 20.0, 251))
    shares = np.array([lens.hood(np.array([np.sin(a), 0.0, np.cos(a)])) for a in angles])
    assert np.all(shares[angles <= edge] == 1.0)
    assert np.all(shares[angles > edge + np.radians(12.01)] == 0.0)
    assert np.all(np.diff(shares) <= 0.0) and np.abs(np.diff(shares)).max() < 0.02
    sharp = Lens(LensConfig(hood_deg=0.0), CAMERA)
    assert sharp.hood(np.array([np.sin(edge + 1e-6), 0.0, np.cos(edge + 1e-6)])) == 0.0
