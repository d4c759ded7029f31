"""A rover that lies on its side or back has tipped over, once."""

import numpy as np
import pytest

from lunar_rover_sim.physics.tip_over import TipOver


def rolled(angle_deg: float, heading_deg: float = 0.0) -> np.ndarray:
    """Return an orientation wxyz: heading about z, then roll about the own x axis."""
    c, s = np.cos(np.radians(heading_deg) / 2), np.sin(np.radians(heading_deg) / 2)
    cr, sr = np.cos(np.radians(angle_deg) / 2), np.sin(np.radians(angle_deg) / 2)
    return np.array([c * cr, c * sr, s * sr, s * cr])


@pytest.mark.parametrize('heading_deg', [0.0, 130.0, -75.0])
@pytest.mark.parametrize('roll_deg', [0.0, 30.0, -69.0, 75.0, 120.0, 180.0])
def test_the_tilt_is_that_of_the_vertical_axis(roll_deg: float, heading_deg: float) -> None:
    """It does not depend on the heading."""
    tip_over = TipOver()
    assert tip_over.has_begun(rolled(roll_deg, heading_deg)) == (abs(roll_deg) > 70.0)
    assert tip_over.tilt_deg == pytest.approx(abs(roll_deg), abs=1e-5)
    assert tip_over.lies == (abs(roll_deg) > 70.0)


def test_rocking_on_the_side_is_one_tip_over() -> None:
    """Only a rover that stood again can tip over again."""
    tip_over = TipOver()
    begun = [tip_over.has_begun(rolled(deg)) for deg in (60, 95, 65, 95, 50, 71, 20, 60, 71)]
    assert begun == [False, True, False, False, False, False, False, False, True]
