"""Changes of the ground in a synthetic drive."""

from collections.abc import Callable

import numpy as np
from synthetic_bag import cloud, Item

from lunar_rover_sim.bag.ground_points import points_of
from lunar_rover_sim.base import frames, topics
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.regolith.tracks import press
from lunar_rover_sim.ground.world.grid import HeightGrid


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
        items.append(cloud(topics.GROUND_CHANGES, k * 10**8, frames.ODOM_FRAME,
                           points_of(overlay.take_changes(), ground)))
        seen(k * 10**8)
    return items
