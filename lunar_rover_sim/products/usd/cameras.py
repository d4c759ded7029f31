"""Pinhole cameras with exact intrinsics.

A camera of UsdGeom looks along -z, y up. Its aperture and focal length are in tenths of the
stage's unit; only their ratios matter to a projection: fx = width focalLength /
horizontalAperture. Pixel coordinates follow OpenCV: the centre of the upper left pixel is (0, 0),
so the middle of the image is at ((width - 1) / 2, (height - 1) / 2).
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses

import numpy as np

from lunar_rover_sim.base.frames import Array, se3
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.products.usd.conventions import place_matrix, set_foreign
from lunar_rover_sim.products.usd.output import Gf, Sdf, Usd, UsdGeom
from lunar_rover_sim.rover.description import RoverDescription

LEFT, RIGHT = 'left_camera', 'right_camera'
# From the axes of UsdGeom (y up, looking along -z) to optical ones (y down, along z).
_T_OPTICAL_USD = se3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
_TENTHS_PER_M = 10.0
_Types = Sdf.ValueTypeNames


@dataclasses.dataclass(frozen=True)
class CameraModel:
    """A camera as its calibration gives it.

    Attributes:
        width, height: Of images [px].
        K: (3, 3) intrinsics [px].
        distortion: k1, k2, p1, p2, k3 (Brown-Conrady) of raw images.
        near_m, far_m: Depths that are drawn.
        pitch_m: Side of a pixel.
    """

    width: int
    height: int
    K: Array
    distortion: Sequence[float]
    near_m: float
    far_m: float
    pitch_m: float


def stereo_models(rover: RoverDescription, camera: CameraConfig,
                  pitch_m: float) -> dict[str, tuple[CameraModel, Array]]:
    """Return model and T_base_optical (4, 4) of both cameras of a rover."""
    rig = StereoRig(rover, camera)
    model = CameraModel(rig.width, rig.height, rig.K, camera.distortion, camera.near_m,
                        camera.far_m, pitch_m)
    return {LEFT: (model, rig.T_base_left), RIGHT: (model, rig.T_base_right)}


def add_camera(stage: Usd.Stage, path: Sdf.Path, model: CameraModel,
               T_parent_optical: Array) -> UsdGeom.Camera:
    """Define a camera.

    The undistorted projection is in the aperture and its offsets. Distortion is written as
    Omniverse's schema for OpenCV's model has it, and only where there is any, because there that
    schema replaces aperture and focal length. `size_px` names the size of images.
    """
    camera = UsdGeom.Camera.Define(stage, path)
    place_matrix(camera.GetPrim(), T_parent_optical @ _T_OPTICAL_USD)
    fx, fy, cx, cy = model.K[0, 0], model.K[1, 1], model.K[0, 2], model.K[1, 2]
    unit = _TENTHS_PER_M * model.pitch_m
    camera.CreateFocalLengthAttr(fx * unit)
    camera.CreateHorizontalApertureAttr(model.width * unit)
    camera.CreateVerticalApertureAttr(model.height * unit * fx / fy)
    camera.CreateHorizontalApertureOffsetAttr((0.5 * (model.width - 1) - cx) * unit)
    camera.CreateVerticalApertureOffsetAttr((cy - 0.5 * (model.height - 1)) * unit * fx / fy)
    camera.CreateClippingRangeAttr(Gf.Vec2f(model.near_m, model.far_m))
    camera.CreateFStopAttr(0.0)         # sharp at all depths
    camera.CreateFocusDistanceAttr(1.0)
    prim = camera.GetPrim()
    set_foreign(prim, 'lunar_rover_sim:size_px', _Types.Int2, Gf.Vec2i(model.width, model.height))
    set_foreign(prim, 'lunar_rover_sim:fx_fy_cx_cy', _Types.Double4, Gf.Vec4d(fx, fy, cx, cy))
    set_foreign(prim, 'lunar_rover_sim:distortion', _Types.DoubleArray,
                [float(v) for v in model.distortion])
    if any(model.distortion):
        _add_lens(prim, model)
    return camera


def _add_lens(prim: Usd.Prim, model: CameraModel) -> None:
    """Add the distortion for RTX, where the corner of the image is (0, 0)."""
    prim.AddAppliedSchema('OmniLensDistortionOpenCvPinholeAPI')
    set_foreign(prim, 'omni:lensdistortion:model', _Types.Token, 'opencvPinhole')
    group = 'omni:lensdistortion:opencvPinhole:'
    set_foreign(prim, group + 'imageSize', _Types.Int2, Gf.Vec2i(model.width, model.height))
    k1, k2, p1, p2, k3 = model.distortion
    for name, value in {'fx': model.K[0, 0], 'fy': model.K[1, 1], 'cx': model.K[0, 2] + 0.5,
                        'cy': model.K[1, 2] + 0.5, 'k1': k1, 'k2': k2, 'k3': k3, 'p1': p1,
                        'p2': p2}.items():
        set_foreign(prim, group + name, _Types.Float, float(value))
