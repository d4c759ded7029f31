"""Changes of the ground as points of a sensor_msgs/PointCloud2, and back, exactly.

A point is a sample of the overlay of 5 mm. It holds x, y and z [m] of the changed surface in
`odom`, so that viewers draw a cloud, and the absolute values there: height change and compaction
[m]. Of several points on one sample the newest counts. Neighbouring samples have different x and y
in float32 up to 65 km from the middle of the site, so that the index of the sample follows from
them exactly.
"""

from __future__ import annotations

from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import CELL_M, GroundChanges, Overlay
from lunar_rover_sim.ground.world.grid import HeightGrid

if TYPE_CHECKING:    # nodes that write points read no bag
    from lunar_rover_sim.bag.reader import Bag

POINT = np.dtype([(name, '<f4') for name in ('x', 'y', 'z', 'height_change', 'compaction')])
FLOAT32 = 7     # of sensor_msgs/PointField
_MOST_M = 1.0               # no print is deeper, no rim higher
FARTHEST_M = 6.5e4          # up to here an index follows from float32


def points_of(changes: GroundChanges, ground: HeightGrid) -> NDArray[np.void]:
    """Return (n,) points of the dtype POINT.

    Args:
        ground: As it was before any change; beyond it z is the change alone.
    """
    points = np.zeros(len(changes), POINT)
    xy = changes.index * CELL_M
    points['x'], points['y'] = xy.T
    points['z'] = np.nan_to_num(ground.height_at(xy)) + changes.height_m
    points['height_change'], points['compaction'] = changes.height_m, changes.compaction_m
    return points


def problem(message: Any, half_extent_m: float = FARTHEST_M) -> str | None:
    """Return why a PointCloud2 does not hold changes of the ground, or None.

    Args:
        half_extent_m: Half of the width of the ground [m], beyond which nothing can have changed.
    """
    fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
    wanted = [(name, POINT.fields[name][1], FLOAT32, 1) for name in POINT.names or ()
              if POINT.fields is not None]
    if fields != wanted or message.point_step != POINT.itemsize or message.is_bigendian:
        return f'fields are not {", ".join(POINT.names or ())} of float32'
    count = message.height * message.width
    if message.height != 1 or len(message.data) != count * POINT.itemsize:
        return f'{len(message.data)} bytes are not those of {count} points'
    points = np.frombuffer(bytes(message.data), POINT)
    for name in POINT.names or ():
        if not np.isfinite(points[name]).all():
            return f'{name} holds numbers that are not finite'
    for name in ('x', 'y'):
        beyond = points[name][np.abs(points[name]) > half_extent_m + CELL_M]
        if len(beyond):
            return (f'{name} = {beyond[0]:g} m is beyond the ground, which ends at'
                    f' {half_extent_m:g} m')
        if (points[name] != (_index(points[name]) * CELL_M).astype(np.float32)).any():
            return f'{name} is not a multiple of {1e3 * CELL_M:g} mm'
    if (np.abs(points['height_change']) > _MOST_M).any():
        return f'height_change is more than {_MOST_M:g} m'
    if (points['compaction'] < -1e-6).any():
        return 'compaction is less than 0'
    return None


def changes_of(message: Any, half_extent_m: float = FARTHEST_M) -> GroundChanges:
    """Return the changes in a PointCloud2 of rosbags or rclpy; BagError if it holds none.

    Args:
        half_extent_m: As in `problem`.
    """
    found = problem(message, half_extent_m)
    if found:
        raise BagError(f'ground changes: {found}')
    points = np.frombuffer(bytes(message.data), POINT)
    return GroundChanges(np.stack([_index(points['x']), _index(points['y'])], axis=-1),
                         points['height_change'].copy(), points['compaction'].copy())


def _index(places_m: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the samples at places, along one axis."""
    return np.rint(places_m.astype(float) / CELL_M).astype(np.int32)


def ground_at(bag: Bag, time_ns: int | None = None,
              half_extent_m: float = FARTHEST_M) -> Overlay:
    """Return what had been changed of the ground at a simulated time [ns]; None: at the end.

    That is the state at the last frame up to that time.

    Args:
        half_extent_m: Half of the width of the ground [m].

    Raises:
        BagError: If the bag has no changes (rigid ground), ends earlier, lacks one, or has one
            beyond the ground.
    """
    if not bag.has(topics.GROUND_CHANGES.name):
        raise BagError(f'{bag.path}: holds no {topics.GROUND_CHANGES.name}; it is recorded where '
                       'ground.model is regolith')
    overlay, last_ns, period_ns = Overlay(), 0, 0
    for _, _, message in bag.messages([topics.GROUND_CHANGES.name]):
        stamp_ns = header_ns(message)
        if time_ns is not None and stamp_ns > time_ns:
            break
        step_ns = stamp_ns - last_ns
        period_ns = period_ns or step_ns
        if step_ns != period_ns:
            raise BagError(f'{bag.path}: {topics.GROUND_CHANGES.name} lacks messages between '
                           f'{last_ns / NS_PER_S:.3f} s and {stamp_ns / NS_PER_S:.3f} s')
        overlay.apply(changes_of(message, half_extent_m))
        last_ns = stamp_ns
    if time_ns is not None and period_ns and time_ns >= last_ns + 2 * period_ns:
        raise BagError(f'{bag.path}: {time_ns / NS_PER_S:.3f} s is not valid; the ground is known '
                       f'up to {last_ns / NS_PER_S:.3f} s')
    return overlay
