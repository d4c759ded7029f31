"""Trains a vocabulary of binary words, by which SLAM programs recognise a place they have seen.

    python examples/slam/train_vocabulary.py runs/words/bag -o lunar_voc.txt --levels 5

Descriptors of many images are divided into k clusters, each of these again, L times (Nister and
Stewenius, CVPR 2006; with binary descriptors Galvez-Lopez and Tardos, IEEE T-RO 28 (5), 2012).
The leaves are the words. A word that few images contain weighs more: ln(N / N_w), of N images N_w
of which contain it (Sivic and Zisserman, ICCV 2003). The text format is that of DBoW2 as
ORB-SLAM2 and ORB-SLAM3 read it.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import LunarRoverSimError, SlamError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.judge.evaluation.image_layouts import open_images

BYTES = 32              # of an ORB descriptor
_MOST_FITTED = 1 << 16  # rows that centres are fitted to; all rows are then assigned
_MOST_STEPS = 20        # of k-majority; it nearly always ends before
_CHUNK = 1 << 15        # rows whose bits are unpacked at a time
_L1, _TF_IDF = 0, 0     # codes of score and weights in DBoW2

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]
Bits = NDArray[np.float32]


class Vocabulary(NamedTuple):
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


def train(images: Sequence[Bytes], branching: int = 10, levels: int = 6,
          seed: int = 0) -> Vocabulary:
    """Return a vocabulary of the descriptors of images.

    Clusters are fitted by k-majority in Hamming distance from a k-means++ start (Arthur and
    Vassilvitskii, SODA 2007), at most 65536 rows of a node. The same images and seed give the same
    vocabulary.

    Args:
        images: (n, 32) descriptors of each image.
        branching, levels: Clusters of a node, and how often they are divided.

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


_DESCRIPTORS_PER_WORD = 3      # fewer, and most leaves of the tree hold one
# Of ORB-SLAM3: scale and number of its pyramid, size of a patch, lower threshold of FAST.
_SCALE, _LEVELS, _PATCH_PX, _FAST = 1.2, 8, 31, 7


def descriptors(images: Path, features: int, frames: int) -> Iterator[Bytes]:
    """Yield the (n, 32) descriptors of each left image of a set, evenly over it."""
    orb = cv2.ORB.create(features, _SCALE, _LEVELS, patchSize=_PATCH_PX, fastThreshold=_FAST)
    for pair in open_images(images).read(frames):
        # Grey levels are the root of the signal, which is what cameras give to a tracker.
        found = orb.detectAndCompute(np.rint(255.0 * pair.left).astype(np.uint8), None)[1]
        yield np.zeros((0, BYTES), np.uint8) if found is None else np.asarray(found, np.uint8)


def main(words: Sequence[str] | None = None) -> None:
    """Train on bags, runs, sequences and folders of pictures; write a new file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('images', type=Path, nargs='+')
    parser.add_argument('-o', '--output', type=Path, required=True)
    for name, value, text in (('branching', 10, 'clusters of a node'),
                              ('levels', 6, 'how often clusters are divided'),
                              ('features', 1000, 'keypoints per image'),
                              ('frames', 500, 'most images of each set'), ('seed', 1, 'clusters')):
        parser.add_argument(f'--{name}', type=int, default=value, help=text)
    args = parser.parse_args(words)
    if args.output.exists():
        parser.error(f'{args.output} exists already')
    try:
        rows = [one for images in args.images
                for one in descriptors(images, args.features, args.frames)]
        print(f'{len(rows)} images; dividing {sum(map(len, rows))} descriptors', flush=True)
        vocabulary = train(rows, args.branching, args.levels, args.seed)
        atomic_write(args.output, vocabulary.text(), SlamError)
    except LunarRoverSimError as error:
        parser.error(str(error))
    count, total = int(vocabulary.is_word.sum()), sum(map(len, rows))
    print(f'{args.output}: {count} words of {total} descriptors of {len(rows)} images')
    if total < _DESCRIPTORS_PER_WORD * count:
        print('note: a word needs a few descriptors to mean something; give more images, or fewer '
              f'--levels than {args.levels}')


if __name__ == '__main__':
    main()
