"""Conversions of images, calibrations, point clouds and labels to ROS 2 messages.

vision_msgs may not be installed: nothing here imports it at once. `msg` is its module of messages,
version 4 (github.com/ros-perception/vision_msgs).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import importlib
from types import ModuleType
from typing import Any, TYPE_CHECKING

from builtin_interfaces.msg import Time
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, PointCloud2, PointField
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.image.camera.encoding import eight_bits, encoding_of
from lunar_rover_sim.image.rendering.labels import (CRATER, FIRST_CRATER, Instance,
                                                    LABEL_FIRST_ROCK, METHOD)

if TYPE_CHECKING:
    from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
    from lunar_rover_sim.image.camera.rig import PinholeCamera
    from lunar_rover_sim.image.stereo.depth import DisparityMap


def camera_info(rig: PinholeCamera | FisheyeCamera, frame_id: str, projection: Array,
                stamp: Time) -> CameraInfo:
    """Return intrinsics, distortion and projection of one camera (REP-104)."""
    msg = CameraInfo(header=Header(stamp=stamp, frame_id=frame_id))
    msg.width, msg.height = rig.width, rig.height
    msg.distortion_model = rig.distortion_model
    msg.d = [float(d) for d in rig.D]
    msg.k = rig.K.ravel().tolist()
    msg.r = rig.R.ravel().tolist()
    msg.p = projection.ravel().tolist()
    return msg


def image(pixels: NDArray, frame_id: str, stamp: Time, encoding: str = '') -> Image:
    """Return (h, w) uint8, uint16, float32, (h, w, 3) uint8 or (h, w, c) float32 as a message.

    (h, w) int32, labels and craters of at most 65535, become uint16. encoding: by default that
    which follows from the pixels.
    """
    if pixels.dtype == np.int32:
        pixels = pixels.astype(np.uint16)
    msg = Image(header=Header(stamp=stamp, frame_id=frame_id))
    msg.height, msg.width = pixels.shape[:2]
    msg.encoding = encoding or encoding_of(pixels)
    msg.step = pixels.strides[0] if pixels.flags.c_contiguous else pixels[0].nbytes
    msg.data = pixels.tobytes()
    return msg


def exposure(time_s: float, frame_id: str, stamp: Time) -> JointState:
    """Return the exposure time of a pair [s]; no standard message has one, nor a number alone."""
    return JointState(header=Header(stamp=stamp, frame_id=frame_id), name=['left', 'right'],
                      position=[time_s, time_s])


def compressed_image(description: str, data: bytes, frame_id: str,
                     stamp: Time) -> CompressedImage:
    """Return a compressed image; description: what image_transport calls its format."""
    return CompressedImage(header=Header(stamp=stamp, frame_id=frame_id), format=description,
                           data=data)


def point_cloud(points_m: NDArray[np.float32], picture: NDArray, frame_id: str,
                stamp: Time) -> PointCloud2:
    """Return (h, w, 3) points as an organised cloud, with the brightness of a picture.

    A picture in colour, (h, w, 3), adds `rgb`: 8 bits each, packed in a float as in
    stereo_image_proc. `is_dense` is false: unknown points are NaN.
    """
    names = ['x', 'y', 'z', 'intensity', *(['rgb'] if picture.ndim == 3 else [])]
    height, width, _ = points_m.shape
    values = np.empty((height, width, len(names)), '<f4')
    from lunar_rover_sim.image.stereo.depth import grey  # OpenCV: physics_node starts without it
    values[..., :3], values[..., 3] = points_m, grey(picture)
    if picture.ndim == 3:
        red, green, blue = np.moveaxis(eight_bits(picture).astype('<u4'), -1, 0)
        values[..., 4] = (red << 16 | green << 8 | blue).view('<f4')
    return cloud(values.view([(name, '<f4') for name in names])[..., 0], frame_id, stamp,
                 is_dense=False)


_KINDS = {'f4': PointField.FLOAT32, 'u2': PointField.UINT16}


def cloud(points: NDArray[np.void], frame_id: str, stamp: Time,
          is_dense: bool = True) -> PointCloud2:
    """Return (n,) or (rows, columns) records as a cloud with their fields.

    Args:
        is_dense: Whether all numbers are finite.
    """
    height, width = points.shape if points.ndim == 2 else (1, len(points))
    kind, fields = points.dtype, dict[str, Any](points.dtype.fields or {})
    msg = PointCloud2(
        header=Header(stamp=stamp, frame_id=frame_id), height=height, width=width,
        point_step=kind.itemsize, row_step=kind.itemsize * width, is_dense=is_dense,
        fields=[PointField(name=name, offset=fields[name][1], count=1,
                           datatype=_KINDS[fields[name][0].str[1:]]) for name in kind.names or ()])
    msg.data = points.tobytes()
    return msg


def disparity_image(disparity: DisparityMap, focal_px: float, baseline_m: float, frame_id: str,
                    stamp: Time) -> DisparityImage:
    """Return a disparity map with what a reader needs to turn it into depth: Z = f T / d."""
    msg = DisparityImage(header=Header(stamp=stamp, frame_id=frame_id))
    msg.image = image(disparity.disparity_px, frame_id, stamp)
    msg.f, msg.t = float(focal_px), float(baseline_m)
    msg.min_disparity = float(disparity.min_disparity_px)
    msg.max_disparity = float(disparity.max_disparity_px)
    msg.delta_d = float(disparity.delta_d_px)
    x, y, width, height = disparity.valid_window
    msg.valid_window.x_offset, msg.valid_window.y_offset = int(x), int(y)
    msg.valid_window.width, msg.valid_window.height = int(width), int(height)
    return msg


_FIRST = {CRATER: FIRST_CRATER}     # number of the first one; rocks otherwise


def vision_messages() -> ModuleType | None:
    """Return the module of messages; None where the package is not installed."""
    try:
        return importlib.import_module('vision_msgs.msg')
    except ImportError:
        return None


def detections(msg: ModuleType, instances: Iterable[Instance], header: Header) -> Any:
    """Return instances of an image as Detection2DArray, with the score 1.

    The class is `rock` or `crater`; the id adds the row in the catalogue of label_info. Boxes
    reach from the left edge of their first pixel, whose centre is at (0.5, 0.5) in the upper left
    corner, to the right edge of their last one.
    """
    result = msg.Detection2DArray()
    result.header = header
    for instance in instances:
        box, hypothesis = msg.Detection2D(), msg.ObjectHypothesisWithPose()
        rows, columns = instance.mask.shape
        box.header = header
        box.id = f'{instance.category} {row(instance)}'
        box.bbox.center.position.x = float(instance.x + 0.5 * columns)
        box.bbox.center.position.y = float(instance.y + 0.5 * rows)
        box.bbox.size_x, box.bbox.size_y = float(columns), float(rows)
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = instance.category, 1.0
        box.results = [hypothesis]
        result.detections.append(box)
    return result


def row(instance: Instance) -> int:
    """Return the row of an instance in its catalogue."""
    return instance.number - _FIRST.get(instance.category, LABEL_FIRST_ROCK)


def label_info(msg: ModuleType, names: Mapping[int, str], header: Header) -> Any:
    """Return the names of labels as LabelInfo."""
    result = msg.LabelInfo()
    result.header = header
    for label, name in names.items():
        entry = msg.VisionClass()
        entry.class_id, entry.class_name = label, name
        result.class_map.append(entry)
    return result


def vision_info(msg: ModuleType, world_hash: str, header: Header) -> Any:
    """Return how labels are made as VisionInfo; its version is a number, so the hash is a place.
    """
    result = msg.VisionInfo()
    result.header, result.method = header, METHOD
    result.database_location, result.database_version = world_hash, 0
    return result
