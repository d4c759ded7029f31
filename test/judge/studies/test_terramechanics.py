"""The terramechanics study, and grounds on the same worlds."""

import math

import numpy as np
import pytest

from lunar_rover_sim.judge.studies.terramechanics import (compare, comparison_text, Ground,
                                                          measure, plot_comparison, Quantity,
                                                          walk_study, write_all, write_walks)
from lunar_rover_sim.judge.studies.walking import with_physics
from lunar_rover_sim.run.scenario import Scenario

FLAT = Scenario.load('flat')


def test_soft_ground_costs_more_than_rigid_ground_and_lets_feet_sink():
    rigid, soft = (measure(FLAT, Ground(name), duration_s=4.5)
                   for name in ('rigid', 'highland_loose'))
    assert rigid.outcome == soft.outcome == 'walked'
    assert rigid.speed_mps == pytest.approx(0.12, rel=0.1)
    assert soft.transport > 1.15 * rigid.transport
    assert rigid.sinkage_m == 0.0 and 0.01 < soft.sinkage_m < soft.sinkage_max_m < 0.08


def test_more_pull_than_friction_drags_the_rover_back(tmp_path):
    """Friction is 0.65; what the feet plough holds a little more."""
    walk = measure(FLAT, Ground('highland_loose', pull=1.2), duration_s=4.0)
    assert walk.speed_mps < 0.0 and math.isinf(walk.transport)
    text = write_all([walk], tmp_path)
    assert '| highland_loose | 0 | 1.2 | ' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'terramechanics.csv', 'terramechanics.md', 'terramechanics.png']


@pytest.mark.parametrize('name', ['highland_loose', 'highland', 'highland_dense'])
def test_steps_of_1_ms_are_short_enough(name):
    """The same way within 3 % as with a quarter of the step."""
    coarse, fine = (measure(with_physics(FLAT, step_s=step_s), Ground(name),
                            duration_s=6.0).speed_mps for step_s in (0.001, 0.00025))
    assert coarse == pytest.approx(fine, rel=0.03)


def test_a_slope_on_which_it_cannot_stand_is_a_result():
    walk = measure(FLAT, Ground('rigid', slope_deg=60.0), duration_s=4.5)
    assert walk.outcome != 'walked' or walk.speed_mps < 0.0


VALUE = Quantity('value', lambda result: result, 1)


def test_pairs_show_what_worlds_hide():
    """A shift of 1 beneath differences of 10 between worlds; values that are missing drop out."""
    worlds = np.random.default_rng(4).normal(0.0, 10.0, 12)
    shifted = worlds + 1.0 + 0.01 * np.arange(12)
    shifted[5] = math.inf
    first, second = compare({'rigid': worlds, 'soft': shifted}, [VALUE])
    assert first.difference is None and math.isnan(first.p) and first.estimate.count == 12
    assert second.difference.count == second.estimate.count == 11
    assert 1.0 < second.difference.low < second.difference.high < 1.12
    assert second.p == pytest.approx(2.0 / 2 ** 11)     # all of one sign: exact
    same = compare({'rigid': worlds, 'soft': worlds}, [VALUE])[1]
    assert same.p == 1.0 and same.difference.value == 0.0


def test_a_share_stays_within_0_and_1_and_every_p_is_corrected(tmp_path):
    stops = Quantity('stops', lambda result: float(result > 10.0), share=True)
    worlds = np.random.default_rng(4).normal(0.0, 5.0, 8)
    results = {'rigid': worlds, 'soft': worlds + 1.0, 'loose': worlds + 20.0}
    compared = compare(results, [VALUE, stops])
    loose = compared[-1]
    assert loose.estimate.high == 1.0 and 0.6 < loose.estimate.low < 1.0
    assert loose.p == pytest.approx(2.0 / 2 ** 8)       # McNemar: all eight changed one way
    text = comparison_text(compared, 'rigid')
    # Of four tests three have p = 2 / 2^8, so their q is 4 / 3 of it.
    assert text.count('| 0.0078 | 0.01 |') == 3
    plot_comparison(results, [VALUE, stops], tmp_path / 'figure.png')
    assert (tmp_path / 'figure.png').stat().st_size > 5000


def test_walks_on_several_grounds_are_pairs(tmp_path):
    walks = walk_study(FLAT, ['rigid', 'highland_loose'], [0.12], [2], duration_s=4.2)
    rigid, loose = walks[0.12].values()
    assert len(rigid) == len(loose) == 1 and rigid[0].speed_mps != loose[0].speed_mps
    assert all(w.outcome == 'walked' for w in (*rigid, *loose))
    assert loose[0].sinkage_m > 0.01 and loose[0].transport > rigid[0].transport
    text = write_walks(walks, tmp_path)
    assert '## 0.12 m/s' in text and '| slip [%] | highland_loose |' in text
    assert (tmp_path / 'grounds_0.12.png').exists()
