"""A PyTorch data set over shards: left image, true depth and labels of each stereo frame.

Start it with a folder of `bag export BAG -o shards --format webdataset` or `dataset shards`.
"""

from collections.abc import Iterator
import io
from pathlib import Path
import sys
import tarfile

import cv2
import numpy as np

try:
    from torch.utils.data import DataLoader, get_worker_info, IterableDataset
except ImportError:     # the samples can be read without it
    DataLoader, get_worker_info, IterableDataset = None, lambda: None, object


class Shards(IterableDataset):
    """Yields (image (1, h, w) float32 from 0 to 1, depth (h, w) float32 [m], 0 for the sky)."""

    def __init__(self, folder: Path):
        self._tars = sorted(Path(folder).glob('*.tar'))
        if not self._tars:
            raise FileNotFoundError(f'{folder}: there are no shards (*.tar)')

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        worker = get_worker_info()
        for shard in self._tars if worker is None else self._tars[worker.id::worker.num_workers]:
            with tarfile.open(shard) as tar:
                key, image, depth_m = None, None, None
                for member in tar:      # the files of a sample lie together
                    name, data = member.name.partition('.'), tar.extractfile(member).read()
                    if name[0] != key:
                        key, image, depth_m = name[0], None, None
                    if name[2] == 'left.png':
                        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
                        image = pixels[None].astype(np.float32) / 255
                    elif name[2] == 'depth.npy':
                        depth_m = np.load(io.BytesIO(data)).astype(np.float32)
                        depth_m[~np.isfinite(depth_m)] = 0.0
                    if image is not None and depth_m is not None:
                        yield image, depth_m
                        image = depth_m = None


def main(folder: Path, batch: int = 4) -> int:
    """Print the shape of each batch, or sample without PyTorch; return how many there are."""
    data, count = Shards(folder), 0
    batches = data if DataLoader is None else DataLoader(data, batch_size=batch)
    for count, (image, depth_m) in enumerate(batches, 1):
        print(tuple(image.shape), f'depth up to {float(depth_m.max()):.1f} m')
    return count


if __name__ == '__main__':
    sys.exit(__doc__) if len(sys.argv) != 2 else main(Path(sys.argv[1]))
