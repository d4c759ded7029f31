"""Rocks as masks: read from WebDataset shards, compared with what was found. No PyTorch.

A pixel is a rock where its label is 16 or more. Rocks that show fewer than 10 pixels neither teach
nor count.
"""

from __future__ import annotations

from collections import defaultdict
import io
import json
from pathlib import Path
import tarfile

import cv2
import numpy as np

FIRST_ROCK = 16
LEAST_PX = 10
IGNORED = 2
RESAMPLED = 2000


def samples(paths):
    """Yield key and files of each sample in tar files."""
    for path in paths:
        key, files = None, {}
        with tarfile.open(path) as tar:
            for member in tar:
                found, _, extension = member.name.partition('.')
                if found != key and files:
                    yield key, files
                    files = {}
                key, files[extension] = found, tar.extractfile(member).read()
        if files:
            yield key, files


def load(folder, split):
    """Return (n, h, w) uint8 pictures, (n, h, w) uint8 targets, and base and world of each.

    Targets are 1 on rocks, 0 elsewhere, IGNORED on rocks that show too few pixels.
    """
    pictures, targets, told = [], [], []
    # Shards of a data set name the scenario of each drive in the index of their split.
    index = Path(folder) / f'{split}.json'
    drives = json.loads(index.read_text()).get('drives', {}) if index.exists() else {}
    for _, files in samples(sorted(Path(folder).glob(f'{split}-*.tar'))):
        pictures.append(cv2.imdecode(np.frombuffer(files['left.png'], np.uint8),
                                     cv2.IMREAD_GRAYSCALE))
        label = np.load(io.BytesIO(files['labels.npy']))
        few = np.bincount(label.ravel(), minlength=65536) < LEAST_PX
        rock = label >= FIRST_ROCK
        targets.append(np.where(rock & few[label], IGNORED, rock).astype(np.uint8))
        about = json.loads(files['json'])
        drive = {'base': 'all', **about, **drives.get(about.get('drive'), {})}
        told.append((drive['base'], drive['world']))
    return np.stack(pictures), np.stack(targets), told


def confusion(found, target):
    """Return the pixels that are rock in both, in the prediction only, in truth only, in none."""
    known, rock = target != IGNORED, target == 1
    return np.array([(found & rock).sum(), (found & known & ~rock).sum(), (~found & rock).sum(),
                     (~found & known & ~rock).sum()])


def iou(counts):
    """Return the intersection over union of (..., 4) counts."""
    counts = np.asarray(counts, float)
    return counts[..., 0] / np.maximum(counts[..., :3].sum(axis=-1), 1.0)


def interval(counts, worlds):
    """Return the bounds of the 95 % interval of an IoU; worlds are drawn, then pictures."""
    rng = np.random.default_rng(2)
    rows = [np.flatnonzero(np.array(worlds) == world) for world in sorted(set(worlds))]
    drawn = []
    for _ in range(RESAMPLED):
        chosen = [rows[k] for k in rng.integers(0, len(rows), len(rows))]
        picked = np.concatenate([rng.choice(r, len(r)) for r in chosen])
        drawn.append(iou(counts[picked].sum(axis=0)))
    return np.quantile(drawn, [0.025, 0.975])


def scores_of(counts, told):
    """Return the scores by scenario, and of all; counts: (n, 4) as `confusion`."""
    groups = defaultdict(list)
    for k, (base, _) in enumerate(told):
        groups[base].append(k)
    if len(groups) > 1:
        groups['all'] = list(range(len(told)))
    scores = {}
    for base, rows in groups.items():
        hit, false, missed, none = map(int, counts[rows].sum(axis=0))
        low, high = interval(counts[rows], [told[k][1] for k in rows])
        scores[base] = {
            'pictures': len(rows), 'worlds': len({told[k][1] for k in rows}),
            'iou': round(float(iou([hit, false, missed, none])), 3),
            'interval': [round(float(low), 3), round(float(high), 3)],
            'precision': round(hit / max(1, hit + false), 3),
            'recall': round(hit / max(1, hit + missed), 3),
            'hit_px': hit, 'false_px': false, 'missed_px': missed, 'neither_px': none}
    return scores


def shown(picture, found, target):
    """Return a picture (BGR): hits green, false finds red, missed blue, ignored ones grey."""
    out = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    for mask, colour in ((found & (target == 1), (0, 220, 0)),
                         (found & (target == 0), (0, 0, 255)),
                         (~found & (target == 1), (255, 80, 0)),
                         (target == IGNORED, (128, 128, 128))):
        out[mask] = (0.4 * out[mask] + 0.6 * np.array(colour)).astype(np.uint8)
    return out
