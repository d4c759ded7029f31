"""What lies over and under the pictures of a film: captions, and plots over time."""

from __future__ import annotations

from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lunar_rover_sim.frames import Array

U8 = NDArray[np.uint8]

_FACE, _INK, _GRID = '#101114', '#d8dade', '#34373d'
_COLOURS = '#6cb6ff', '#ffb454'
_TO_COME = 0.30         # brightness of what has not happened yet
_CURSOR = 235
_PERCENTILES = 0.5, 99.5
_DPI = 100


class Captions:
    """Writes into pictures of RGB."""

    def __init__(self, width: int) -> None:
        """Choose sizes; width: of the film [px]."""
        file = font_manager.findfont('DejaVu Sans')
        self._large = ImageFont.truetype(file, max(width // 45, 10))
        self._small = ImageFont.truetype(file, max(width // 80, 8))
        self._margin = max(width // 90, 4)

    def draw(self, picture: U8, left: str, right: str) -> None:
        """Write into the lower corners."""
        h, w = picture.shape[:2]
        self._write(picture, (self._margin, h - self._margin), left, 'ls', self._large)
        self._write(picture, (w - self._margin, h - self._margin), right, 'rs', self._large)

    def label(self, picture: U8, text: str) -> None:
        """Write into the upper left corner."""
        self._write(picture, (self._margin // 2, self._margin // 2), text, 'lt', self._small)

    @staticmethod
    def _write(picture: U8, at: tuple[int, int], text: str, anchor: str,
               font: ImageFont.FreeTypeFont) -> None:
        image = Image.fromarray(picture)
        ImageDraw.Draw(image).text(at, text, fill=(255, 255, 255), font=font, anchor=anchor,
                                   stroke_width=2, stroke_fill=(0, 0, 0))
        picture[...] = np.asarray(image)


def pace_caption(speed: float, real_time_factor: float | None) -> str:
    """Return how fast a film is, and how fast its drive was recorded, if that is known."""
    recorded = '' if real_time_factor is None else f'real-time factor {real_time_factor:.2g}, '
    return f'{recorded}film speed × {speed:g}'


class Plots:
    """Pitch and slip over time, with a line that moves on; what is to come is dim."""

    def __init__(self, size: tuple[int, int], span_s: tuple[float, float],
                 pitch: tuple[Array, Array], slip: tuple[Array, Array]) -> None:
        """Draw both curves once.

        size: width and height [px]; span_s: first and last time; pitch: times [s] and [deg];
        slip: times [s] and ratios
        """
        width, height = size
        self._span_s = span_s
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=_FACE)
        canvas = FigureCanvasAgg(figure)
        font = max(height / 22.0, 5.0) * 72.0 / _DPI
        left, right = 5.2 * font / 72.0 * _DPI / width, 0.985
        axes = [figure.add_axes((left, bottom, right - left, 0.36)) for bottom in (0.58, 0.15)]
        for ax, (times, values), colour, name in zip(
                axes, (pitch, (slip[0], 100.0 * slip[1])), _COLOURS,
                ('pitch [°]', 'slip [%], over 1 s')):
            inside = (times >= span_s[0]) & (times <= span_s[1])
            ax.plot(times, values, color=colour, lw=max(height / 240.0, 0.6))
            ax.set_xlim(span_s)
            known = values[inside & np.isfinite(values)]
            if len(known):
                low, high = np.percentile(known, _PERCENTILES)
                room = 0.15 * max(high - low, 1e-3)
                ax.set_ylim(low - room, high + room)
            ax.set_facecolor(_FACE)
            ax.grid(color=_GRID, lw=0.5)
            ax.tick_params(colors=_INK, labelsize=font, length=2, pad=1)
            # Above the axes, where no curve is.
            ax.text(0.0, 1.02, name, color=colour, fontsize=font, transform=ax.transAxes,
                    va='bottom')
            for spine in ax.spines.values():
                spine.set_color(_GRID)
        axes[0].tick_params(labelbottom=False)
        axes[1].set_xlabel('time [s]', color=_INK, fontsize=font, labelpad=1)
        canvas.draw()
        self._picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
        boxes = [ax.get_window_extent() for ax in axes]
        self._columns = boxes[0].x0, boxes[0].x1
        self._bands = [(height - round(box.y1), height - round(box.y0)) for box in boxes]

    def at(self, time_s: float) -> U8:
        """Return the (h, w, 3) RGB picture at a time."""
        picture = self._picture.copy()
        first, last = self._columns
        start, end = self._span_s
        share = np.clip((time_s - start) / max(end - start, 1e-9), 0.0, 1.0)
        column = int(round(first + share * (last - first)))
        for top, bottom in self._bands:
            ahead = picture[top:bottom, column:int(last)]
            ahead[...] = (_TO_COME * ahead).astype(np.uint8)
        column = min(column, picture.shape[1] - 1)
        for top, bottom in self._bands:
            picture[top:bottom, column] = _CURSOR
        return picture
