"""COCO and YOLO exports: masks, boxes and outlines read back are those of the label images."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import synthetic_bag
import yaml

from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.image.rendering.labels import Instance, LABEL_FIRST_ROCK
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.products.sequences.labelled import outline, run_lengths

H, W = synthetic_bag.HEIGHT, synthetic_bag.WIDTH
INFO = {'rocks': {'first_id': LABEL_FIRST_ROCK, 'diameter_m': [0.3] * 20},
        'craters': {'first_id': 1, 'diameter_m': [2.0, 3.0], 'age': [0.1, 0.7]}}


def truth(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and craters: rocks with a hole, in two parts, at a corner, and a tiny one."""
    label, crater = np.ones((H, W), np.uint16), np.zeros((H, W), np.uint16)
    cv2.circle(crater, (W // 2, H // 2 + 8), 30, 2, -1)
    label[20 + k:40 + k, 30:50] = LABEL_FIRST_ROCK
    label[25 + k:30 + k, 35:42] = LABEL_FIRST_ROCK + 1
    label[10:20, 60:64] = label[10:20, 66:70] = LABEL_FIRST_ROCK + 2
    label[-4:, -6:] = LABEL_FIRST_ROCK + 3
    label[0, 0:3] = LABEL_FIRST_ROCK + 4
    cv2.circle(label, (20, H - 20), 9, LABEL_FIRST_ROCK + 5, -1)
    crater[label >= LABEL_FIRST_ROCK] = 0
    return label, crater


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of 4 pairs; the right images show what the left ones do 5 frames later."""
    items = synthetic_bag.drive(0.4)
    times = [item.message.header.stamp for item in items if item.topic == topics.TRUE_DEPTH.name]
    for k, stamp in enumerate(times):
        ns = stamp.sec * 10**9 + stamp.nanosec
        for topic, pixels in zip((topics.LABELS, topics.CRATERS, topics.RIGHT_LABELS,
                                  topics.RIGHT_CRATERS), (*truth(k), *truth(k + 5))):
            items.append(synthetic_bag.picture(topic, ns, 'mono16', pixels))
    items.append(synthetic_bag.text(topics.LABEL_INFO, json.dumps(INFO)))
    return synthetic_bag.write(tmp_path_factory.mktemp('instances') / 'bag', items)


def expected(k: int) -> dict[tuple[int, int], np.ndarray]:
    """Return (class, number) → mask of what is to be found."""
    label, crater = truth(k)
    rocks = {(0, n): label == n for n in range(LABEL_FIRST_ROCK, LABEL_FIRST_ROCK + 6)
             if n != LABEL_FIRST_ROCK + 4}
    return {**rocks, (1, 2): crater == 2}


def shown(image: int) -> int:
    """Return what of `truth` the image of a number shows: left and right images in turn."""
    return image // 2 + 5 * (image % 2)


def test_coco(bag: Path, tmp_path: Path) -> None:
    notes = export(bag, tmp_path / 'coco', 'coco')
    assert '4 image sets' in notes[0]
    assert any('48 annotations' in note for note in notes)
    path = tmp_path / 'coco/annotations/instances.json'
    data = json.loads(path.read_text())
    coco = pytest.importorskip('pycocotools.coco').COCO(str(path))
    assert [c['name'] for c in data['categories']] == ['rock', 'crater']
    assert len({a['id'] for a in data['annotations']}) == 48
    for image in data['images']:
        k = shown(image['id'])
        assert image['camera'] == ('left', 'right')[image['id'] % 2]
        assert (tmp_path / 'coco/images' / image['file_name']).is_file()
        assert (image['width'], image['height']) == (W, H)
        own = {(a['category_id'] - 1, a['number']): a for a in data['annotations']
               if a['image_id'] == image['id']}
        assert set(own) == set(expected(k))
        for key, mask in expected(k).items():
            found = own[key]
            assert np.array_equal(coco.annToMask(found) > 0, mask)
            assert found['bbox'] == list(cv2.boundingRect(mask.astype(np.uint8)))
            assert found['area'] == mask.sum() and found['iscrowd'] == 0
            assert found['diameter_m'] == (0.3 if key[0] == 0 else 3.0)
        assert own[1, 2]['age'] == 0.7


def test_yolo(bag: Path, tmp_path: Path) -> None:
    export(bag, tmp_path / 'yolo', 'yolo')
    names = yaml.safe_load((tmp_path / 'yolo/data.yaml').read_text())['names']
    assert names == {0: 'rock', 1: 'crater'}
    assert len(list((tmp_path / 'yolo/images').iterdir())) == 8
    cameras = [line.split()[2] for line in (tmp_path / 'yolo/times.txt').read_text().splitlines()]
    assert cameras == ['left', 'right'] * 4
    for k in range(8):
        masks = list(expected(shown(k)).items())
        outlines = (tmp_path / f'yolo/labels/{k:06d}.txt').read_text().splitlines()
        boxes = np.loadtxt(tmp_path / f'yolo/boxes/{k:06d}.txt')
        assert len(outlines) == len(boxes) == len(masks)
        for line, box, ((kind, _), mask) in zip(outlines, boxes, masks):
            values = np.array(line.split(), float)
            assert values[0] == box[0] == kind
            # As trainers draw it: pixels, rounded down.
            corners = (values[1:].reshape(-1, 2) * (W, H)).astype(np.int32)
            drawn = cv2.fillPoly(np.zeros((H, W), np.uint8), [corners], 1) > 0
            both, either = (drawn & mask).sum(), (drawn | mask).sum()
            assert both == mask.sum() and both / either > 0.85
            x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
            assert box[1:] == pytest.approx([(x + width / 2) / W, (y + height / 2) / H,
                                             width / W, height / H], abs=2e-6)


def test_what_is_left_out_is_told_once(tmp_path: Path) -> None:
    """And not once for each topic, as if these were different images."""
    items = synthetic_bag.drive(0.4)
    for topic, pixels in zip((topics.LABELS, topics.CRATERS), truth(0)):
        items.append(synthetic_bag.picture(topic, 10**8, 'mono16', pixels))
    notes = export(synthetic_bag.write(tmp_path / 'bag', items), tmp_path / 'yolo', 'yolo')
    assert [note for note in notes if 'without' in note] == [
        '3 image sets without ground_truth/craters, ground_truth/labels left out '
        '(render_node.depth_every=1 records it with every image)']


def test_run_lengths_go_on_in_the_next_column() -> None:
    whole = Instance('rock', 16, 1, 0, np.ones((3, 2), bool))
    assert run_lengths(whole, 3, 4) == [3, 6, 3]
    corner = Instance('rock', 16, 0, 0, np.ones((1, 1), bool))
    assert run_lengths(corner, 3, 4) == [0, 1, 11]


def test_outlines_of_thin_and_scattered_masks() -> None:
    """A line of fewer than three points would be read as a box: class, x, y, w, h."""
    row = outline(Instance('rock', 16, 3, 5, np.ones((1, 12), bool)))
    assert row.tolist() == [[3, 5], [14, 5], [3, 5]]
    assert outline(Instance('rock', 16, 2, 1, np.ones((1, 1), bool))).tolist() == [[2, 1]] * 3
    # Of four squares in a row, each is joined to the next one: three paths of 3 px.
    mask = np.zeros((4, 25), bool)
    for column in (0, 7, 14, 21):
        mask[:, column:column + 4] = True
    drawn = cv2.fillPoly(np.zeros(mask.shape, np.uint8),
                         [outline(Instance('crater', 1, 0, 0, mask))], 1) > 0
    assert drawn[mask].all() and (drawn & ~mask).sum() == 3 * 3


def test_what_lacks_labels_or_is_distorted_is_refused(bag: Path, tmp_path: Path) -> None:
    plain = synthetic_bag.write(tmp_path / 'plain', synthetic_bag.drive(0.2))
    with pytest.raises(SequenceError, match='lacks ground_truth/labels'):
        export(plain, tmp_path / 'a', 'coco')
    items = synthetic_bag.drive(0.2)
    for item in items:
        if item.topic == topics.LEFT_INFO.name:
            item.message.d[0] = -0.2
    label = synthetic_bag.image(10**8, frames.LEFT_OPTICAL_FRAME, 'mono16', truth(0)[0])
    items.append(synthetic_bag.item(topics.LABELS, label))
    bent = synthetic_bag.write(tmp_path / 'bent', items)
    with pytest.raises(SequenceError, match='distortion .* do not fit the labels'):
        export(bent, tmp_path / 'b', 'yolo')
    assert not (tmp_path / 'b').exists()
