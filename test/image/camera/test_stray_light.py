"""Light that strays in lens and hood, and what the axis of a camera sees."""

import dataclasses
import math

import camera_scene as scene
import numpy as np
import pytest

from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig
from lunar_rover_sim.image.camera.distortion import distort, is_invertible
from lunar_rover_sim.image.camera.encoding import encoding_of
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera, FisheyeLens, geometry_of
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig, HazardConfig
from lunar_rover_sim.image.camera.image_geometry import PinholeImage
from lunar_rover_sim.image.camera.lens import Lens
from lunar_rover_sim.image.camera.rig import PinholeCamera, StereoRig
from lunar_rover_sim.image.camera.stray_light import ImagedSun, StrayLight

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
    found = [lens.passed_on(images[side], depth[side].astype(np.float32), sun, *given)
             for side, given in ((0, ()), (1, (1,)))]       # the left one unless told otherwise
    return np.stack(found).astype(float)


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


def test_stray_light_is_in_proportion_to_the_light():
    """Down to a faint one; from behind the camera none comes in."""
    images = np.zeros((2, 240, 320))
    images[:, 100:150, 110:180] = 20.0
    bright, faint = (passed(LensConfig(), share * images, sun_at(80.2, 60.9, (share * E,) * 2))
                     for share in (1.0, 1e-5))
    np.testing.assert_allclose(faint * 1e5, bright, rtol=1e-4, atol=1e-3)
    lens = Lens(LensConfig(), CAMERA)
    for z in (0.0, -0.1, -1.0):
        direction = np.array([0.1, 0.0, z])
        assert lens.beyond_rad(direction) == math.inf and lens.hood(direction) == 0.0


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


WIDE = CameraConfig(width=300, height=200, horizontal_fov_deg=80.0)


@pytest.mark.parametrize('camera', [PinholeCamera(WIDE), FisheyeCamera(HazardCameraConfig(
    width=300, height=200, horizontal_fov_deg=150.0, image_circle_deg=170.0))])
def test_the_axis_hits_the_middle_of_the_image(camera):
    """The centre of the upper left pixel is (0, 0), so the middle of 300 x 200 is (149.5, 99.5).
    """
    axis = np.array([0.0, 0.0, 2.0])
    for matrix in (camera.K, camera.P_left[:, :3]):
        pixel = matrix @ axis
        assert (pixel / pixel[2]).tolist() == [149.5, 99.5, 1.0]
    assert camera.K[0, 0] == camera.K[1, 1] == camera.focal_px and camera.K[0, 1] == 0.0
    assert camera.K[2].tolist() == [0.0, 0.0, 1.0] and camera.K[1, 0] == 0.0
    assert camera.P_left[:, 3].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(camera.R, np.eye(3))
    assert camera.falloff([149.5, 99.5]) == pytest.approx(1.0)
    # Half a pixel beyond the last one lies the edge.
    left, right = camera.falloff([[-0.5, 99.5], [299.5, 99.5]])
    assert left == pytest.approx(right) and left < 1.0


def test_rays_of_a_pinhole_fall_by_the_fourth_power():
    camera = PinholeCamera(WIDE)
    rays = camera.rays()
    assert rays.shape == (200, 300, 3) and (rays[..., 2] == 1.0).all()
    cosine = 1.0 / np.linalg.norm(rays, axis=-1)
    u, v = np.meshgrid(np.arange(300.0), np.arange(200.0))
    np.testing.assert_allclose(camera.falloff(np.stack([u, v], axis=-1)), cosine**4)
    np.testing.assert_allclose(rays @ camera.K.T, np.stack([u, v, 1.0 + 0.0 * u], axis=-1))


def lenses(**values):
    config = LensConfig(hood_deg=20.0, **values)
    return [Lens(config, WIDE), FisheyeLens(config, HazardCameraConfig(
        width=300, height=200, horizontal_fov_deg=90.0, image_circle_deg=120.0))]


@pytest.mark.parametrize('which', [0, 1])
def test_the_hood_falls_smoothly_from_the_edge_on(which):
    """1 at the edge, a half in the middle, 0 at its end; without a kink at either end."""
    lens = lenses()[which]
    corner = math.radians(40.0) if which == 0 else min(
        math.hypot(150.0, 100.0) / (150.0 / math.radians(45.0)), math.radians(60.0))
    hood = math.radians(20.0)
    for share, value in ((-1.0, 1.0), (0.0, 1.0), (0.25, 0.84375), (0.5, 0.5), (0.75, 0.15625),
                         (1.0, 0.0), (1.5, 0.0)):
        assert lens.hood(towards(corner + share * hood)) == pytest.approx(value)
        light = towards(corner + (share + 0.01) * hood)
        assert lens.strays(light) == (share < 0.99)
    assert lens.strays(np.array([0.0, 0.0, 1.0 + 1e-12]))
    assert not lens.strays(np.array([0.0, 0.0, -1.0 - 1e-12]))
    if which == 0:      # as far above the frame, whose rows end earlier
        edge = math.atan(100.0 / (150.0 / math.tan(math.radians(40.0))))
        above = towards(edge + 0.5 * hood)[[1, 0, 2]]
        assert lens.hood(above) == pytest.approx(0.5)


def towards(angle_rad):
    """Return the unit vector to the right of the axis by an angle."""
    return np.array([math.sin(angle_rad), 0.0, math.cos(angle_rad)])


def test_nothing_strays_in_a_perfect_lens():
    """What strays is missing where it belongs."""
    for lens in lenses(scatter_share=0.0, veil_share=0.0):
        assert lens.perfect and lens.direct_share == 1.0
        assert not lens.strays(np.array([0.0, 0.0, 1.0]))
    for values in ({'scatter_share': 0.0, 'veil_share': 0.01}, {'scatter_share': 0.02,
                                                                'veil_share': 0.0}):
        for lens in lenses(**values):
            assert not lens.perfect and lens.direct_share == 1.0 - sum(values.values())


def test_light_from_behind_passes_no_hood():
    """A pinhole camera sees less than 90 deg to each side, whatever its hood."""
    lens = Lens(LensConfig(hood_deg=90.0), WIDE)
    assert lens.hood(towards(math.radians(89.9))) > 0.0
    assert lens.hood(towards(math.radians(90.1))) == 0.0


@pytest.mark.parametrize('exponent', [1.55, 1.9999, 2.0, 2.5])
def test_scattered_light_adds_up_to_its_share(exponent):
    """Over all directions in front of a pinhole, of light on its axis."""
    lens = Lens(LensConfig(scatter_share=0.02, scatter_exponent=exponent), WIDE)
    d = np.geomspace(1e-7, 1.0, 200_001)
    total = np.trapezoid(lens.scatter(d) * 2.0 * np.pi * d, d)
    assert total == pytest.approx(0.02, rel=1e-3)
    core = math.radians(lens.config.scatter_core_deg)
    assert lens.scatter(core) / lens.scatter_peak == pytest.approx(2.0**(-0.5 * exponent))


@pytest.mark.parametrize('slope,valid', [(0.06, True), (0.04, False)])
def test_a_lens_must_stretch_the_image_by_a_twentieth(slope, valid):
    """The area of what r + k r^3 makes of a patch is (1 + k r^2) (1 + 3 k r^2)."""
    half = 0.5
    # At the corner of the image, r = ideal radius there, by the quadratic in k r^2.
    x = (-4.0 + math.sqrt(16.0 - 12.0 * (1.0 - slope))) / 6.0
    ideal = math.sqrt(2.0) * half / (1.0 + x)
    lens = (x / ideal**2, 0.0, 0.0, 0.0, 0.0)
    assert np.hypot(*distort([ideal, 0.0], lens)) == pytest.approx(math.sqrt(2.0) * half)
    assert is_invertible(lens, half, half) == valid


def test_encodings_and_models_follow_from_what_is_given():
    for kind, shape, name in (('uint8', (2, 3), 'mono8'), ('uint16', (2, 3), 'mono16'),
                              ('uint8', (2, 3, 3), 'rgb8'), ('float32', (2, 3), '32FC1'),
                              ('float32', (2, 3, 2), '32FC2'), ('float32', (2, 3, 3), '32FC3')):
        assert encoding_of(np.zeros(shape, kind)) == name
    assert isinstance(geometry_of(HazardConfig()), FisheyeCamera)
    pinhole = HazardConfig(camera=HazardCameraConfig(model='pinhole', horizontal_fov_deg=100.0))
    assert isinstance(geometry_of(pinhole), PinholeCamera)
    assert geometry_of(pinhole).focal_px == pytest.approx(160.0 / math.tan(math.radians(50.0)))
