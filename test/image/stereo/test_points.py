"""Points of a cloud: they project to their pixels, at their depth."""

import numpy as np

from lunar_rover_sim.image.stereo.depth import grey, points_from_depth

K = np.array([[50.0, 0.0, 15.5], [0.0, 60.0, 11.5], [0.0, 0.0, 1.0]])


def test_points_project_to_their_pixels() -> None:
    """Pinhole forwards gives row and column back; depth is z."""
    depth = np.random.default_rng(1).uniform(0.5, 9.0, (24, 32)).astype(np.float32)
    points = points_from_depth(depth, K)
    assert points.shape == (24, 32, 3) and points.dtype == np.float32
    pixels = points @ K.T.astype(np.float32)
    v, u = np.mgrid[:24, :32]
    assert np.allclose(pixels[..., 0] / pixels[..., 2], u, atol=1e-4)
    assert np.allclose(pixels[..., 1] / pixels[..., 2], v, atol=1e-4)
    assert np.array_equal(points[..., 2], depth)
    # Right and below are positive in the optical frame.
    assert points[0, 31, 0] > 0 > points[0, 0, 0] and points[23, 0, 1] > 0 > points[0, 0, 1]


def test_unknown_and_infinite_depth_is_nan() -> None:
    """All three coordinates, as stereo_image_proc has it."""
    depth = np.full((2, 3), 2.0, np.float32)
    depth[0, 1], depth[1, 2] = np.nan, np.inf
    unknown = np.isnan(points_from_depth(depth, K))
    assert unknown[0, 1].all() and unknown[1, 2].all()
    assert unknown.sum() == 6


def test_grey_is_brightness() -> None:
    """Grey images stay; colours are weighed as OpenCV does."""
    image = np.zeros((2, 2, 3), np.uint8)
    image[..., 1] = 100
    assert np.all(grey(image) == 59)
    assert grey(image[..., 0]) is not None and grey(image[..., 1])[0, 0] == 100
