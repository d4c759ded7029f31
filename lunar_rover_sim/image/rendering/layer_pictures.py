"""Pictures of a frame and its truth layers, to look at."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.camera.encoding import eight_bits
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.labels import (LABEL_DISTURBED, LABEL_FIRST_ROCK,
                                                    LABEL_GROUND, LABEL_ROVER, LABEL_SKY)

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


def label_picture(label: NDArray[np.integer[Any]]) -> U8:
    """Return (h, w, 3) BGR colours of labels.

    The sky is black, ground grey, disturbed ground lighter, the rover's body white, its legs
    yellow; rocks have colours of their own.
    """
    palette = _colours()
    palette[:LABEL_FIRST_ROCK] = (0, 200, 255)
    palette[LABEL_SKY], palette[LABEL_GROUND] = 0, 70
    palette[LABEL_ROVER], palette[LABEL_DISTURBED] = 255, 150
    return palette[label]


def crater_picture(crater: NDArray[np.integer[Any]]) -> U8:
    """Return (h, w, 3) BGR colours of the numbers of craters; black outside all."""
    palette = _colours()
    palette[0] = 0
    return palette[crater]


def _colours() -> U8:
    """Return a colour for each number of 16 bits."""
    return np.random.default_rng(1).integers(60, 256, (1 << 16, 3), dtype=np.uint8)


def shadow_picture(shadow: NDArray[np.uint8]) -> U8:
    """Return (h, w, 3) BGR colours: sunlight green, the rover's red, partly lit blue."""
    seen, own, penumbra = (shadow[..., k] for k in range(3))
    return np.stack([penumbra, seen // 2, own], axis=-1)


def normal_picture(normal: NDArray[np.float32]) -> U8:
    """Return (h, w, 3) BGR colours of unit normals, x red, y green, z blue; black where none is.
    """
    known = np.any(normal != 0.0, axis=-1, keepdims=True)
    return np.where(known, 127.5 + 127.5 * normal, 0.0).astype(np.uint8)[..., ::-1]


def flow_picture(flow: NDArray[np.float32], full: float | None = None) -> U8:
    """Return (h, w, 3) BGR colours of optical flow or scene flow.

    The hue is the direction in the image: right red, down yellow-green, left cyan, up violet. The
    brightness is the length across it, full at `full`, None: at the 99th percentile. NaN is dark
    grey.
    """
    known = np.isfinite(flow).all(axis=-1)
    right, down = (np.where(known, flow[..., k], 0.0) for k in range(2))
    length = np.hypot(right, down)
    if full is None:
        full = float(np.percentile(length[known], 99)) if known.any() else 1.0
    hue = (np.degrees(np.arctan2(down, right)) % 360.0) / 2.0
    hsv = np.stack([hue, np.full_like(hue, 255.0),
                    255.0 * np.clip(length / max(full, 1e-6), 0.0, 1.0)], axis=-1)
    colours = cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2BGR)
    colours[~known] = (40, 40, 40)
    return np.asarray(colours, np.uint8)


def gray8(image: NDArray[np.generic]) -> U8:
    """Return a (h, w, 3) BGR picture of an image of any encoding."""
    picture = eight_bits(image)
    return picture[..., ::-1] if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)


def tone_mapped(radiance: NDArray[np.floating]) -> U8:
    """Return a (h, w, 3) picture of radiance with gamma 2.2; the 99.5th percentile is white."""
    lit = radiance[radiance > 0]
    white = float(np.percentile(lit, 99.5)) if lit.size else 1.0
    level = np.clip(radiance / white, 0.0, 1.0)**(1.0 / 2.2) * 255
    return np.repeat(level.astype(np.uint8)[..., None], 3, axis=2)


def disparity_picture(disparity_px: NDArray[np.floating], most_px: float | None = None) -> U8:
    """Return (h, w, 3) BGR colours of disparity, large warm, small cold; below 0 black.

    Args:
        most_px: The warmest; None: the greatest one.
    """
    known = disparity_px >= 0.0
    most = max(float(disparity_px.max(initial=1.0)), 1.0) if most_px is None else most_px
    level = np.clip(disparity_px / most * 255, 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)
    colours[~known] = 0
    return np.asarray(colours, np.uint8)


def contact_sheet(frame: StereoFrame, disparity_px: NDArray[np.floating],
                  sgm_depth_m: NDArray[np.floating]) -> U8:
    """Return one picture of eleven: the pair, the ideal image and shadow; the truth; the stereo
    matching.

    The last row shows disparity_px (h, w), invalid < 0; sgm_depth_m (h, w) made from it, invalid
    NaN; and the error of that depth as a share of the true one, from 0 to 10 %.
    """
    assert frame.left is not None and frame.right is not None and frame.depth_m is not None
    assert frame.normal is not None and frame.label is not None and frame.radiance is not None
    assert frame.crater is not None and frame.shadow is not None
    with np.errstate(invalid='ignore'):
        error = np.abs(sgm_depth_m - frame.depth_m) / frame.depth_m
    rows = [[('left', gray8(frame.picture('left'))), ('right', gray8(frame.picture('right'))),
             ('ideal radiance, gamma', tone_mapped(frame.radiance)),
             ('sun green, in part blue, rover red', shadow_picture(frame.shadow))],
            [(f'true depth, {_NEAR_M:g} to {_FAR_M:g} m', depth_picture(frame.depth_m)),
             ('normals', normal_picture(frame.normal)),
             ('labels', label_picture(frame.label)),
             ('craters', crater_picture(frame.crater))],
            [('disparity (SGM)', disparity_picture(disparity_px)),
             ('depth from disparity', depth_picture(sgm_depth_m)),
             ('its relative error, 0 to 10 %', error_picture(error, 0.1)),
             ('', np.zeros((*error.shape, 3), np.uint8))]]
    return np.vstack([np.hstack([_captioned(*panel) for panel in row]) for row in rows])


def _captioned(text: str, picture: U8) -> U8:
    picture = np.ascontiguousarray(picture)
    scale = max(picture.shape[1] / 1000, 0.35)
    x, y = 8, int(30 * scale) + 4
    (width, height), under = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    # A dark ground: a wider text below this one would be set differently.
    picture[max(0, y - height - 4):y + under, x - 4:x + width + 4] //= 3
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), 1,
                cv2.LINE_AA)
    return picture
