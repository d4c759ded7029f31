"""A data set at a glance: one HTML file with pictures, paths and numbers, and nothing outside."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from contextlib import suppress
import html
import io
from pathlib import Path
from typing import Any

import cv2
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim import topics
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import picture, read_odometry
from lunar_rover_sim.campaign.card import number
from lunar_rover_sim.campaign.layout import EPISODES
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.inspection.bag_pictures import draw_hillshade
from lunar_rover_sim.run.plan import BAG_FOLDER

THUMBNAILS = 3
_WIDTH_PX = 320
_QUALITY = 82
# Where exported sequences keep their left images.
_IMAGE_FOLDERS = ('tum/rgb', 'euroc/mav0/cam0/data', 'tartanair/image_left', 'kitti/image_0')
_SHOWN = ('distance_m', 'sun_elevation_deg', 'shadow_share', 'textured_share', 'sgm_density',
          'sgm_error_px')
# Nothing is loaded from anywhere, whatever a data set may say.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:82em;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;
text-align:right}td:first-child,th:first-child,.t{text-align:left}th{font-weight:600}
h2{margin-top:2em}section{display:flex;flex-wrap:wrap;gap:.5em;align-items:flex-start;
margin:.5em 0 1.5em}section img{height:15em;width:auto;background:#000}h3{margin:.5em 0 0}
.n{color:#666}img.w{width:100%}.e{color:#a00}@media(prefers-color-scheme:dark){
body{background:#181818;color:#ddd}td,th{border-color:#444}.n{color:#999}img.w{background:#fff}}
"""


def write_page(dataset: Path, card: dict[str, Any], output: Path, most: int = 100,
               progress: Any = lambda name: None) -> None:
    """Write the page of a data set whose card is given.

    most: episodes that are shown with pictures; the table has all. Raises BagError where the
    page cannot be written.
    """
    partial = output.with_name(f'.{output.name}.partial')
    try:
        with partial.open('w', encoding='utf-8') as file:
            for part in _parts(dataset, card, most, progress):
                file.write(part + '\n')
        partial.replace(output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise BagError(f'{output}: cannot be written: {error.strerror}') from None


def _parts(dataset: Path, card: dict[str, Any], most: int, progress: Any) -> Iterator[str]:
    title = _safe(card['name'])
    episodes = card['episodes']
    yield (f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
           f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
           f'<meta name="viewport" content="width=device-width"><title>{title}</title>'
           f'<style>{_STYLE}</style></head><body><h1>{title}</h1>')
    yield f'<p>{_safe(card["description"])}</p>'
    yield (f'<p class="n">{len(episodes)} episodes, licence {_safe(card["license"])}, '
           f'lunar_rover_sim {_safe(card["version"])}, IMU {_safe(", ".join(card["imu_presets"]))}'
           '</p>')
    yield _statistics(card)
    if episodes:
        yield _overview(card)
    yield '<h2>Episodes</h2>'
    yield _table(card)
    for name in list(episodes)[:most]:
        progress(name)
        yield _episode(dataset, name, episodes[name])
    if len(episodes) > most:
        yield f'<p class="n">{len(episodes) - most} more episodes are in the table only.</p>'
    if card['failed']:
        yield '<h2>Failed</h2><ul>' + ''.join(
            f'<li class="e">{_safe(name)}: {_safe(error)}</li>'
            for name, error in card['failed'].items()) + '</ul>'
    yield '</body></html>'


def _statistics(card: dict[str, Any]) -> str:
    rows = ['<tr><th>statistic</th><th>mean</th><th>min</th><th>max</th><th>total</th>'
            '<th class="t">meaning</th></tr>']
    for name, summary in card['statistics'].items():
        cells = ''.join(f'<td>{number(summary.get(k))}</td>' for k in ('mean', 'min', 'max',
                                                                       'total'))
        rows.append(f'<tr><td>{_safe(name)}</td>{cells}'
                    f'<td class="t">{_safe(card["meanings"][name])}</td></tr>')
    return '<h2>Statistics</h2><table>' + ''.join(rows) + '</table>'


def _table(card: dict[str, Any]) -> str:
    heads = ''.join(f'<th>{name}</th>' for name in ('episode', 'frames', *_SHOWN))
    rows = []
    for name, entry in card['episodes'].items():
        values = entry['statistics']
        cells = ''.join(f'<td>{number(values.get(key))}</td>' for key in ('frames', *_SHOWN))
        drawn = ', '.join(f'{key.rpartition(".")[2]} {number(value)}'
                          for key, value in (entry.get('drawn') or {}).items())
        rows.append(f'<tr><td>{_safe(name)}</td>{cells}<td class="t n">{_safe(drawn)}</td></tr>')
    return f'<table><tr>{heads}<th class="t">drawn</th></tr>{"".join(rows)}</table>'


def _overview(card: dict[str, Any]) -> str:
    figure = Figure(figsize=(12.0, 2.3), layout='constrained')
    for axes, name in zip(figure.subplots(1, len(_SHOWN)), _SHOWN):
        values = [v for e in card['episodes'].values()
                  if isinstance(v := e['statistics'].get(name), (int, float))]
        if values:
            axes.hist(values, bins=min(20, max(5, len(values) // 3)), color='0.45')
        axes.set_title(name, fontsize=9)
        axes.tick_params(labelsize=7)
        axes.yaxis.get_major_locator().set_params(integer=True)
    return f'<img class="w" alt="distributions" src="{_png(figure)}">'


def _episode(dataset: Path, name: str, entry: dict[str, Any]) -> str:
    folder = dataset / EPISODES / name
    parts = [f'<h3>{_safe(name)}</h3><section>']
    try:
        for stamp, image in thumbnails(folder):
            parts.append(f'<img alt="left camera, {_safe(stamp)}" src="{_jpeg(image)}">')
        path = _map(folder)
        if path:
            parts.append(f'<img alt="path on the ground" src="{path}">')
    except BagError as error:
        parts.append(f'<p class="e">{_safe(error)}</p>')
    parts.append('</section>')
    return ''.join(parts)


def thumbnails(folder: Path) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield (what it shows, image) of a few left images of an episode: bag, else an export."""
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
    for kind in _IMAGE_FOLDERS:
        files = sorted((folder / kind).glob('*.png'))
        for k in _spread(len(files)):
            read = cv2.imread(str(files[k]), cv2.IMREAD_COLOR)
            if read is not None:
                yield files[k].name, np.asarray(read[..., ::-1], dtype=np.uint8)
        if files:
            return


def _spread(count: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(THUMBNAILS, count)).astype(int).tolist()))


def _map(folder: Path) -> str:
    """Return the path over the world's hillshade as a picture; '' where there is no bag."""
    if not (folder / BAG_FOLDER).is_dir():
        return ''
    figure = Figure(figsize=(3.6, 3.6), layout='constrained')
    axes = figure.subplots()
    with open_bag(folder / BAG_FOLDER) as bag:
        if not bag.has(topics.ODOM.name):
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
    return 'data:image/png;base64,' + base64.b64encode(buffer.getvalue()).decode('ascii')


def _jpeg(image: NDArray[np.uint8]) -> str:
    scale = _WIDTH_PX / image.shape[1]
    if scale < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale,
                                      interpolation=cv2.INTER_AREA), dtype=np.uint8)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., 2::-1])
    _, data = cv2.imencode('.jpg', image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return 'data:image/jpeg;base64,' + base64.b64encode(data.tobytes()).decode('ascii')


def _safe(text: object) -> str:
    return html.escape(str(text if text is not None else ''))
