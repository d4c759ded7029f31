"""The terramechanics study: what walks cost on soft ground, and its report."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.ground.regolith.soil import PRESETS
from lunar_rover_sim.judge.studies import sandbot, terramechanics_report
from lunar_rover_sim.judge.studies.terramechanics import Ground, GroundWalk, measure, WalkSettings
from lunar_rover_sim.judge.studies.terramechanics_anchors import (Anchor, compared, plates,
                                                                  slide_mmps)


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
    anchors = [Anchor('a name', 3.0, 1.0, 2.0, 'mm', 'a source')]
    text = terramechanics_report.write_all(anchors, [walk], tmp_path)
    assert '| a name | 3 mm | 1 to 2 | **no** | a source |' in text
    assert '| highland_loose | 0 | 1.2 | ' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'sandbot.png', 'terramechanics.csv', 'terramechanics.md', 'terramechanics.png']


def test_a_rover_that_tumbles_slides_without_end():
    assert slide_mmps(settings(), 'highland_dense', 58.0) == math.inf


def test_plates_hold():
    assert len(plates()) >= 7 and all(anchor.holds for anchor in plates())


def test_machines_that_are_not_this_one_are_compared_and_not_held_to():
    walks = [GroundWalk(Ground('highland', slope), 'walked', 0.1, slip=slip)
             for slope, slip in ((0.0, 0.02), (20.0, 0.1), (25.0, 0.6))]
    walks.append(GroundWalk(Ground('highland', pull=0.7), 'walked', 0.05, slip=0.2))
    _, slope, pull = found = compared(walks)
    assert (slope.measured, pull.measured) == (20.0, 20.0) and not any(a.held for a in found)
    assert '| as there | wheel of' in terramechanics_report.report_text(found, walks)


def test_sandbot_walks_faster_and_then_swims():
    """The step is a chord; hard ground gives 0.6 m/s at 30 rad/s; loose seeds let it sink."""
    loose = sandbot.curve_mps('poppy_loose', sandbot.CLegs(start_s=0.1))
    best = int(loose.argmax())
    assert 5.0 < sandbot.FREQUENCIES_RADPS[best] < 25.0 and loose[-1] == 0.0
    close = sandbot.curve_mps('poppy_close', sandbot.CLegs(start_s=0.1))
    assert np.all(close >= loose) and close[-1] > 2.0 * loose[best]
    hard = PRESETS['poppy_close'].under(9.81)
    hard = dataclasses.replace(hard, zeta_npm3=1e3 * hard.zeta_npm3)
    assert sandbot.speeds_mps(hard, sandbot.CLegs(), np.array([30.0])) == pytest.approx(
        [0.6], rel=0.1)
    # What a half circle bears: less than a flat plate of its width in its place.
    legs = sandbot.CLegs()
    flat = 0.254e6 * legs.width_m * 2.0 * legs.radius_m * 0.0355
    assert 0.3 * flat < sandbot.lift_n(PRESETS['poppy_loose'], legs, 0.0355) < 0.9 * flat


def test_a_slope_on_which_it_cannot_stand_is_a_result():
    walk = measure(settings(), Ground('rigid', slope_deg=60.0))
    assert walk.outcome != 'walked' or walk.speed_mps < 0.0
