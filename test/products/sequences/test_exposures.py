"""Exposure times from a bag into its check, its pictures, its card and every export format."""

import json
from pathlib import Path

import numpy as np
from products.sequences.shard_reader import read_shards
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.seconds import EPOCH_NS
from lunar_rover_sim.campaign.statistics import statistics
from lunar_rover_sim.products.inspection.bag_pictures import preview
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.sequences.export import export, EXPOSURE_FILE, FORMATS
from lunar_rover_sim.run.plan import resolve
from lunar_rover_sim.run.scenario import Scenario

DATED = ('euroc', 'tum')


def growing() -> list[synthetic.Item]:
    """Return a drive whose exposure grows with time: 1 ms and a hundredth of the stamp."""
    items = synthetic.drive(0.5)
    for item in items:
        if item.topic == topics.EXPOSURE.name:
            item.message.position[:] = 1e-3 + 1e-11 * header_ns(item.message)
    labels = np.zeros((synthetic.HEIGHT, synthetic.WIDTH), np.uint16)
    return items + [synthetic.picture(topics.LABELS, k * 10**8, 'mono16', labels)
                    for k in range(1, 6)]


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('exposed') / 'bag', growing())


@pytest.mark.parametrize('kind', FORMATS)
def test_each_image_has_its_exposure_in_every_format(kind: str, bag: Path,
                                                     tmp_path: Path) -> None:
    notes = export(bag, tmp_path / 'out', kind)
    assert not any(topics.EXPOSURE.name in note for note in notes)
    rows = np.loadtxt(tmp_path / 'out' / EXPOSURE_FILE, delimiter=',', ndmin=2)
    stamps = rows[:, 0] - (EPOCH_NS if kind in DATED else 0)
    assert len(rows) == 5
    assert np.allclose(stamps, 1e8 * np.arange(1, 1 + len(rows)), atol=300.0)   # of a double
    assert np.allclose(rows[:, 1], 1e-3 + 1e-3 * np.arange(1, 1 + len(rows)), rtol=1e-6)
    if kind == 'webdataset':
        values = [json.loads(files['json']) for _, files in read_shards(tmp_path / 'out')]
        assert [value['exposure']['stamp_ns'] for value in values] == \
            [value['stamp_ns'] for value in values]
        assert values[2]['exposure']['time_s'] == pytest.approx(4e-3)


def test_check_card_and_picture_read_it(bag: Path, tmp_path: Path) -> None:
    assert check(bag).ok
    assert statistics(bag)['exposure_s'] == pytest.approx(4e-3)
    assert 'exposure.png' in [path.name for path in preview(bag, tmp_path / 'out')]


@pytest.mark.parametrize(('names', 'times', 'problem'), [
    (['left', 'right'], [0.0, 1e-3], 'exposure time 0 s is not positive'),
    (['left'], [1e-3], "exposure times of ['left'], not of left and right"),
    (['left', 'right'], [np.nan, np.nan], 'exposure time nan s is not positive')])
def test_damage_is_named(names: list[str], times: list[float], problem: str,
                         tmp_path: Path) -> None:
    items = synthetic.drive(0.3)
    last = next(item for item in reversed(items) if item.topic == topics.EXPOSURE.name).message
    last.name, last.position = names, np.array(times)
    report = check(synthetic.write(tmp_path / 'bag', items))
    (found,) = report.failed
    assert f'/{topics.EXPOSURE.name} at 0.300 s {problem}' in found.detail


def test_a_bag_of_before_has_none_and_is_fine(tmp_path: Path) -> None:
    bag = synthetic.write(tmp_path / 'bag', [item for item in synthetic.drive(0.3)
                                             if item.topic != topics.EXPOSURE.name])
    assert check(bag).ok
    assert statistics(bag)['exposure_s'] is None
    export(bag, tmp_path / 'out', 'kitti')
    assert not (tmp_path / 'out' / EXPOSURE_FILE).exists()


def test_nobody_exposes_images_for_their_times_alone() -> None:
    def recorded(**recorder: list[str]) -> bool:
        scenario = resolve(Scenario.load('baseline', {
            f'recorder_node.{name}': value for name, value in recorder.items()}))
        return topics.EXPOSURE.name not in scenario.recorder_node.exclude
    assert recorded()
    assert not recorded(exclude=[topic.name for topic in topics.OF_IMAGES])
    assert recorded(topics=['all', topics.LEFT_COMPRESSED.name],
                    exclude=[topic.name for topic in topics.OF_IMAGES])
