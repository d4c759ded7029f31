"""Pictures of a frame and its truth layers, to look at."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.rendering.frame import StereoFrame

U8 = NDArray[np.uint8]

_NEAR_M, _FAR_M = 0.3, 20.0


def depth_picture(depth_m: NDArray[np.floating]) -> U8:
    """Return (h, w, 3) BGR colours of depth, near warm, far cold; sky and holes black."""
    shown = np.isfinite(depth_m) & (depth_m > 0)
    with np.errstate(invalid='ignore', divide='ignore'):
        share = np.log(np.where(shown, depth_m, 1.0) / _NEAR_M) / np.log(_FAR_M / _NEAR_M)
    level = np.clip(255 * (1.0 - share), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    colours[~shown] = 0
    return np.asarray(colours, np.uint8)


def error_picture(error: NDArray[np.floating], full: float) -> U8:
    """Return (h, w, 3) BGR colours of an error from 0 to `full`; NaN is dark grey."""
    known = np.isfinite(error)
    level = np.clip(np.where(known, error, 0.0) / full * 255, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_INFERNO)
    colours[~known] = (40, 40, 40)
    return np.asarray(colours, np.uint8)


def signed_error_picture(error: NDArray[np.floating], full: float) -> U8:
    """Return (h, w, 3) BGR colours of an error: blue at -full, white at 0, red at full.

    NaN is dark grey.
    """
    known = np.isfinite(error)
    level = np.clip(np.where(known, error, 0.0) / full, -1.0, 1.0)
    shares = np.stack([1.0 - np.maximum(level, 0.0), 1.0 - np.abs(level),
                       1.0 + np.minimum(level, 0.0)], axis=-1)
    colours = np.rint(255.0 * shares).astype(np.uint8)
    colours[~known] = (40, 40, 40)
    return colours


def label_picture(label: NDArray[np.int32]) -> U8:
    """Return (h, w, 3) BGR colours of labels; sky black, ground grey, disturbed
    ground lighter, rover white."""
    palette = np.random.default_rng(1).integers(60, 256, (4096, 3), dtype=np.uint8)
    palette[0], palette[1], palette[2], palette[3] = 0, 70, 255, 150
    return palette[np.where(label < 4, label, 4 + label % 4092)]


def gray8(image: NDArray[np.generic]) -> U8:
    """Return a (h, w, 3) BGR picture of an image of any encoding."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)  # type: ignore[operator]
    picture = np.asarray(image, np.uint8)
    return picture[..., ::-1] if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def tone_mapped(radiance: NDArray[np.floating]) -> U8:
    """Return a (h, w, 3) picture of radiance with gamma 2.2; the 99.5th percentile is white."""
    lit = radiance[radiance > 0]
    white = float(np.percentile(lit, 99.5)) if lit.size else 1.0
    level = np.clip(radiance / white, 0.0, 1.0)**(1.0 / 2.2) * 255
    return np.repeat(level.astype(np.uint8)[..., None], 3, axis=2)


def disparity_picture(disparity_px: NDArray[np.floating]) -> U8:
    """Return (h, w, 3) BGR colours of disparity, large warm, small cold; below 0 black."""
    known = disparity_px >= 0.0
    most = max(float(disparity_px.max(initial=1.0)), 1.0)
    level = np.clip(disparity_px / most * 255, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    colours[~known] = 0
    return np.asarray(colours, np.uint8)


def contact_sheet(frame: StereoFrame, disparity_px: NDArray[np.floating],
                  sgm_depth_m: NDArray[np.floating]) -> U8:
    """Return one picture of nine: the pair and the ideal image; the truth; the stereo matching.

    The last row shows disparity_px (h, w), invalid < 0; sgm_depth_m (h, w) made from it, invalid
    NaN; and the error of that depth as a share of the true one, from 0 to 10 %.
    """
    assert frame.left is not None and frame.right is not None and frame.depth_m is not None
    assert frame.normal is not None and frame.label is not None and frame.radiance is not None
    with np.errstate(invalid='ignore'):
        error = np.abs(sgm_depth_m - frame.depth_m) / frame.depth_m
    normals = np.where(frame.label[..., None] > 0, 127.5 + 127.5 * frame.normal, 0)
    rows = [[('left', gray8(frame.left)), ('right', gray8(frame.right)),
             ('ideal radiance, gamma', tone_mapped(frame.radiance))],
            [(f'true depth, {_NEAR_M:g} to {_FAR_M:g} m', depth_picture(frame.depth_m)),
             ('normals', normals.astype(np.uint8)[..., ::-1]),
             ('labels', label_picture(frame.label))],
            [('disparity (SGM)', disparity_picture(disparity_px)),
             ('depth from disparity', depth_picture(sgm_depth_m)),
             ('its relative error, 0 to 10 %', error_picture(error, 0.1))]]
    return np.vstack([np.hstack([_captioned(*panel) for panel in row]) for row in rows])


def _captioned(text: str, picture: U8) -> U8:
    picture = np.ascontiguousarray(picture)
    scale = max(picture.shape[1] / 1000, 0.35)
    for colour, width in (((0, 0, 0), 4), ((255, 255, 255), 1)):
        cv2.putText(picture, text, (8, int(30 * scale) + 4), cv2.FONT_HERSHEY_SIMPLEX, scale,
                    colour, width, cv2.LINE_AA)
    return picture
