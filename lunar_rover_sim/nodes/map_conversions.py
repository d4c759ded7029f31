"""Conversions of maps, plans and goals to and from ROS 2 messages."""

from __future__ import annotations

import array
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from lunar_rover_sim.autonomy.navigation.elevation_map import Elevation
from lunar_rover_sim.autonomy.navigation.traversability import Traversability
from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base.errors import NavigationError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.nodes.conversions import time_msg
from lunar_rover_sim.nodes.image_conversions import cloud

_POINT = np.dtype([(name, '<f4') for name in ('x', 'y', 'z', 'stddev')])


def occupancy_grid(grid: Traversability, frame_id: str, stamp: Time) -> OccupancyGrid:
    """Return the costs of a map; `map_load_time` is the stamp of the newest depth in it."""
    msg = OccupancyGrid(header=Header(stamp=stamp, frame_id=frame_id))
    msg.info.map_load_time = time_msg(grid.stamp_ns)
    msg.info.resolution = float(grid.cell_m)
    msg.info.height, msg.info.width = grid.cost.shape
    msg.info.origin.position.x, msg.info.origin.position.y = grid.origin_m.tolist()
    msg.info.origin.orientation.w = 1.0
    msg.data = array.array('b', grid.cost.tobytes())
    return msg


def traversability_of(msg: OccupancyGrid) -> Traversability:
    """Return the costs of a message; raise NavigationError if it is no square, level map.

    Without `map_load_time` the stamp of the header is that of its newest depth.
    """
    info, origin = msg.info, msg.info.origin
    cells = np.array(msg.data, np.int8)
    if info.width != info.height or len(cells) != info.width * info.height or not info.width:
        raise NavigationError(f'map: {info.width} x {info.height} cells with {len(cells)} values '
                              'are not valid; valid is a square')
    if abs(origin.orientation.z) > 1e-6 or not info.resolution > 0.0:
        raise NavigationError('map: turned, or without resolution; valid are axes of its frame')
    stamp = time_ns(info.map_load_time) or time_ns(msg.header.stamp)
    return Traversability(stamp, np.array([origin.position.x, origin.position.y]),
                          float(info.resolution), cells.reshape(info.height, info.width))


def elevation_cloud(elevation: Elevation, frame_id: str, stamp: Time) -> PointCloud2:
    """Return the known cells: x, y, z [m] and the standard deviation of z [m]."""
    rows, columns = np.nonzero(np.isfinite(elevation.height_m))
    x, y = elevation.centres_m
    values = np.stack([x[columns], y[rows], elevation.height_m[rows, columns],
                       elevation.stddev_m()[rows, columns]], axis=-1).astype('<f4')
    return cloud(values.view(_POINT)[:, 0], frame_id, stamp)


def path(points_m: Array, frame_id: str, stamp: Time) -> Path:
    """Return (n, 2) points as a path; every pose looks to the next."""
    msg = Path(header=Header(stamp=stamp, frame_id=frame_id))
    if len(points_m) < 2:
        return msg
    ahead = np.diff(points_m, axis=0)
    headings = np.arctan2(*np.concatenate([ahead, ahead[-1:]]).T[::-1])
    for (x, y), heading in zip(points_m.tolist(), headings.tolist()):
        msg.poses.append(goal((x, y), frame_id, stamp, heading))
    return msg


def goal(xy_m: Any, frame_id: str, stamp: Time, heading_rad: float = 0.0) -> PoseStamped:
    """Return a place as a pose."""
    pose = PoseStamped(header=Header(stamp=stamp, frame_id=frame_id))
    pose.pose.position.x, pose.pose.position.y = (float(v) for v in xy_m)
    pose.pose.orientation.z = float(np.sin(0.5 * heading_rad))
    pose.pose.orientation.w = float(np.cos(0.5 * heading_rad))
    return pose
