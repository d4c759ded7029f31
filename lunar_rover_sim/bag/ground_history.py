"""The ground at any time of a recording, from its changes alone."""

from __future__ import annotations

from lunar_rover_sim import topics
from lunar_rover_sim.bag.ground_points import changes_of, FARTHEST_M
from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import BagError
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.seconds import NS_PER_S


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
