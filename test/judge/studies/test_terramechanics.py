"""The terramechanics study: what walks cost on soft ground, and its report."""

import dataclasses
import math

import pytest

from lunar_rover_sim.judge.studies.terramechanics import Ground, measure, WalkSettings, write_all
from lunar_rover_sim.rover.physics.config import PhysicsConfig


def settings(duration_s=4.5):
    return WalkSettings(duration_s=duration_s)


def test_soft_ground_costs_more_than_rigid_ground_and_lets_feet_sink():
    rigid, soft = (measure(settings(), Ground(name)) for name in ('rigid', 'highland_loose'))
    assert rigid.outcome == soft.outcome == 'walked'
    assert rigid.speed_mps == pytest.approx(0.12, rel=0.1)
    assert soft.transport > 1.15 * rigid.transport
    assert rigid.sinkage_m == 0.0 and 0.01 < soft.sinkage_m < soft.sinkage_max_m < 0.08


def test_more_pull_than_friction_drags_the_rover_back(tmp_path):
    """Friction is 0.65; what the feet plough holds a little more."""
    walk = measure(settings(4.0), Ground('highland_loose', pull=1.2))
    assert walk.speed_mps < 0.0 and math.isinf(walk.transport)
    text = write_all([walk], tmp_path)
    assert '| highland_loose | 0 | 1.2 | ' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'terramechanics.csv', 'terramechanics.md', 'terramechanics.png']


@pytest.mark.parametrize('name', ['highland_loose', 'highland', 'highland_dense'])
def test_steps_of_1_ms_are_short_enough(name):
    """The same way within 3 % as with a quarter of the step."""
    coarse, fine = (measure(dataclasses.replace(settings(6.0), physics=PhysicsConfig(
        step_s=step_s)), Ground(name)).speed_mps for step_s in (0.001, 0.00025))
    assert coarse == pytest.approx(fine, rel=0.03)


def test_a_slope_on_which_it_cannot_stand_is_a_result():
    walk = measure(settings(), Ground('rigid', slope_deg=60.0))
    assert walk.outcome != 'walked' or walk.speed_mps < 0.0
