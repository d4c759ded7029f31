"""Time that goes back: physics was started again, or reset to zero."""

from __future__ import annotations

from rclpy.node import Node

# Messages of two topics may arrive a little out of order.
_TOLERANCE_NS = 50_000_000


class TimeJump:
    """Notices by stamps that simulated time has gone back, and logs one line each time.

    rclpy's own jump callbacks need use_sim_time; the stamps tell it to every node.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._newest_ns = 0

    def has_occurred(self, stamp_ns: int) -> bool:
        """Return whether `stamp_ns` [ns] lies before the newest stamp of earlier calls."""
        newest_ns = self._newest_ns
        if newest_ns - stamp_ns <= _TOLERANCE_NS:
            self._newest_ns = max(newest_ns, stamp_ns)
            return False
        self._newest_ns = stamp_ns
        self._logger.warning(f'time has gone back from {newest_ns / 1e9:.3f} s to '
                             f'{stamp_ns / 1e9:.3f} s: starting anew')
        return True
