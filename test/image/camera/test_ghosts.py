"""Ghosts of the sun against rays through the lens that they are of."""

import dataclasses
import math

import numpy as np
import pytest
from traced_lens import TracedLens

from lunar_rover_sim.image.camera.stray_light import GHOSTS

FOCAL_PX = 457.0
LENS = TracedLens()
NAMES = ['-'.join(map(str, ghost.surfaces)) for ghost in GHOSTS]


def spread(ghost):
    """Return the standard deviation of the ghost's light along an axis, over the focal length."""
    r = np.linspace(0.0, ghost.reach_px(FOCAL_PX), 2000)
    light = ghost.irradiance(r, FOCAL_PX) * r
    return math.sqrt(0.5 * (light * r**2).sum() / light.sum()) / FOCAL_PX


def test_the_traced_lens_has_an_image():
    """At f/4 a point of the sky is within a pixel, 1 / 457, at 20 deg; the distortion is 1 %."""
    places = LENS.on_sensor(*LENS.rays(20.0, 20_000))
    assert LENS.focal_mm == pytest.approx(22.0, rel=0.01)
    assert places[:, 0].mean() == pytest.approx(math.tan(math.radians(20.0)), rel=0.01)
    assert places.std(axis=0).max() < 1.0 / FOCAL_PX


@pytest.mark.parametrize('ghost', GHOSTS, ids=NAMES)
def test_ghosts_are_where_and_as_wide_as_those_of_the_lens(ghost):
    rays = LENS.rays(8.0, 60_000)
    places = LENS.on_sensor(*rays, pair=ghost.surfaces)
    assert places[:, 0].mean() / math.tan(math.radians(8.0)) == pytest.approx(ghost.place,
                                                                              rel=0.03)
    sharp = dataclasses.replace(ghost, place=0.0)       # rays have no width, as the sun has
    width = math.sqrt((places - places.mean(axis=0)).var(axis=0).mean())
    assert spread(sharp) == pytest.approx(width, rel=0.25 if ghost.edge == ghost.radius else 0.15)


@pytest.mark.parametrize('ghost', GHOSTS, ids=NAMES)
@pytest.mark.parametrize('angle_deg', [2.0, 8.0, 12.0, 20.0, 25.0])
def test_rims_cut_ghosts_off_as_in_the_lens(ghost, angle_deg):
    rays = LENS.rays(angle_deg, 40_000)
    share = len(LENS.on_sensor(*rays, pair=ghost.surfaces)) / len(LENS.on_sensor(*rays))
    angle = math.radians(angle_deg)
    assert ghost.passing(np.array([math.sin(angle), 0.0, math.cos(angle)])) == pytest.approx(
        share, abs=0.13)


@pytest.mark.parametrize('ghost', GHOSTS, ids=NAMES)
@pytest.mark.parametrize('focal_px', [114.0, FOCAL_PX, 1828.0])
def test_a_ghost_sums_to_one_whatever_the_size_of_pixels(ghost, focal_px):
    side = np.arange(-math.ceil(ghost.reach_px(focal_px)), math.ceil(ghost.reach_px(focal_px)) + 1)
    light = ghost.irradiance(np.hypot(side[:, None] + 0.3, side + 0.1), focal_px)
    assert light.sum() == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize('ghost', GHOSTS, ids=NAMES)
def test_the_image_of_the_sun_blurs_the_edge(ghost):
    """A disc blurred by a disc: the width of the edge, four deviations, is at least that of the
    sun's image as the ghost scales it.
    """
    sun_px = abs(ghost.place) * math.radians(0.2665) * FOCAL_PX
    r = np.linspace(0.0, ghost.reach_px(FOCAL_PX), 4000)
    light = ghost.irradiance(r, FOCAL_PX)
    falling = -np.diff(light)
    middle = 0.5 * (r[1:] + r[:-1])
    mean = (falling * middle).sum() / falling.sum()
    deviation = math.sqrt((falling * (middle - mean)**2).sum() / falling.sum())
    assert deviation > 0.5 * sun_px
    assert np.abs(np.diff(light)).max() * 4000 / ghost.reach_px(FOCAL_PX) < light.max() / 1.2


@pytest.mark.parametrize('focal_px', [60.0, 500.0, 2000.0])
def test_variances_of_the_edge_add(focal_px):
    """Of the aberrations, of the disc of the sun across an edge, r^2 / 4, and of a pixel."""
    for ghost in GHOSTS:
        sun_px = abs(ghost.place) * math.radians(0.2665) * focal_px
        deviation2 = (ghost.edge * focal_px)**2 / 5.0 + sun_px**2 / 4.0 + 1.0 / 12.0
        whole = ghost.radius * focal_px
        edge = min(math.sqrt(5.0 * deviation2), whole)
        assert ghost.half_edge_px(focal_px) == pytest.approx(edge, rel=2e-3)
        assert ghost.reach_px(focal_px) == pytest.approx(whole + edge, rel=2e-3)
