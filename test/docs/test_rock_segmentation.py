"""The example of docs/rock_segmentation.py: what it reads, what counts, how it is judged."""

from __future__ import annotations

import json
from pathlib import Path
import sys
from types import ModuleType

import numpy as np
import pytest
from snippets import module_of

from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.products.sequences.shards import npy_bytes, ShardWriter

DOCS = Path(__file__).resolve().parents[2] / 'docs'


@pytest.fixture(scope='module')
def masks() -> ModuleType:
    return module_of(DOCS / 'rock_masks.py')


def test_shards_are_read_and_small_rocks_do_not_count(masks: ModuleType, tmp_path: Path) -> None:
    label = np.ones((16, 24), np.uint16)
    label[2:6, 3:8] = 20        # 20 pixels
    label[10, 0:9] = 21         # 9: too few
    label[0, 0] = 2             # the rover is no rock
    with ShardWriter(tmp_path, 2, 'test') as writer:
        for k in range(3):
            picture = np.full(label.shape, 40 * k, np.uint8)
            writer.write(f'a-{k}', {
                'left.png': png_bytes(picture), 'labels.npy': npy_bytes(label),
                'json': json.dumps({'base': 'flat', 'world': f'w{k}'}).encode()})
    pictures, targets, told = masks.load(tmp_path, 'test')
    assert [int(p.mean()) for p in pictures] == [0, 40, 80]
    assert told == [('flat', f'w{k}') for k in range(3)]
    expected = np.where(label == 20, 1, np.where(label == 21, masks.IGNORED, 0))
    assert all(np.array_equal(target, expected) for target in targets)


def test_shards_of_a_data_set_name_the_scenario_in_their_index(masks: ModuleType,
                                                               tmp_path: Path) -> None:
    label = np.ones((8, 8), np.uint16)
    with ShardWriter(tmp_path, 2, 'test') as writer:
        for drive in ('0000', '0001', '0002'):
            writer.write(drive, {
                'left.png': png_bytes(label.astype(np.uint8)), 'labels.npy': npy_bytes(label),
                'json': json.dumps({'drive': drive, 'world': f'w{drive}'}).encode()})
    (tmp_path / 'test.json').write_text(json.dumps({'drives': {
        '0000': {'base': 'flat', 'world': 'w0000'}, '0001': {'base': 'soft', 'world': 'w0001'}}}))
    assert masks.load(tmp_path, 'test')[2] == [('flat', 'w0000'), ('soft', 'w0001'),
                                               ('all', 'w0002')]


def test_scores_are_those_of_counted_pixels(masks: ModuleType) -> None:
    target = np.array([[1, 1, 0, 0, masks.IGNORED]])
    found = np.array([[True, False, True, False, True]])
    counts = masks.confusion(found, target)
    assert counts.tolist() == [1, 1, 1, 1]
    assert masks.iou(counts) == pytest.approx(1 / 3)
    rows = np.array([[8, 1, 1, 90]] * 3 + [[2, 4, 4, 90]] * 3)
    told = [('a', 'w0')] * 3 + [('a', 'w1')] * 3
    scores = masks.scores_of(rows, told)
    assert set(scores) == {'a'} and scores['a']['worlds'] == 2
    assert scores['a']['iou'] == 0.5 and scores['a']['recall'] == round(30 / 45, 3)
    # Worlds are drawn: one of them alone may be, and bounds the interval.
    assert scores['a']['interval'] == [0.2, 0.8]
    assert set(masks.scores_of(rows, told[:3] + [('b', 'w1')] * 3)) == {'a', 'b', 'all'}


def test_the_network_has_the_size_of_its_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip('torch')
    monkeypatch.setattr(sys, 'path', [str(DOCS), *sys.path])
    network = module_of(DOCS / 'rock_segmentation.py').Net()
    assert network(torch.zeros(2, 48, 64)).shape == (2, 48, 64)
