"""Soils against what others measured: plates in poppy seeds, footpads and a cone on the Moon."""

import math

import pytest

from lunar_rover_sim.ground.regolith.resistive_force import plate_force_n
from lunar_rover_sim.ground.regolith.soil import PRESETS


@pytest.mark.parametrize(('name', 'down_n', 'aside_n'), [
    ('poppy_loose', 12.7, 4.15), ('poppy_close', 23.2, 5.35)])
def test_plates_in_poppy_seeds(name, down_n, aside_n):
    """10 cm² at a depth of 5 cm: Li, Zhang and Goldman (Science 339, 2013)."""
    soil = PRESETS[name]
    down = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, 0.0, 0.5 * math.pi)[1]
    aside = plate_force_n(soil.shape, soil.zeta_npm3, 1e-3, 0.05, 0.5 * math.pi, 0.0)[0]
    assert down == pytest.approx(down_n, rel=0.01) and aside == pytest.approx(aside_n, rel=0.01)


@pytest.mark.parametrize('depth_m', [0.02, 0.05])
def test_footpads(depth_m):
    """Surveyor 3: 20 to 60 kPa."""
    assert 20e3 <= PRESETS['highland'].zeta_npm3 * depth_m <= 60e3


def test_cone():
    """A penetrometer of Apollo 15 at 16 cm: 348 kPa."""
    assert PRESETS['highland_dense'].zeta_npm3 * 0.16 == pytest.approx(348e3, rel=0.02)
