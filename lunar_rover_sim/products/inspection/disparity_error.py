"""Disparity against true depth: the error split into shift, lag along the columns and scale.

Only well textured pixels are judged, since in shadows semi-global matching follows the noise.
There its error e is described by e = shift + lag * dd/dv + scale * d, d the true disparity and v
the row. A wrong principal point or rounding gives a shift, a wrong focal length or baseline a
scale, and a depth image that is displaced against the images a lag. The five-path variant of
OpenCV's matcher aggregates from above only and lags by itself, unless its result is refined: on
synthetic planes by 0.75 rows (0.10 px at a slope of 0.10 px a row, 0.19 px at 0.25), where the
eight-path variant does not lag.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.stereo.depth import DisparityMap
from lunar_rover_sim.image.stereo.error import disparity_errors_px

MIN_PIXELS = 300
_MIN_GRADIENT = 20.0 / 255.0  # over two columns, of full scale
_OUTLIER_PX = 2.0
_INLIER_PX = 1.0


@dataclasses.dataclass(frozen=True)
class FrameError:
    """Disparity of one frame against its true depth, over its textured pixels.

    Attributes:
        pixels: Number of judged pixels; with fewer than MIN_PIXELS all errors are NaN.
        median_px, bias_px: Median of the absolute and of the signed error.
        shift_px, lag_rows, scale: As in the module's description.
        outliers: Share that is off by more than 2 px.
        matched: Share of all pixels with a true disparity in range that were matched.
    """

    stamp_ns: int
    pixels: int
    median_px: float
    bias_px: float
    shift_px: float
    lag_rows: float
    scale: float
    outliers: float
    matched: float


def disparity_map(message: Any, disparity_px: NDArray[np.float32]) -> DisparityMap:
    """Return the map that a stereo_msgs/DisparityImage with these pixels holds."""
    roi = message.valid_window
    return DisparityMap(disparity_px, message.min_disparity, message.max_disparity,
                        message.delta_d, (roi.x_offset, roi.y_offset, roi.width, roi.height),
                        message.f, message.t)


def is_textured(grey: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where the brightness of an (h, w) or (h, w, 3) image changes along its rows."""
    full = float(np.iinfo(grey.dtype).max) if grey.dtype.kind == 'u' else 1.0
    if grey.ndim == 3:
        grey = grey[..., 1]
    levels = grey.astype(np.float32) / full
    result = np.zeros(grey.shape[:2], dtype=bool)
    result[:, 1:-1] = np.abs(levels[:, 2:] - levels[:, :-2]) > _MIN_GRADIENT
    return result


def frame_error(stamp_ns: int, disparity: DisparityMap, true_px: NDArray[np.float32],
                textured: NDArray[np.bool_] | None) -> FrameError:
    """Compare a disparity map with the true disparity of the same size [px]."""
    in_range = (true_px >= max(disparity.min_disparity_px, 1.0)) \
        & (true_px <= disparity.max_disparity_px)
    x, y, width, height = disparity.valid_window
    if width and height:
        window = np.zeros(in_range.shape, dtype=bool)
        window[y:y + height, x:x + width] = True
        in_range &= window
    both = disparity.has_finite_depth & in_range
    matched = float(both.sum() / max(1, in_range.sum()))
    slope = np.zeros(true_px.shape)
    with np.errstate(invalid='ignore'):
        slope[1:-1] = 0.5 * (true_px[2:] - true_px[:-2])
    judged = both & (np.abs(slope) < 1.0)
    if textured is not None and textured.shape == judged.shape:
        judged &= textured
    count = int(judged.sum())
    if count < MIN_PIXELS:
        nan = float('nan')
        return FrameError(stamp_ns, count, nan, nan, nan, nan, nan, nan, matched)
    error = disparity_errors_px(disparity, true_px, judged).astype(float)
    model = np.stack([np.ones(count), slope[judged], true_px[judged]], axis=1)
    centre = np.median(error)
    inlier = np.abs(error - centre) < _INLIER_PX
    fit = np.array([centre, 0.0, 0.0])
    for _ in range(3):
        if inlier.sum() < MIN_PIXELS // 2:
            break
        fit = np.linalg.lstsq(model[inlier], error[inlier], rcond=1e-6)[0]
        inlier = np.abs(error - model @ fit) < _INLIER_PX
    shift, lag, scale = (float(value) for value in fit)
    return FrameError(stamp_ns, count, float(np.median(np.abs(error))), float(centre),
                      shift, lag, scale, float(np.mean(np.abs(error) > _OUTLIER_PX)), matched)
