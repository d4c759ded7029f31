"""Vocabularies: their text as DBoW2 reads it, their words, their weights."""

from collections import Counter
import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
import pytest
from snippets import module_of, ROOT

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.judge.slam.estimators import check_vocabulary

EXAMPLE = module_of(ROOT / 'examples' / 'slam' / 'train_vocabulary.py')
train = EXAMPLE.train
Bytes = NDArray[np.uint8]


def scenes(rng: np.random.Generator, count: int = 12, points: int = 60) -> list[Bytes]:
    """Return descriptors of places: each shares half of its points with the one before."""
    own = rng.integers(0, 256, (count + 1, points, 32), dtype=np.uint8)
    return [np.concatenate([own[k], own[k + 1]]) for k in range(count)]


def noisy(rows: Bytes, rng: np.random.Generator, share: float = 0.05) -> Bytes:
    """Return descriptors with some of their bits flipped, as those of another view."""
    bits = np.unpackbits(rows, axis=1)
    return np.packbits(bits ^ (rng.random(bits.shape) < share), axis=1)


class Dbow2:
    """What TemplatedVocabulary::loadFromTextFile and ::transform of DBoW2 do, line by line."""

    def __init__(self, text: str) -> None:
        header, *lines = text.split('\n')
        self.k, self.levels, self.scoring, self.weighting = map(int, header.split())
        self.children: list[list[int]] = [[]]
        self.centres = [np.zeros(32, np.uint8)]
        self.weights = [0.0]
        self.words = []
        for line in lines:      # an empty line would be a node of garbage
            parent, leaf, *bytes_, weight = line.split(' ')
            node = len(self.children)
            self.children[int(parent)].append(node)     # the parent is known already
            self.children.append([])
            self.centres.append(np.array([int(b) for b in bytes_], np.uint8))
            self.weights.append(float(weight))
            if leaf == '1':
                self.words.append(node)
            else:
                assert leaf == '0' and float(weight) == 0.0

    def word(self, descriptor: Bytes) -> int:
        node = 0
        while self.children[node]:
            node = min(self.children[node], key=lambda child: int(
                np.unpackbits(self.centres[child] ^ descriptor).sum()))
        return node

    def bag(self, rows: Bytes) -> dict[int, float]:
        counts = Counter(self.word(row) for row in rows)
        total = sum(count * self.weights[word] for word, count in counts.items())
        return {word: count * self.weights[word] / total for word, count in counts.items()}


def score(a: dict[int, float], b: dict[int, float]) -> float:
    """Return the similarity of two images: 1 - |a - b| / 2, the L1 score of DBoW2."""
    return 1.0 - 0.5 * sum(abs(a.get(w, 0.0) - b.get(w, 0.0)) for w in a.keys() | b.keys())


def test_the_text_is_a_tree_that_dbow2_reads() -> None:
    images = scenes(np.random.default_rng(1))
    read = Dbow2(train(images, branching=5, levels=3, seed=1).text())
    assert (read.k, read.levels, read.scoring, read.weighting) == (5, 3, 0, 0)
    assert all(len(centre) == 32 for centre in read.centres)
    # The words are the leaves; a node has 2 to k children; no leaf is deeper than L.
    assert read.words == [n for n, below in enumerate(read.children) if n and not below]
    assert all(2 <= len(below) <= 5 for below in read.children if below)
    depth = [0] * len(read.children)
    for node, below in enumerate(read.children):
        for child in below:
            assert child > node
            depth[child] = depth[node] + 1
    assert max(depth) == 3
    assert len(read.words) > 50     # of 125


def test_weights_are_inverse_frequencies_of_images() -> None:
    """By descending the tree anew: ln(N / images that contain the word)."""
    images = scenes(np.random.default_rng(2))
    read = Dbow2(train(images, branching=4, levels=3, seed=1).text())
    containing = Counter(word for rows in images for word in {read.word(row) for row in rows})
    assert sum(containing.values()) > len(read.words)
    for word in read.words:     # every word has a descriptor that it is made of
        assert read.weights[word] == pytest.approx(math.log(len(images) / containing[word]),
                                                   rel=1e-5)


def test_a_place_is_recognised() -> None:
    """Another view of a place is more alike to it than neighbours that share half of it."""
    rng = np.random.default_rng(3)
    images = scenes(rng)
    read = Dbow2(train(images, branching=8, levels=3, seed=1).text())
    known = [read.bag(rows) for rows in images]
    for k, rows in enumerate(images):
        seen = read.bag(noisy(rows, rng))
        scores = [score(seen, bag) for bag in known]
        assert int(np.argmax(scores)) == k
        others = [s for j, s in enumerate(scores) if abs(j - k) > 1]
        assert scores[k] > 2.0 * max(others)


def test_k_majority_finds_clusters() -> None:
    """Descriptors around four centres: the first level is these centres, bit by bit."""
    rng = np.random.default_rng(4)
    centres = rng.integers(0, 256, (4, 32), dtype=np.uint8)
    rows = noisy(np.repeat(centres, 200, axis=0), rng, 0.1)
    found = train([rows], branching=4, levels=1, seed=2)
    assert sorted(map(bytes, found.centres)) == sorted(map(bytes, centres))


def test_one_seed_is_one_vocabulary() -> None:
    images = scenes(np.random.default_rng(5), 4)
    assert train(images, 6, 2, seed=3).text() == train(images, 6, 2, seed=3).text()
    assert train(images, 6, 2, seed=3).text() != train(images, 6, 2, seed=4).text()


def test_what_is_not_valid() -> None:
    rows = np.zeros((5, 32), np.uint8)
    for k, levels, words in ((1, 2, 'branching: 1 is not valid'), (21, 2, 'branching: 21'),
                             (10, 0, 'levels: 0 is not valid; valid is 1 to 10')):
        with pytest.raises(SlamError, match=words):
            train([rows], k, levels)
    for images in ([], [rows], [rows[:0]], [rows[:1]]):     # no features, or all of them equal
        with pytest.raises(SlamError, match='are not enough'):
            train(images)


def test_pictures_become_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And existing files and folders without pictures are refused."""
    rng = np.random.default_rng(6)
    (tmp_path / 'pictures').mkdir()
    for k in range(3):
        coarse = rng.integers(0, 256, (30, 40), dtype=np.uint8)
        cv2.imwrite(str(tmp_path / f'pictures/{k}.png'),
                    cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_NEAREST))
    file = tmp_path / 'voc.txt'
    words = [str(tmp_path / 'pictures'), '-o', str(file), '--levels', '2', '--frames', '2']
    EXAMPLE.main(words)
    read = Dbow2(file.read_text())
    assert f'{file}: {len(read.words)} words of ' in capsys.readouterr().out
    assert 50 < len(read.words) <= 100
    check_vocabulary(file)      # as `slam run` does
    (tmp_path / 'empty').mkdir()
    for wrong, said in ((words, 'exists already'),
                        ([str(tmp_path / 'empty'), '-o', str(tmp_path / 'x')],
                         'holds no images')):
        with pytest.raises(SystemExit):
            EXAMPLE.main(wrong)
        assert said in capsys.readouterr().err and not (tmp_path / 'x').exists()
