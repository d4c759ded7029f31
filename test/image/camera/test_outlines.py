"""Outlines without steps: pixels beside an edge get the share that each surface has of them."""

import numpy as np
import pytest

from lunar_rover_sim.base.workers import Workers
from lunar_rover_sim.image.camera.outlines import smooth_outlines

H, W, FINER = 60, 80, 16


def picture(slope, place, near_m=-2.0, far_m=5.0, finer=1):
    """Return radiance and depth of a bright object below a straight line, before dark ground."""
    rows, columns = ((np.arange(n * finer) + 0.5) / finer for n in (H, W))
    below = rows[:, None] > place + slope * columns
    return (np.where(below, 30.0, 2.0).astype(np.float32),
            np.where(below, near_m, far_m).astype(np.float32))


@pytest.mark.parametrize('far_m', [5.0, 0.0])
@pytest.mark.parametrize('slope,left', [(0.07, 0.35), (0.31, 0.35), (-0.2, 0.35), (0.9, 0.7)])
def test_a_straight_outline_is_as_bright_as_its_share(slope, left, far_m):
    """Before ground and the sky, against 16 x 16 samples a pixel; turned by 90 deg, upside down.

    left: of the error with steps; near a diagonal the steps of an outline tell least
    """
    place = 20.3 if slope > 0.0 else 40.3
    radiance, depth = picture(slope, place, far_m=far_m)
    expected = picture(slope, place, finer=FINER)[0].reshape(H, FINER, W, FINER).mean((1, 3))
    edge = (expected > 2.0) & (expected < 30.0)
    stepped = np.sqrt(np.mean((radiance - expected)[edge]**2))
    for turn in (lambda image: image, lambda image: np.ascontiguousarray(image.T),
                 lambda image: np.ascontiguousarray(image[::-1])):
        smooth = turn(radiance).copy()
        smooth_outlines(smooth, turn(depth), 1.0 / 300.0, 1.0)
        error = smooth - turn(expected)
        assert np.sqrt(np.mean(error[turn(edge)]**2)) < left * stepped
        near = np.abs(smooth - turn(radiance)) > 0.0
        assert not near[~(turn(edge) | turn(near_of(edge)))].any()


def near_of(edge):
    """Return the pixels beside those of an edge."""
    grown = edge.copy()
    for axis in (0, 1):
        for shift in (-1, 1):
            grown |= np.roll(edge, shift, axis)
    return grown


def test_ground_that_recedes_has_no_outline():
    """Level ground seen from 0.25 m above, up to the horizon: texture stays as it is."""
    focal, above = 300.0, 0.25
    rows = np.arange(1.0, H + 1)
    depth = np.repeat((focal * above / rows)[:, None], W, axis=1).astype(np.float32)
    texture = np.random.default_rng(0).uniform(1.0, 9.0, (H, W)).astype(np.float32)
    smooth = texture.copy()
    smooth_outlines(smooth, depth, 1.0 / focal, above)
    np.testing.assert_array_equal(smooth, texture)


def test_rows_that_threads_share_are_those_of_one():
    rng = np.random.default_rng(3)
    depth = np.kron(rng.uniform(1.0, 9.0, (30, 12)), np.ones((2, 4))).astype(np.float32)
    whole = rng.uniform(0.0, 1.0, depth.shape).astype(np.float32)
    shared, workers = whole.copy(), Workers(3)
    smooth_outlines(whole, depth, 1.0 / 300.0, 1.0)
    smooth_outlines(shared, depth, 1.0 / 300.0, 1.0, workers)
    workers.release()
    np.testing.assert_array_equal(shared, whole)
