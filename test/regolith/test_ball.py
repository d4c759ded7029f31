"""The closed forms of a ball in soil against sums over its facets."""

import numpy as np
import pytest

from lunar_rover_sim.regolith import ball
from lunar_rover_sim.regolith.resistive_force import GENERIC, POPPY_CLOSE

R, ZETA = 0.008, 1.0e6
DEPTHS = (0.0005, 0.003, 0.008, 0.0095, 0.016, 0.03)


@pytest.mark.parametrize('depth', DEPTHS)
def test_bearing_is_the_depth_summed_over_the_projected_cap(depth):
    radius = np.linspace(0.0, R, 20001)
    below = np.maximum(depth - R + np.sqrt(R ** 2 - radius ** 2), 0.0)
    total = ZETA * np.trapezoid(below * 2.0 * np.pi * radius, radius)
    assert ball.bearing_n(depth, R, ZETA) == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize('depth', DEPTHS)
def test_depth_is_the_inverse_of_bearing(depth):
    assert ball.depth_m(ball.bearing_n(depth, R, ZETA), R, ZETA) == pytest.approx(depth, rel=1e-9)


@pytest.mark.parametrize('depth', DEPTHS)
def test_slope_is_the_derivative(depth):
    h = 1e-7
    rise = ball.bearing_n(depth + h, R, ZETA) - ball.bearing_n(depth - h, R, ZETA)
    assert ball.bearing_slope_npm(depth, R, ZETA) == pytest.approx(rise / (2 * h), rel=1e-4)


@pytest.mark.parametrize('depth', DEPTHS)
def test_silhouette_is_the_depth_summed_over_the_upright_section(depth):
    h = np.linspace(0.0, min(depth, 2.0 * R), 200001)
    width = 2.0 * np.sqrt(np.maximum(h * (2.0 * R - h), 0.0))
    assert ball.silhouette_m3(depth, R) == pytest.approx(np.trapezoid((depth - h) * width, h),
                                                         rel=1e-5)


def test_nothing_bears_above_the_surface():
    assert ball.bearing_n(-0.001, R, ZETA) == ball.silhouette_m3(-0.001, R) == 0.0
    assert ball.bearing_slope_npm(-0.001, R, ZETA) == ball.depth_m(-1.0, R, ZETA) == 0.0


def test_a_dragged_ball_bears_between_a_tenth_and_a_half_of_one_pressed_down():
    gamma = np.radians([-60.0, 0.0, 45.0, 90.0])
    for shape in (GENERIC, POPPY_CLOSE):
        for depth in (0.1, 1.0, 2.0):
            lift = ball.swept_bearing(shape, depth, gamma)
            assert lift[0] < 0.1 < lift[1] < 0.5 < lift[2] < lift[3]
            assert lift[3] == pytest.approx(1.0)


def test_a_loaded_tip_digs_in_and_a_light_one_climbs():
    table = ball.DigTable(GENERIC)
    slopes = [table.slope(load, 1.0) for load in np.linspace(0.0, 1.0, 21)]
    assert slopes[0] < 0.0 < slopes[-1]
    assert np.all(np.diff(slopes) >= 0.0)
    # Between them a tip slides on level, where its lift is that of a motion straight forward.
    level = float(ball.swept_bearing(GENERIC, 1.125, np.zeros(1))[0])
    assert table.slope(level, 1.125) == pytest.approx(0.0, abs=0.05)
