"""The learning study: what is measured of a walk, how walkers are compared, and what is kept."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.learning.randomisation import Randomisation
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.judge.studies.learning import (Case, HIDDEN_SEEDS, PACKAGED, PolicyWalk,
                                                    report_text, SETTINGS, walk, WALKED, WalkStore)


def made(walker, seed, transport, outcome=WALKED):
    return PolicyWalk(Case(walker, 'rigid', 0.0, seed), outcome, 0.12, 0.0, 0.01, transport, 0.02,
                      0.3, 2.5)


def test_hidden_seeds_are_not_those_of_training():
    low, high = Randomisation().terrain_seed
    assert min(HIDDEN_SEEDS) > high >= low and len(set(HIDDEN_SEEDS)) == 20


def test_the_packaged_gait_walks_as_its_calibration_says():
    found = walk(Case(PACKAGED, 'rigid', 0.0, HIDDEN_SEEDS[0]))
    assert found.outcome == WALKED
    # The calibration's own tolerance; relief and whole cycles take some of it.
    assert found.tracking_error < 0.1 and found.speed_mps == pytest.approx(0.12, rel=0.1)
    assert 0.4 < found.transport < 3.0 and 0.1 < found.pitch_rate_rms_radps < 1.0
    assert 0.0 <= found.slip < 0.2 and found.miss_px > 0.1


@pytest.mark.parametrize('walker', [PACKAGED, 'smooth'])
def test_a_walk_that_is_to_turn_is_judged_by_its_turn(walker):
    """The packaged gait and the packaged policy turn to both sides."""
    left, right = (walk(Case(walker, 'rigid', 0.0, HIDDEN_SEEDS[0], 'quad', 0.12, yaw_rate))
                   for yaw_rate in (0.15, -0.15))
    assert left.turned_radps > 0.08 and right.turned_radps < -0.08
    assert max(left.tracking_error, right.tracking_error) < 0.3


def test_pairs_tell_a_difference_that_means_hide():
    rng = np.random.default_rng(1)
    base = rng.uniform(1.0, 2.0, 20)
    walks = [made(PACKAGED, k, value) for k, value in enumerate(base)]
    walks += [made('better', k, value - 0.05) for k, value in enumerate(base)]
    row = next(line for line in report_text(walks).splitlines() if line.startswith('| better'))
    cell = row.split('|')[3]
    assert '; p < 0.001, -1.00' in cell and '20/20' in row
    turned = report_text(walks, against='better')
    row = next(line for line in turned.splitlines() if line.startswith('| packaged'))
    assert '; p < 0.001, +1.00' in row and 'against better on' in turned


def test_a_study_that_was_stopped_goes_on(tmp_path):
    made_of = []

    def counted(case):
        made_of.append(case)
        if len(made_of) == 3:
            raise KeyboardInterrupt
        return made(case.walker, case.seed, float('nan'), 'fallen')

    cases = [Case(PACKAGED, 'rigid', 0.0, seed) for seed in HIDDEN_SEEDS[:4]]
    folder = tmp_path / 'study'
    with pytest.raises(KeyboardInterrupt):
        WalkStore(folder, SETTINGS, resume=False).study(counted, cases)
    with pytest.raises(ConfigError, match='exists'):
        WalkStore(folder, SETTINGS, resume=False)
    found = WalkStore(folder, SETTINGS, resume=True).study(counted, cases)
    assert made_of == [*cases[:3], *cases[2:]] and list(found) == cases
    assert all(one.case == case and np.isnan(one.transport) for case, one in found.items())


def test_a_policy_that_changed_walks_anew(tmp_path):
    policy = tmp_path / 'own.onnx'
    policy.write_bytes(b'one')
    case = Case(str(policy), 'rigid', 0.0, HIDDEN_SEEDS[0])
    store = WalkStore(tmp_path / 'study', SETTINGS, resume=False)
    store.save(case, made(case.walker, case.seed, 1.5))
    assert store.load(case) is not None
    policy.write_bytes(b'two')
    assert store.load(case) is None
