"""Depth images without a renderer: exact on a plane, or with the errors of real ones."""

import numpy as np
from physics_scene import make_world, ROVER
import pytest
import worlds

from lunar_rover_sim.base.frames import se3
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.stereo.seen_depth import ERROR_PX, SeenDepth, UNMATCHED, WRONG

RANGE_M = 3.0
STANDING = se3(np.eye(3), (0.3, -0.2, 0.1))


def eyes(elevation_deg=40.0, azimuth_deg=0.0, **kwargs):
    return SeenDepth(make_world(), ROVER, CameraConfig(width=640, height=480),
                     SunConfig(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg), 1, **kwargs)


def plane_depth(seen):
    """Return the depth (h, w) of the plane z = 0; NaN beyond the range."""
    T = STANDING @ seen.T_base_camera
    v, u = np.mgrid[0:96, 0:128]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(seen.K).T @ T[:3, :3].T
    depth = np.where(rays[..., 2] < 0.0, -T[2, 3] / rays[..., 2], np.nan)
    return np.where(depth * np.linalg.norm(rays, axis=-1) < 1.3 * RANGE_M, depth, np.nan)


def test_exact_depth_is_that_of_the_plane():
    seen = eyes(exact=True)
    np.testing.assert_allclose(seen.look(STANDING, RANGE_M), plane_depth(seen), rtol=1e-4)
    # Nothing is seen from within half a metre of the edge of the world, looking inwards.
    ahead_m = seen.T_base_camera[0, 3]
    for x, blind in ((-4.51, True), (-4.49, False)):
        depth = seen.look(se3(np.eye(3), (x - ahead_m, 0.0, 0.1)), RANGE_M)
        assert np.isnan(depth).all() == blind


def test_a_place_of_a_site_is_seen_alike_from_two_windows():
    site = Site.of(worlds.world(size_m=25.6, cell_m=0.05))
    windows = [site.window(middle) for middle in ((0.0, 0.0), (12.8, 12.8))]
    z = windows[0].height_at(np.array([6.4, 7.0])) + 0.1
    here, there = (SeenDepth(window, ROVER, CameraConfig(), SunConfig(), 1, exact=True)
                   .look(se3(np.eye(3), (6.4, 7.0, z)), RANGE_M) for window in windows)
    assert np.isfinite(here).mean() > 0.3
    np.testing.assert_allclose(there, here, atol=1e-5)


def test_errors_are_those_of_the_matcher():
    """Of disparities at the baseline of the real image: noise, and both ways some far off."""
    seen = eyes()
    truth = plane_depth(seen)
    scale = 5.0 * seen.K[0, 0] * seen.baseline_m
    errors, found = [], []
    for _ in range(40):
        depth = seen.look(STANDING, RANGE_M)
        assert np.isnan(depth[np.isnan(truth)]).all()
        errors.append((scale / depth - scale / truth)[np.isfinite(truth)])
        found.append(np.isfinite(depth)[np.isfinite(truth)].mean())
    error = np.concatenate(errors)
    error = error[np.isfinite(error)]
    assert np.mean(found) == pytest.approx(1.0 - UNMATCHED, abs=0.02)
    wrong = error[np.abs(error) > 6.0 * ERROR_PX]
    assert len(wrong) / len(error) == pytest.approx(WRONG * (1.0 - 1.5 / 12.0), abs=0.006)
    assert 0.3 < np.mean(wrong > 0.0) < 0.7 and 10.0 < np.abs(wrong).max() < 13.0
    assert np.std(error[np.abs(error) < 4.0 * ERROR_PX]) == pytest.approx(ERROR_PX, rel=0.1)


def test_what_lies_in_shadow_is_not_matched():
    assert np.isnan(eyes(elevation_deg=-0.5).look(STANDING, RANGE_M)).all()
