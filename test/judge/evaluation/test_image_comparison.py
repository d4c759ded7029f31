"""Comparison of image sets, held to known answers: itself, blurred, darkened, noisier, another."""

import json
from pathlib import Path
from typing import Any

from command_line import unfolded
import cv2
from judge.evaluation.image_sets import write_set
import numpy as np
import pytest

from lunar_rover_sim.base.errors import EvaluationError
from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.judge.evaluation.image_comparison import (compare_images, ImageComparison,
                                                               MeasureRow)


@pytest.fixture(scope='module')
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a set."""
    return write_set(tmp_path_factory.mktemp('sets') / 'plain')


def row(result: ImageComparison, name: str) -> MeasureRow:
    """Return one measure."""
    return next(row for row in result.rows if row.name == name)


def changes(result: ImageComparison, name: str) -> tuple[float, float]:
    """Return the difference of a measure and its p."""
    found = row(result, name).difference
    assert found.low <= found.value <= found.high
    return found.value, found.p


def test_itself(plain: Path) -> None:
    """No difference, no distance, p near 1; intervals hold the value."""
    result = compare_images(plain, plain)
    for one in result.rows:
        if one.first.n:
            assert one.difference.value == 0.0 and one.difference.p > 0.9
            assert one.first.low <= one.first.value <= one.first.high
    assert result.distance.value == 0.0 and result.distance.p == 1.0
    assert row(result, 'SGM bad-1').first.n == 0      # no truth
    matches = row(result, 'ORB matches').first.value
    assert 0.5 < matches / row(result, 'ORB keypoints').first.value <= 1.0
    assert row(result, 'SGM density').first.value > 0.8


def test_another_draw_of_the_same(plain: Path, tmp_path: Path) -> None:
    """Nothing is found between two samples of one world, but for what chance gives."""
    result = compare_images(plain, write_set(tmp_path / 'b', seed=1))
    assert abs(row(result, 'spectrum slope').difference.value) < 0.1
    assert row(result, 'spectrum slope').difference.p > 0.02
    assert result.distance.p > 0.02 and result.distance.value < 2.0 * result.chance


def test_blurred(plain: Path, tmp_path: Path) -> None:
    """Smaller gradients, a steeper spectrum, fewer keypoints."""
    result = compare_images(plain, write_set(
        tmp_path / 'b', lambda image: cv2.GaussianBlur(image, (0, 0), 1.5)))
    for name in ('log gradient', 'spectrum slope', 'ORB keypoints'):
        value, p = changes(result, name)
        assert value < 0.0 and p < 0.01, name
    assert result.distance.p < 0.02 and result.distance.value > result.chance


def test_darkened(plain: Path, tmp_path: Path) -> None:
    """All gradients fall by the same factor; the spectrum and the share of shadow stay."""
    result = compare_images(plain, write_set(tmp_path / 'b', lambda image: 0.5 * image))
    assert changes(result, 'log gradient')[0] == pytest.approx(np.log10(0.5), abs=0.02)
    # So far apart that resampled images move the distance by a tenth at most.
    assert 0.0 < result.distance.high - result.distance.low < 0.2 * result.distance.value
    assert result.distance.value == pytest.approx(-np.log10(0.5), abs=0.03)
    # A few rows more pass for sky in darker images.
    assert changes(result, 'spectrum slope')[0] == pytest.approx(0.0, abs=0.06)
    assert changes(result, 'shadow share')[0] == pytest.approx(0.0, abs=0.01)
    assert changes(result, 'ORB keypoints')[0] < 0.0


def test_noisier(plain: Path, tmp_path: Path) -> None:
    """Larger gradients, a flatter spectrum, sparser matching: the two images differ."""
    rng = np.random.default_rng(5)
    folder = write_set(tmp_path / 'b')
    for path in folder.glob('*/*.png'):
        grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        write_png(path, np.clip(grey + rng.normal(0.0, 12.0, grey.shape), 0, 255
                                ).astype(np.uint8))
    result = compare_images(plain, folder)
    for name, sign in (('log gradient', 1), ('spectrum slope', 1), ('SGM density', -1),
                       ('ORB matches', -1)):
        value, p = changes(result, name)
        assert sign * value > 0.0 and p < 0.01, name


def test_another_world(plain: Path, tmp_path: Path) -> None:
    """The spectrum's slope is found as it was drawn, in both sets."""
    result = compare_images(plain, write_set(tmp_path / 'b', seed=1, exponent=3.2))
    slopes = row(result, 'spectrum slope')
    assert slopes.first.value == pytest.approx(-2.4, abs=0.1)
    assert slopes.second.value == pytest.approx(-3.2, abs=0.15)
    assert slopes.difference.low < -0.8 < slopes.difference.high + 0.15
    assert slopes.difference.p < 0.01


def test_pairs_are_compared_as_pairs(plain: Path, tmp_path: Path,
                                     capsys: pytest.CaptureFixture[str]) -> None:
    """Scenes scatter widely and the second set is a little darker: shown by names alone.

    Under other names the same pictures are two samples, and the interval is that of scenes.
    """
    def scenes(folder: Path, factor: float, name: str) -> Path:
        folder.mkdir()
        for k, path in enumerate(sorted((plain / 'left').glob('*.png'))):
            grey = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * (0.4 + 0.06 * k) * factor
            write_png(folder / f'{name}{k}.png', np.rint(grey).astype(np.uint8))
        return folder

    first = scenes(tmp_path / 'a', 1.0, '')
    paired = compare_images(first, scenes(tmp_path / 'b', 0.96, ''))
    alone = compare_images(first, scenes(tmp_path / 'c', 0.96, 'other'))
    assert paired.paired and not alone.paired
    one, other = (row(result, 'log gradient').difference for result in (paired, alone))
    assert one.value == pytest.approx(other.value) == pytest.approx(np.log10(0.96), abs=0.01)
    assert one.high < 0.0 < other.high and one.p < 0.01 < 0.3 < other.p
    assert one.high - one.low < 0.1 * (other.high - other.low)
    assert main(['evaluate', 'images', str(first), str(tmp_path / 'b'), '--frames', '4']) == 0
    assert 'image by image' in capsys.readouterr().out


def test_command(plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table, JSON without NaN, a figure; the same seed gives the same numbers."""
    other = write_set(tmp_path / 'b', lambda image: 0.5 * image)
    assert main(['evaluate', 'images', str(plain), str(other), '--frames', '4', '-o',
                 str(tmp_path / 'one')]) == 0
    found: Any = json.loads((tmp_path / 'one' / 'comparison.json').read_text(),
                            parse_constant=lambda word: pytest.fail(word))
    assert found == compare_images(plain, other, frames=4).to_mapping()
    assert found['a']['sampled'] == 4 and found['measures']['SGM bad-1']['a']['value'] is None
    assert (tmp_path / 'one' / 'comparison.png').stat().st_size > 10_000
    output = capsys.readouterr().out
    assert 'log gradient distance' in output and 'not in both sets: SGM bad-1' in output


@pytest.mark.parametrize(('arguments', 'problem'), [
    (['{}/none', '{}'], 'none: there is no such folder or bag'),
    (['{}', '{}'], 'holds no images; valid are a bag'),
    (['{}', '{}', '--frames', '0'], 'frames: 0 is not valid'),
    (['{}', '{}', '--width', '31'], 'width: 31 is not valid'),
    (['{}', '{}', '--width', '0'], 'width: 0 is not valid'),
    (['{}/dot', '{}/dot'], '0.png: 1 x 1 px are not valid'),
    (['{}/wide', '{}/wide', '--width', '64'], 'is 3 px high at the common width of 64 px'),
])
def test_bad_input(arguments: list[str], problem: str, tmp_path: Path,
                   capsys: pytest.CaptureFixture[str]) -> None:
    """One line each."""
    for name, shape in (('dot', (1, 1)), ('wide', (32, 640))):
        (tmp_path / name).mkdir()
        write_png(tmp_path / name / '0.png', np.zeros(shape, np.uint8))
    words = [word.format(tmp_path) for word in arguments]
    assert main(['evaluate', 'images', *words]) == 1
    error = unfolded(capsys.readouterr().err)
    assert problem in error and error.count('\n') == 1


def test_a_damaged_picture_is_named(tmp_path: Path) -> None:
    """And no number is made of it."""
    (tmp_path / '1.png').write_bytes(b'\x89PNG\r\n\x1a\n broken')
    with pytest.raises(EvaluationError, match='1.png: cannot be read as a picture'):
        compare_images(tmp_path, tmp_path)
