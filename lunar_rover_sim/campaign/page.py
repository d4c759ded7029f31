"""A data set at a glance: one HTML file with pictures, paths and numbers, and nothing outside."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
import dataclasses
import io
from pathlib import Path
from typing import Any, BinaryIO

import cv2
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import picture, read_odometry
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, CampaignError
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.images import read_picture
from lunar_rover_sim.base.files.paths import BAG_FOLDER
from lunar_rover_sim.base.files.templates import data_uri, template
from lunar_rover_sim.campaign.card import LARGEST, number
from lunar_rover_sim.campaign.layout import EPISODES
from lunar_rover_sim.products.inspection.bag_pictures import draw_hillshade
from lunar_rover_sim.products.sequences.export import FORMATS

THUMBNAILS = 3
_WIDTH_PX = 320
_QUALITY = 82
_SHOWN = ('distance_m', 'sun_elevation_deg', 'shadow_share', 'textured_share', 'sgm_density',
          'sgm_error_px')


@dataclasses.dataclass(frozen=True)
class EpisodePictures:
    """Pictures of an episode as (title, data URI), and why there are no more of them, or ''."""

    name: str
    images: list[tuple[str, str]]
    error: str = ''


def write_page(dataset: Path, card: dict[str, Any], output: Path, most: int = 100,
               progress: Callable[[str], object] = lambda name: None) -> None:
    """Write the page of a data set with the given card.

    Args:
        most: Number of episodes that are shown with pictures; the table has all.
        progress: Called with the name of each of these.

    Raises:
        CampaignError: If the page cannot be written.
    """
    names = list(card['episodes'])

    def pictures() -> Iterator[EpisodePictures]:
        for name in names[:most]:
            progress(name)
            yield _pictures(dataset / EPISODES / name)

    def write(file: BinaryIO) -> None:
        page = template('lunar_rover_sim.campaign', 'dataset.html', number=number)
        page.stream(card=card, shown=('frames', *_SHOWN), pictures=pictures(),
                    distributions=_distributions(card) if names else '',
                    left_out=max(0, len(names) - most)).dump(file, encoding='utf-8')

    atomic_write(output, write, CampaignError)


def _distributions(card: dict[str, Any]) -> str:
    """Return histograms of some statistics over the episodes."""
    figure = Figure(figsize=(12.0, 2.3), layout='constrained')
    for axes, name in zip(figure.subplots(1, len(_SHOWN)), _SHOWN):
        values = [v for e in card['episodes'].values()
                  if isinstance(v := e['statistics'].get(name), (int, float))
                  and abs(v) <= LARGEST]
        if values:
            axes.hist(values, bins=min(20, max(5, len(values) // 3)), color='0.45')
        axes.set_title(name, fontsize=9)
        axes.tick_params(labelsize=7)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    return _png(figure)


def _pictures(folder: Path) -> EpisodePictures:
    images = []
    error = ''
    try:
        images += [(f'left camera, {title}', _jpeg(image)) for title, image in thumbnails(folder)]
        path = _map(folder)
        if path:
            images.append(('path on the ground', path))
    except (BagError, CampaignError) as problem:
        error = str(problem)
    return EpisodePictures(folder.name, images, error)


def thumbnails(folder: Path) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield (title, image) of a few left images of an episode, from its bag or an export."""
    bag_folder = folder / BAG_FOLDER
    if bag_folder.is_dir():
        with open_bag(bag_folder) as bag:
            if not bag.has(topics.LEFT_IMAGE.name):
                return
            stamps = [m.time_ns for m in bag.raw([topics.LEFT_IMAGE.name])]
            for k in _spread(len(stamps)):
                for _, _, message in bag.messages([topics.LEFT_IMAGE.name], stamps[k],
                                                  stamps[k] + 1):
                    image = picture(bag, message).pixels
                    if image.dtype == np.uint16:
                        image = (image >> 8).astype(np.uint8)
                    yield f'{stamps[k] / 1e9:.1f} s', image
        return
    for images in (folder / kind / name for kind, made in FORMATS.items()
                   for name in made.left_images):
        files = sorted(images.glob('*.png'))
        for k in _spread(len(files)):
            yield files[k].name, read_picture(files[k], CampaignError, colour=True)
        if files:
            return


def _spread(count: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(THUMBNAILS, count)).astype(int).tolist()))


def _map(folder: Path) -> str:
    """Return a picture of the path over the world's hillshade; '' if there is no bag."""
    if not (folder / BAG_FOLDER).is_dir():
        return ''
    figure = Figure(figsize=(3.6, 3.6), layout='constrained')
    axes = figure.subplots()
    with open_bag(folder / BAG_FOLDER) as bag:
        if not bag.has(bag.truth):
            return ''
        xy = read_odometry(bag).positions_m[:, :2]
        if not len(xy):
            return ''
        low, high = xy.min(axis=0), xy.max(axis=0)
        centre, half = (low + high) / 2, max(0.75 * float((high - low).max()), 1.5)
        with suppress(BagError):
            draw_hillshade(axes, bag, centre, half)
    axes.plot(xy[:, 0], xy[:, 1], color='tab:red', lw=1.5)
    axes.plot(*xy[0], 'o', color='tab:green', ms=5)
    axes.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half),
             aspect='equal')
    axes.set_xlabel('x, east [m]', fontsize=8)
    axes.set_ylabel('y, north [m]', fontsize=8)
    axes.tick_params(labelsize=7)
    return _png(figure)


def _png(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=90)
    return data_uri(buffer.getvalue(), 'image/png')


def _jpeg(image: NDArray[np.uint8]) -> str:
    scale = _WIDTH_PX / image.shape[1]
    if scale < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale,
                                      interpolation=cv2.INTER_AREA), dtype=np.uint8)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., 2::-1])
    _, data = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data_uri(data.tobytes(), 'image/jpeg')
