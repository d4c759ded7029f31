"""A stereo frame: the images and the layers of truth."""

from __future__ import annotations

from collections.abc import Collection
import dataclasses

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.image.camera.mosaic import shown
from lunar_rover_sim.image.camera.rig import StereoRig

LAYERS = ('left', 'right', 'depth', 'normal', 'label', 'radiance', 'crater', 'shadow')
RIGHT_TRUTH = ('right_depth', 'right_normal', 'right_label', 'right_crater', 'right_shadow')
FLOWS = ('optical_flow', 'scene_flow')      # layers too, of two states


@dataclasses.dataclass(frozen=True)
class StereoFrame:
    """Images and truth of one state; layers that were not asked for are None.

    Where the camera has distortion, left and right are distorted; the layers of truth are those of
    the undistorted view.

    Attributes:
        left: (h, w) uint8 or uint16, or (h, w, 3) uint8 of rgb8: the output of the left sensor.
        right: The output of the right sensor, in the same form.
        depth_m: (h, w) float32 depth along the optical axis of the left camera [m]; sky +inf.
        normal: (h, w, 3) float32 unit normals of the ground grid and of rocks and rover, world
            frame; sky 0.
        label: (h, w) int32, at most 65535: see `labels.class_names`.
        radiance: (h, w) float32 ideal image of the left camera [W m-2 sr-1].
        crater: (h, w) int32, at most 65535: 1 + the index of the youngest crater that the ground
            there lies in, as `crater_map` defines it; 0 outside all craters and where no ground is
            seen.
        shadow: (h, w, 3) uint8, each over 255: the share of the sun that is seen, the share that
            the rover alone hides, and `1 - |2 seen - 1|`, which is 0 where all or nothing is lit.
            They are those of the picture, relief below the grid included, before lens, motion and
            sensor; a share of the disc in penumbrae, of the ground where shadows are finer than a
            pixel; sky 0.
        right_depth_m: `depth_m` of the right camera.
        right_normal: `normal` of the right camera.
        right_label: `label` of the right camera.
        right_crater: `crater` of the right camera.
        right_shadow: `shadow` of the right camera.
        optical_flow: (h, w, 2) float32.
        scene_flow: (h, w, 3) float32, to another state, as `camera.flow.FlowModel` has them.
        exposure_s: Exposure time [s].
        encoding: Of left and right, as sensor_msgs names it.
    """

    left: NDArray[np.generic] | None = None
    right: NDArray[np.generic] | None = None
    depth_m: NDArray[np.float32] | None = None
    normal: NDArray[np.float32] | None = None
    label: NDArray[np.int32] | None = None
    radiance: NDArray[np.float32] | None = None
    crater: NDArray[np.int32] | None = None
    shadow: NDArray[np.uint8] | None = None
    right_depth_m: NDArray[np.float32] | None = None
    right_normal: NDArray[np.float32] | None = None
    right_label: NDArray[np.int32] | None = None
    right_crater: NDArray[np.int32] | None = None
    right_shadow: NDArray[np.uint8] | None = None
    optical_flow: NDArray[np.float32] | None = None
    scene_flow: NDArray[np.float32] | None = None
    exposure_s: float = 0.0
    encoding: str = 'mono8'

    def layer(self, name: str) -> NDArray[np.generic]:
        """Return a layer by its name in LAYERS, RIGHT_TRUTH or FLOWS, which was asked for."""
        unit = '_m' if name.endswith('depth') else ''
        pixels: NDArray[np.generic] = getattr(self, name + unit)
        return pixels

    def picture(self, side: str) -> NDArray[np.generic]:
        """Return 'left' or 'right', which was asked for, as one looks at it: a mosaic as colours.
        """
        return shown(self.layer(side), self.encoding)


def unknown_flows(names: Collection[str], rig: StereoRig) -> dict[str, NDArray[np.float32]]:
    """Return those of `names` that are flows, with NaN all over: no other state is known."""
    return {name: np.full((rig.height, rig.width, channels), np.nan, np.float32)
            for name, channels in zip(FLOWS, (2, 3)) if name in names}
