"""Windows of a site in a recording: where the rover was, checked."""

import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.base import topics
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.inspection.report import Status


def found(path):
    return next((f.status, f.detail) for f in check(path).findings if f.check == 'windows')


@pytest.fixture(scope='module')
def items():
    return synthetic.drive(0.2, only=(topics.ODOM, topics.CLOCK, topics.SCENARIO,
                                      topics.WORLD_HASH, topics.WORLD_WINDOW))


def test_windows_are_checked(items, tmp_path):
    whole = synthetic.write(tmp_path / 'whole', [*items, synthetic.window(100_000_000,
                                                                          (12.8, 0.0))])
    status, detail = found(whole)
    assert status is Status.PASS and detail.startswith('2;')
    far = synthetic.write(tmp_path / 'far', [*items, synthetic.window(100_000_000, (38.4, 0.0))])
    status, detail = found(far)
    assert status is Status.FAIL and 'outside its window at 0.100 s' in detail
    between = synthetic.write(tmp_path / 'between', [*items, synthetic.window(101_000_000,
                                                                              (12.8, 0.0))])
    status, detail = found(between)
    assert status is Status.FAIL and 'no state at 0.101 s' in detail
    late = synthetic.write(tmp_path / 'late', [
        *(item for item in items if item.topic != 'world/window'),
        synthetic.window(100_000_000, (0.0, 0.0))])
    status, detail = found(late)
    assert status is Status.FAIL and '19 states before' in detail
