"""The terramechanics study: what walks cost on soft ground, and its report."""

import math

import pytest

from lunar_rover_sim.errors import ConfigError
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.studies import terramechanics_report
from lunar_rover_sim.studies.terramechanics import Ground, measure, WalkSettings
from lunar_rover_sim.studies.terramechanics_anchors import Anchor, plates


def settings(duration_s=4.5):
    return WalkSettings(GaitCalibration.of(GaitConfig()), duration_s=duration_s)


def test_soft_ground_costs_more_than_rigid_ground_and_lets_feet_sink():
    rigid, soft = (measure(settings(), Ground(name)) for name in ('rigid', 'highland_loose'))
    assert rigid.outcome == soft.outcome == 'walked'
    assert rigid.speed_mps == pytest.approx(0.12, rel=0.1)
    assert soft.transport > 1.15 * rigid.transport
    assert rigid.sinkage_m == 0.0 and 0.01 < soft.sinkage_m < soft.sinkage_max_m < 0.08


def test_more_pull_than_friction_drags_the_rover_back(tmp_path):
    """Friction is 0.65; what the feet plough holds a little more."""
    walk = measure(settings(4.0), Ground('highland_loose', pull=1.2))
    assert walk.speed_mps < 0.0 and walk.slip > 1.0 and math.isinf(walk.transport)
    anchors = [Anchor('a name', 3.0, 1.0, 2.0, 'mm', 'a source')]
    text = terramechanics_report.write_all(anchors, [walk], tmp_path)
    assert '| a name | 3 mm | 1 to 2 | **no** | a source |' in text
    assert '| highland_loose | 0 | 1.2 | ' in text
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'terramechanics.csv', 'terramechanics.md', 'terramechanics.png']


def test_plates_hold():
    assert len(plates()) >= 7 and all(anchor.holds for anchor in plates())


def test_a_slope_on_which_it_cannot_stand_is_a_result():
    walk = measure(settings(), Ground('rigid', slope_deg=60.0))
    assert walk.outcome != 'walked' or walk.speed_mps < 0.0


def test_a_ground_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="preset: 'swamp' is not valid"):
        measure(settings(), Ground('swamp'))
