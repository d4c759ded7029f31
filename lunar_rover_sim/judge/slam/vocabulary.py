"""Vocabularies of binary words, by which SLAM programs recognise a place they have seen.

Descriptors of many images are divided into k clusters, each of these again, L times (Nister and
Stewenius, CVPR 2006; with binary descriptors Galvez-Lopez and Tardos, IEEE T-RO 28 (5), 2012).
The leaves are the words. A word that few images contain weighs more: ln(N / N_w), of N images N_w
of which contain it (Sivic and Zisserman, ICCV 2003). The text format is that of DBoW2 as
ORB-SLAM2 and ORB-SLAM3 read it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
import dataclasses
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.judge.evaluation.image_layouts import ImageSet, open_images

BYTES = 32              # of an ORB descriptor
_MOST_FITTED = 1 << 16  # rows that centres are fitted to; all rows are then assigned
_MOST_STEPS = 20        # of k-majority; it nearly always ends before
_CHUNK = 1 << 15        # rows whose bits are unpacked at a time
_L1, _TF_IDF = 0, 0     # codes of score and weights in DBoW2

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]
Bits = NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class Vocabulary:
    """A tree of n nodes without its root; parents come before their children.

    Attributes:
        branching, levels: k and L of the training.
        parents: (n,) number of the parent; 0 is the root, the nodes count from 1.
        centres: (n, 32) descriptors of 256 bits.
        is_word: (n,) whether the node is a leaf.
        weights: (n,) of words; 0 for other nodes.
    """

    branching: int
    levels: int
    parents: Indices
    centres: Bytes
    is_word: NDArray[np.bool_]
    weights: NDArray[np.float64]

    def text(self) -> str:
        """Return the text format of DBoW2: a header, then one line a node.

        The last line has no line feed: DBoW2 would read an empty line after it as one more node.
        """
        lines = [f'{self.branching} {self.levels} {_L1} {_TF_IDF}']
        for parent, centre, leaf, weight in zip(self.parents.tolist(), self.centres.tolist(),
                                                self.is_word.tolist(), self.weights.tolist()):
            lines.append(f'{parent} {leaf:d} {" ".join(map(str, centre))} {weight:.6g}')
        return '\n'.join(lines)


def train(images: Sequence[Bytes], branching: int = 10, levels: int = 6, seed: int = 0,
          step: Callable[[float], None] = lambda _share: None) -> Vocabulary:
    """Return a vocabulary of the descriptors of images.

    Clusters are fitted by k-majority in Hamming distance from a k-means++ start (Arthur and
    Vassilvitskii, SODA 2007), at most 65536 rows of a node. The same images and seed give the same
    vocabulary.

    Args:
        images: (n, 32) descriptors of each image.
        branching, levels: Clusters of a node, and how often they are divided.
        step: Called with the share of the work that is done.

    Raises:
        SlamError: If an argument is not valid or the images have too little to tell.
    """
    # The reader of DBoW2 takes no other numbers.
    for name, value, low, high in (('branching', branching, 2, 20), ('levels', levels, 1, 10)):
        if not low <= value <= high:
            raise SlamError(f'{name}: {value} is not valid; valid is {low} to {high}')
    rows = np.concatenate([np.zeros((0, BYTES), np.uint8), *images])
    image_of = np.repeat(np.arange(len(images)), [len(image) for image in images])
    rng = np.random.default_rng(seed)
    parents: list[int] = []
    centres: list[Bytes] = []
    words: list[int] = []           # numbers of the nodes that are leaves
    word_of = np.zeros(len(rows), np.int64)
    # The root first; breadth first, so that parents come before their children.
    waiting = deque([(0, np.arange(len(rows)), 0)])
    done = 0
    while waiting:
        node, members, level = waiting.popleft()
        found = np.zeros((0, BYTES), np.uint8)
        if level < levels and len(members) > 1:
            found, cluster_of = _divided(rows[members], branching, rng)
        if len(found) < 2:
            if node == 0:
                raise SlamError(f'vocabulary: {len(rows)} descriptors of {len(images)} images '
                                'are not enough; valid are images with several features')
            words.append(node)
            word_of[members] = node
            done += len(members)
            step(done / len(rows))
            continue
        # Members in the order of their clusters: cut, rather than searched for each of them.
        order = np.argsort(cluster_of, kind='stable')
        cuts = np.searchsorted(cluster_of[order], np.arange(1, len(found)))
        for centre, part in zip(found, np.split(members[order], cuts)):
            parents.append(node)
            centres.append(centre)
            waiting.append((len(parents), part, level + 1))
    is_word = np.zeros(len(parents), bool)
    is_word[np.array(words) - 1] = True
    seen = np.unique(np.stack([word_of, image_of], axis=1), axis=0)[:, 0]
    counts = np.bincount(seen, minlength=len(parents) + 1)[1:]
    weights = np.where(is_word, np.log(len(images) / np.maximum(counts, 1)), 0.0)
    return Vocabulary(branching, levels, np.array(parents), np.array(centres), is_word, weights)


def _divided(rows: Bytes, k: int, rng: np.random.Generator) -> tuple[Bytes, Indices]:
    """Return at most k centres, and for each row the index of its centre.

    Each centre is the nearest one of some row.
    """
    distinct = np.unique(rows, axis=0) if len(rows) <= k else rows
    if len(distinct) <= k:
        centres = distinct
    else:
        fitted = rows
        if len(rows) > _MOST_FITTED:
            fitted = rows[np.sort(rng.choice(len(rows), _MOST_FITTED, replace=False))]
        centres = _fit(_bits(fitted), k, rng)
    centre_bits = _bits(centres)
    cluster_of = np.concatenate([_nearest(_bits(rows[start:start + _CHUNK]), centre_bits)
                                 for start in range(0, len(rows), _CHUNK)])
    used, cluster_of = np.unique(cluster_of, return_inverse=True)
    return centres[used], cluster_of


def _fit(bits: Bits, k: int, rng: np.random.Generator) -> Bytes:
    """Return the centres of k-majority: in turn, nearest centre and majority of its rows."""
    centres = _start(bits, k, rng)
    before = np.zeros(0, np.int64)
    for _ in range(_MOST_STEPS):
        cluster_of = _nearest(bits, centres)
        if np.array_equal(cluster_of, before):
            break
        before = cluster_of
        members = np.zeros((len(centres), len(bits)), np.float32)
        members[cluster_of, np.arange(len(bits))] = 1.0
        counts = members.sum(axis=1, keepdims=True)
        # A centre without rows stays where it is.
        centres = np.where(counts > 0.0, 2.0 * (members @ bits) >= counts,
                           centres).astype(np.float32)
    return np.packbits(centres.astype(np.uint8), axis=1)


def _start(bits: Bits, k: int, rng: np.random.Generator) -> Bits:
    """Return rows far from each other: k-means++; Hamming is squared Euclidean distance here."""
    chosen = [bits[rng.integers(len(bits))]]
    nearest = np.abs(bits - chosen[0]).sum(axis=1, dtype=np.float64)
    while len(chosen) < k and nearest.any():
        chosen.append(bits[rng.choice(len(bits), p=nearest / nearest.sum())])
        nearest = np.minimum(nearest, np.abs(bits - chosen[-1]).sum(axis=1))
    return np.array(chosen)


def _nearest(bits: Bits, centres: Bits) -> Indices:
    """Return the nearest centre of each row: |x - c|² = |x|² + |c|² - 2 x·c, without |x|²."""
    return np.argmin(centres.sum(axis=1) - 2.0 * (bits @ centres.T), axis=1)


def _bits(rows: Bytes) -> Bits:
    return np.unpackbits(rows, axis=1).astype(np.float32)


# Of ORB-SLAM3: scale and number of its pyramid, size of a patch, lower threshold of FAST.
_SCALE, _LEVELS, _PATCH_PX, _FAST = 1.2, 8, 31, 7


def open_sets(paths: Iterable[Path], frames: int) -> list[ImageSet]:
    """Return the sets of images at some paths, of which at most `frames` each are read.

    Raises:
        SlamError: If there is none or the number is not valid.
        EvaluationError, BagError: Where a path holds no images.
    """
    if frames < 1:
        raise SlamError(f'frames: {frames} is not valid; valid is >= 1')
    sets = [found._replace(total=min(frames, found.total)) for found in map(open_images, paths)]
    if not sets:
        raise SlamError('there are no images; name bags or folders of pictures')
    return sets


def descriptors(sets: Iterable[ImageSet],
                features: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the (n, 32) descriptors of each left image, evenly over the sets.

    Args:
        features: Most keypoints an image.

    Raises:
        SlamError: If that number is not valid.
    """
    if not 1 <= features <= 100_000:
        raise SlamError(f'features: {features} is not valid; valid is 1 to 100000')
    orb = cv2.ORB.create(features, _SCALE, _LEVELS, patchSize=_PATCH_PX, fastThreshold=_FAST)
    for images in sets:
        for pair in images.read(images.total):
            # Grey levels are the root of the signal, which is what cameras give to a tracker.
            pixels = np.rint(255.0 * pair.left).astype(np.uint8)
            found = orb.detectAndCompute(pixels, None)[1]
            yield np.zeros((0, BYTES), np.uint8) if found is None else np.asarray(found, np.uint8)
