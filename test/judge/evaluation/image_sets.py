"""Sets of images of a made texture."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lunar_rover_sim.base.files.images import write_png

HEIGHT, WIDTH, SHIFT_PX, IMAGES = 120, 192, 7, 10


def texture(seed: int, exponent: float = 2.4, height: int = HEIGHT,
            width: int = WIDTH + SHIFT_PX) -> np.ndarray:
    """Return an image whose power falls with that power of the frequency, 0.1 to 0.9."""
    rng = np.random.default_rng(seed)
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    radius[0, 0] = np.inf
    phase = np.exp(2j * np.pi * rng.uniform(size=radius.shape))
    image = np.fft.irfft2(radius**(-exponent / 2.0) * phase, (height, width))
    image = 0.5 + 0.13 * (image - image.mean()) / image.std()
    return np.clip(image, 0.1, 0.9)


def write_set(folder: Path, change: Callable[[np.ndarray], np.ndarray] = lambda image: image,
              seed: int = 0, exponent: float = 2.4) -> Path:
    """Write pairs with a disparity of SHIFT_PX everywhere."""
    (folder / 'left').mkdir(parents=True)
    (folder / 'right').mkdir()
    for k in range(IMAGES):
        wide = np.clip(change(texture(100 * seed + k, exponent)), 0.0, 1.0)
        grey = np.rint(255.0 * wide).astype(np.uint8)
        write_png(folder / 'left' / f'{k}.png', grey[:, :WIDTH])
        write_png(folder / 'right' / f'{k}.png', grey[:, SHIFT_PX:])
    return folder
