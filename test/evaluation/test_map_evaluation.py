"""Maps of a bag against their world: of the true heights, off by what is known."""

import map_bag
import pytest
import synthetic_bag
import worlds

from lunar_rover_sim.errors import EvaluationError
from lunar_rover_sim.evaluation.map_evaluation import evaluate_maps
from lunar_rover_sim.world.world_folder import save_world


def rocky():
    return worlds.small(**{'rocks.abundance': 0.3, 'clear_radius_m': 0.5})


@pytest.fixture(scope='module', name='folder')
def _folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('world') / 'world'
    save_world(rocky(), folder)
    return folder


def judged(folder, path, **values):
    return evaluate_maps(map_bag.write(path, rocky(), **values), folder)


def test_a_true_map_with_an_offset_has_that_error(folder, tmp_path):
    result = judged(folder, tmp_path / 'bag', error_m=0.02)
    assert result.maps == 1 and result.near.cells > 1000
    assert result.offset_m == pytest.approx(0.02, abs=0.001)
    assert result.near.median_m == pytest.approx(0.02, abs=0.002)
    # Samples of a cell differ at the edges of rocks.
    assert 0.02 <= result.near.rms_m < 0.03
    assert sum(one.cells for one in result.by_distance) >= result.near.cells


def test_flags_are_right_or_missing(folder, tmp_path):
    right, none = (judged(folder, tmp_path / str(flagged), flag_rocks=flagged)
                   for flagged in (True, False))
    assert right.near.precision > 0.98 and right.near.recall > 0.98
    assert none.near.recall == 0.0 and none.near.precision != none.near.precision


def test_a_bag_without_a_map_and_a_world_that_is_another_are_refused(folder, tmp_path):
    bag = synthetic_bag.write(tmp_path / 'bag', synthetic_bag.latched_items())
    with pytest.raises(EvaluationError, match='holds no map/elevation.* mapping_node'):
        evaluate_maps(bag, folder)
