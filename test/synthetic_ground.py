"""Changes of the ground in a synthetic drive."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from synthetic_bag import header, Item, msg

from lunar_rover_sim import frames, topics
from lunar_rover_sim.bag.ground_points import FLOAT32, POINT, points_of
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.regolith.tracks import press
from lunar_rover_sim.world.grid import HeightGrid


def ground_items(duration_s: float, overlay: Overlay | None = None,
                 seen: Callable[[int], None] = lambda ns: None) -> list[Item]:
    """Return changes of level ground at 10 Hz: prints along x, the last ones on older ones.

    seen: called with each stamp when the overlay is as its message says
    """
    ground = HeightGrid(np.zeros((81, 81), np.float32), 0.025)
    overlay = Overlay() if overlay is None else overlay
    items = []
    for k in range(1, round(duration_s * 10.0) + 1):
        x = 0.02 * k - 0.1
        press(overlay, ground, (x, 0.03, 0.008), (x, 0.03, -0.012), 0.008, 0.6)
        points = points_of(overlay.take_changes(), ground)
        fields = [msg('sensor_msgs/PointField', name=name, offset=4 * i, datatype=FLOAT32, count=1)
                  for i, name in enumerate(POINT.names)]
        items.append(Item(topics.GROUND_CHANGES.name, topics.GROUND_CHANGES.type, msg(
            'sensor_msgs/PointCloud2', header=header(k * 10**8, frames.ODOM_FRAME), height=1,
            width=len(points), fields=fields, is_bigendian=False, point_step=POINT.itemsize,
            row_step=points.nbytes, data=np.frombuffer(points.tobytes(), np.uint8),
            is_dense=True)))
        seen(k * 10**8)
    return items
