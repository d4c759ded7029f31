"""Readers of image sets, on small sets made to the documentation of each layout."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.image.camera.encoding import ENCODINGS
from lunar_rover_sim.judge.evaluation.image_layouts import open_images
from lunar_rover_sim.judge.evaluation.image_statistics import GreyPair, image_statistics, MEASURES
from lunar_rover_sim.products.sequences.export import export

POLAR_CALIBRATION = """
CAMERA_MATRIX_LEFT: 100 0 32 0 100 24 0 0 1
DISTORTION_COEFFICIENTS_LEFT: 0 0 0 0 0
CAMERA_MATRIX_RIGHT: 100 0 32 0 100 24 0 0 1
DISTORTION_COEFFICIENTS_RIGHT: 0 0 0 0 0
ROTATION_MATRIX: 1 0 0 0 1 0 0 0 1
TRANSLATION_VECTOR: -0.3 0 0
"""


def put(path: Path, level: int, dtype: Any = np.uint8) -> Path:
    """Write a picture of one grey."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, np.full((48, 64), level, dtype))
    return path


def pairs(path: Path, most: int = 10) -> tuple[str, int, list[GreyPair]]:
    """Return layout, number and pairs of a set."""
    images = open_images(path)
    return images.layout, images.total, list(images.read(most))


@pytest.mark.parametrize(('layout', 'left', 'right'), [
    ('EuRoC', 'mav0/cam0/data/{}.png', 'mav0/cam1/data/{}.png'),
    ('KITTI', 'image_0/{}.png', 'image_1/{}.png'),
    ('TartanAir', 'image_left/{}_left.png', 'image_right/{}_right.png'),
    ('TUM', 'rgb/{}.png', ''),
    ('LuSNAR', 'image1/RGB/{}.png', 'image2/RGB/{}.png'),
    ('LuSNAR', 'Moon_1/image1/RGB/{}.png', 'Moon_1/image2/RGB/{}.png'),
    ('folder', 'left/{}.png', 'right/{}.png'),
    ('folder', '{}_left.png', '{}_right.png'),
    ('folder', '{}.jpg', ''),
])
def test_files(layout: str, left: str, right: str, tmp_path: Path) -> None:
    """Left and right belong together; other pictures of the set are no images of it."""
    folder = tmp_path / 'left_image1_set'       # words of the layouts in the path above
    for k in range(3):
        put(folder / left.format(1000 + k), 40 * (k + 1))
        if right:
            put(folder / right.format(1000 + k), 40 * (k + 1) + 10)
    put(folder / 'image1' / 'Depth' / '1000.png', 7)
    put(folder / 'preview' / 'sheet.png', 7)
    found_layout, count, found = pairs(folder)
    assert (found_layout, count, len(found)) == (layout, 3, 3)
    for k, pair in enumerate(found):
        assert pair.left.mean() == pytest.approx(40 * (k + 1) / 255.0, abs=0.005)
        assert (pair.right is not None) == bool(right)
        if pair.right is not None:
            assert pair.right.mean() == pytest.approx((40 * (k + 1) + 10) / 255.0, abs=0.005)


def test_sixteen_bits_are_linear(tmp_path: Path) -> None:
    """A quarter of the signal is half of its root; 8 bits are the root already."""
    put(tmp_path / 'deep' / '1.png', 16384, np.uint16)
    put(tmp_path / 'flat' / '1.png', 128)
    for name in ('deep', 'flat'):
        (_, _, (pair,)) = pairs(tmp_path / name)
        assert pair.left.mean() == pytest.approx(0.5, abs=0.003)


def test_polar(tmp_path: Path) -> None:
    """Of the exposures the longest that is not saturated; pairs are rectified; 12 bits over 16."""
    terrain = tmp_path / 'Terrain11_FreshCrater'
    for light in ('Sun_30', 'NoSun'):
        folder = terrain / 'PosA_1500_Loff' / light
        for exposure, level in ((64, 500), (128, 1036), (256, 4095)):
            put(folder / f'CamL_PosA_{exposure:04d}.png', level, np.uint16)
            put(folder / f'CamR_PosA_{exposure:04d}.png', level + 1, np.uint16)
    layout, count, found = pairs(tmp_path)
    assert (layout, count, len(found)) == ('POLAR', 2, 2)
    assert '_0128.png' in found[0].name and found[0].right is None     # no calibration: not rows
    assert found[0].left.mean() == pytest.approx(np.sqrt(1020.0 / 4079.0), abs=1e-3)
    (terrain / 'stereo.calibration').write_text(POLAR_CALIBRATION)
    for path in (terrain, terrain / 'PosA_1500_Loff', terrain / 'PosA_1500_Loff' / 'NoSun'):
        _, _, found = pairs(path)
        assert found[0].right is not None
        assert found[0].right[24, 32] == pytest.approx(np.sqrt(1021.0 / 4079.0), abs=1e-3)
    # These two cameras are rectified already: what grows to the right still does.
    ramp = 900 + 2 * np.tile(np.arange(64, dtype=np.uint16), (48, 1))
    write_png(terrain / 'PosA_1500_Loff' / 'NoSun' / 'CamR_PosA_0128.png', ramp)
    inner = np.s_[4:-4, 4:-4]
    _, _, found = pairs(path)
    np.testing.assert_allclose(found[0].right[inner], np.sqrt((ramp[inner] - 16.0) / 4079.0),
                               atol=1e-3)
    (terrain / 'stereo.calibration').write_text('ROTATION_MATRIX: 1 0 0\n')
    with pytest.raises(EvaluationError, match='CAMERA_MATRIX_LEFT is missing'):
        pairs(terrain)


@pytest.mark.parametrize(('turn', 'problem'), [
    ('1.0001 0 0 0 1 0 0 0 1', ''), ('1.01 0 0 0 1 0 0 0 1', 'is not a rotation'),
    ('0 1 0 1 0 0 0 0 1', 'is not a rotation'), ('0.5 0 0 0 0.5 0 0 0 0.5', 'not a rotation')])
def test_the_turn_between_the_cameras_is_a_rotation(turn: str, problem: str,
                                                    tmp_path: Path) -> None:
    """Rounding of four digits is none; a stretch and a mirror are."""
    for side in 'LR':
        put(tmp_path / 'NoSun' / f'Cam{side}_PosA_0064.png', 500, np.uint16)
    (tmp_path / 'stereo.calibration').write_text(
        POLAR_CALIBRATION.replace('1 0 0 0 1 0 0 0 1', turn))
    if problem:
        with pytest.raises(EvaluationError, match=problem):
            pairs(tmp_path)
    else:
        assert pairs(tmp_path)[2][0].right is not None


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag in the folder of a run, and its export."""
    folder = tmp_path_factory.mktemp('run')
    return synthetic.write(folder / 'bag', synthetic.drive(0.5))


def test_a_bag_and_its_exports_agree(bag: Path, tmp_path: Path) -> None:
    """The same images give the same numbers, with truth from the bag or TartanAir's depth."""
    _, count, (first, *_) = pairs(bag.parent)
    assert count == 5
    values = {'bag': image_statistics(first).values}
    for kind in ('euroc', 'tartanair'):
        export(bag, tmp_path / kind, kind)
        _, _, found = pairs(tmp_path / kind)
        pair = min(found, key=lambda p: float(np.abs(p.left - first.left).mean()))
        assert np.array_equal(pair.left, first.left)
        values[kind] = image_statistics(pair).values
    assert np.allclose(values['bag'], values['tartanair'], atol=1e-6, equal_nan=True)
    bad = list(MEASURES).index('SGM bad-1')
    assert values['bag'][bad] < 0.2 and np.isnan(values['euroc'][bad])
    assert np.allclose(np.delete(values['bag'], bad), np.delete(values['euroc'], bad))
    for file in (tmp_path / 'tartanair').rglob('*_depth.npy'):
        np.save(file, np.full_like(np.load(file), 1e-42))    # its disparity would be infinite
    with pytest.raises(EvaluationError, match='holds a depth of .* m; valid is 0.001 m and more'):
        pairs(tmp_path / 'tartanair')


@pytest.mark.parametrize('encoding', ENCODINGS)
def test_a_bag_and_its_export_agree_in_each_encoding(encoding: str, tmp_path: Path) -> None:
    """Colours become the same grey, and 16 bits of colour are linear in a file, too."""
    items = synthetic.drive(0.2)
    rng, shape = np.random.default_rng(8), (synthetic.HEIGHT, synthetic.WIDTH)
    kind = np.uint16 if encoding.endswith('16') else np.uint8
    pixels = rng.integers(0, np.iinfo(kind).max, (*shape, 3) if encoding == 'rgb8' else shape,
                          dtype=kind, endpoint=True)
    for item in items:
        if item.topic in (topics.LEFT_IMAGE.name, topics.RIGHT_IMAGE.name):
            item.message = synthetic.image(header_ns(item.message), 'camera', encoding, pixels)
    bag = synthetic.write(tmp_path / 'run' / 'bag', items)
    export(bag, tmp_path / 'euroc', 'euroc')
    left, exported = (pairs(path)[2][0].left for path in (bag.parent, tmp_path / 'euroc'))
    np.testing.assert_array_equal(left, exported)


def test_what_is_no_set(tmp_path: Path) -> None:
    """One line each: a bag without images, exposures without numbers."""
    items = [item for item in synthetic.drive(0.1) if 'image' not in item.topic]
    with pytest.raises(EvaluationError, match='holds no images on stereo/left/image_raw'):
        open_images(synthetic.write(tmp_path / 'bag', items))
    put(tmp_path / 'polar' / 'CamL_PosA.png', 7, np.uint16)
    with pytest.raises(EvaluationError, match='names no exposure'):
        open_images(tmp_path / 'polar')
