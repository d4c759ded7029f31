"""When the walls of fresh prints slide: some time after a tip has left them, for a leg at once."""

from __future__ import annotations

import math

from lunar_rover_sim.regolith.fine_ground import FineGround
from lunar_rover_sim.regolith.footprint import hull, Window
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.regolith.repose import relax

SLIDE_S = 0.1   # time in which walls slide, for all prints of a leg at once
WIDEST = 40     # samples of such prints, along one side
SPREAD = 4      # samples around them to which their walls mostly slide


class WallSlides:
    """Windows of prints whose walls are to slide, per leg, and the step at which they do."""

    def __init__(self, ground: FineGround, repose_deg: float, step_s: float) -> None:
        self._ground, self._repose_deg = ground, repose_deg
        self._delay = round(SLIDE_S / step_s)
        self._waiting: list[Window | None] = [None] * 4
        self._due = [0] * 4
        self.next_step = math.inf       # at which `slide_due` has anything to do

    def add(self, overlay: Overlay, leg: int, window: Window, step: int) -> None:
        """Let the walls in a window slide soon, with those of the same leg."""
        waiting = self._waiting[leg]
        if waiting is not None:
            both = hull(waiting, window)
            if max(both[2:]) <= WIDEST:
                self._waiting[leg] = both
                return
            self._slide(overlay, leg)
        self._waiting[leg] = window
        self._due[leg] = step + self._delay
        self.next_step = min(self.next_step, self._due[leg])

    def slide_due(self, overlay: Overlay, step: int) -> None:
        """Let walls slide whose time has come."""
        for leg in range(4):
            if self._waiting[leg] is not None and self._due[leg] <= step:
                self._slide(overlay, leg)
        self.next_step = min((self._due[leg] for leg in range(4)
                              if self._waiting[leg] is not None), default=math.inf)

    def slide_all(self, overlay: Overlay) -> None:
        """Let all walls slide now."""
        for leg in range(4):
            self._slide(overlay, leg)

    def forget(self) -> None:
        """Let no wall slide that was to."""
        self._waiting = [None] * 4

    def _slide(self, overlay: Overlay, leg: int) -> None:
        window = self._waiting[leg]
        if window is not None:
            ix, iy, nx, ny = window
            relax(overlay, self._ground, ix - SPREAD, iy - SPREAD, nx + 2 * SPREAD,
                  ny + 2 * SPREAD, self._repose_deg)
            self._waiting[leg] = None
