"""A spoke in soil: tip and rod together."""

from __future__ import annotations

import dataclasses

import pytest

from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.regolith.spoke import SpokeInSoil

RADIUS_M, ROD_M = 0.012, 0.004


@pytest.mark.parametrize('lean', [0.0, 0.4])
@pytest.mark.parametrize('depth_m', [0.003, 0.02, 0.05])
def test_the_slope_is_the_derivative_of_what_soil_bears(depth_m, lean):
    """Above and below the depth from which the rod is in the soil."""
    spoke = SpokeInSoil(PhysicsConfig().ground.soil(1.62), RADIUS_M, ROD_M)
    h = 1e-6
    slope = (spoke.bears_n(depth_m + h, lean) - spoke.bears_n(depth_m - h, lean)) / (2.0 * h)
    assert spoke.slope_npm(depth_m, lean) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize('depth_m', [0.003, 0.011, 0.013, 0.03])
def test_the_slope_of_cohesive_soil(depth_m):
    """The area below the tip grows up to its equator, 12 mm deep."""
    soil = dataclasses.replace(PhysicsConfig().ground.soil(1.62), cohesion_pa=2000.0)
    spoke = SpokeInSoil(soil, RADIUS_M, ROD_M)
    assert spoke.bears_n(depth_m, 0.2) > SpokeInSoil(
        dataclasses.replace(soil, cohesion_pa=0.0), RADIUS_M, ROD_M).bears_n(depth_m, 0.2)
    h = 1e-6
    slope = (spoke.bears_n(depth_m + h, 0.2) - spoke.bears_n(depth_m - h, 0.2)) / (2.0 * h)
    assert spoke.slope_npm(depth_m, 0.2) == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize('part', [1.0, 0.4])
@pytest.mark.parametrize('depth_m', [0.004, 0.02, 0.05])
def test_soil_yields_until_it_bears_the_elastic_force(depth_m, part):
    """A step of the simulation deeper than what held before."""
    soil = PhysicsConfig().ground.soil(1.62)
    spoke = SpokeInSoil(soil, RADIUS_M, ROD_M)
    plastic, bears = spoke.yielded(depth_m, 0.9 * depth_m, soil.elastic_npm, part, 0.3)
    assert bears == pytest.approx(part * spoke.bears_n(plastic, 0.3))
    assert soil.elastic_npm * (depth_m - plastic) == pytest.approx(bears, rel=1e-3, abs=1e-3)
