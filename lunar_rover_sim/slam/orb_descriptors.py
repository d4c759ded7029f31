"""ORB descriptors of sets of images (Rublee et al., ICCV 2011), as vocabularies are trained on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.errors import SlamError
from lunar_rover_sim.evaluation.image_layouts import ImageSet, open_images
from lunar_rover_sim.slam.vocabulary import BYTES

# Of ORB-SLAM3: scale and number of its pyramid, size of a patch, lower threshold of FAST.
_SCALE, _LEVELS, _PATCH_PX, _FAST = 1.2, 8, 31, 7


def open_sets(paths: Iterable[Path], frames: int) -> list[ImageSet]:
    """Return the sets of images at some paths, of which at most `frames` each are read.

    Raises SlamError if there is none or the number is not valid, EvaluationError or BagError where
    a path holds no images.
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

    features: most keypoints an image. Raises SlamError if that number is not valid.
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
