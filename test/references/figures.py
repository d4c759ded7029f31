"""What figures show, as data: lines, images, points, texts and limits."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from typing import Any

from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator
import numpy as np
import pytest


def drawn(figure: Any) -> dict[str, Any]:
    """Return what is drawn on each of the axes of a figure."""
    result: dict[str, Any] = {'size': list(map(float, figure.get_size_inches())),
                              'title': figure.get_suptitle().partition(' hash')[0]}
    for k, axes in enumerate(figure.axes):
        legend = axes.get_legend()
        shown = {
            'title': axes.get_title(), 'x': axes.get_xlabel(), 'y': axes.get_ylabel(),
            'scales': f'{axes.get_xscale()} {axes.get_yscale()}', 'shown': axes.axison,
            'limits': np.array([*axes.get_xlim(), *axes.get_ylim()]),
            'ticks': [list(map(float, axis.get_ticklocs())) for axis in (axes.xaxis, axes.yaxis)
                      if isinstance(axis.get_major_locator(), FixedLocator)],
            'legend': [] if legend is None else [text.get_text() for text in legend.get_texts()],
            'texts': [f'{text.get_text()} {text.get_position()}' for text in axes.texts],
            'lines': [_line(line) for line in axes.lines],
            'images': [_image(image) for image in axes.images],
            'patches': [np.asarray(patch.get_path().vertices)[:200] for patch in axes.patches],
            'collections': [_collection(one) for one in axes.collections]}
        result[f'axes {k}'] = {name: value for name, value in shown.items()
                               if not isinstance(value, list) or value}
    return result


def _line(line: Any) -> dict[str, Any]:
    return {'data': np.asarray(line.get_xydata(), float), 'label': line.get_label(),
            'style': ' '.join(map(str, (
                to_hex(line.get_color()), line.get_linestyle(), line.get_marker(),
                f'{line.get_linewidth():g}', f'{line.get_markersize():g}', line.get_alpha())))}


def _image(image: Any) -> dict[str, Any]:
    return {'data': np.ma.filled(image.get_array().astype(np.float32), np.nan),
            'limits': list(map(float, image.get_clim())),
            'extent': list(map(float, image.get_extent())), 'colours': image.get_cmap().name}


def _collection(collection: Any) -> dict[str, Any]:
    paths = [path.vertices for path in collection.get_paths()]
    return {'places': np.asarray(collection.get_offsets(), float),
            'sizes': np.asarray(getattr(collection, 'get_sizes', list)(), float),
            'outlines': np.concatenate([np.zeros((1, 2)), *paths])[:2000],
            'widths': np.asarray(collection.get_linewidths(), float),
            'colours': np.asarray(collection.get_facecolors(), float)}


@contextlib.contextmanager
def instead_of_files() -> Iterator[list[Figure]]:
    """Keep the figures that are saved, and write none."""
    figures: list[Figure] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, 'savefig', lambda figure, *args, **options: figures.append(figure))
        yield figures
