"""Colours of truth layers mean what the documentation says."""

import numpy as np
import pytest

from lunar_rover_sim.rendering.layer_pictures import flow_picture


@pytest.mark.parametrize('flow,rgb', [
    ((32.0, 0.0), (255, 0, 0)), ((-32.0, 0.0), (0, 255, 255)), ((0.0, 32.0), (128, 255, 0)),
    ((0.0, -32.0), (128, 0, 255)), ((16.0, 0.0), (128, 0, 0)), ((500.0, 0.0), (255, 0, 0)),
    ((0.0, 0.0), (0, 0, 0)), ((np.nan, 1.0), (40, 40, 40))])
def test_flow_of_a_known_scale(flow: tuple[float, float], rgb: tuple[int, ...]) -> None:
    """Right red, down yellow-green, left cyan, up violet; 32 px are full, whatever is around."""
    image = np.full((4, 5, 2), 100.0, np.float32)
    image[1, 2] = flow
    assert np.abs(flow_picture(image, 32.0)[1, 2, ::-1].astype(int) - rgb).max() <= 3
