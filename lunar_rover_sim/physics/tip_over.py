"""Detection of a rover that has tipped over."""

from __future__ import annotations

from lunar_rover_sim.frames import Array, tilt_deg

# A rover on its side on a slope of 20 deg is tilted by 70 deg; no slope on which it walks is that
# steep. It counts as upright again below 45 deg: one that rocks on its side has tipped over once.
TIPPED_DEG, _UPRIGHT_DEG = 70.0, 45.0


class TipOver:
    """Notices when the base tilts so far that the rover does not come back by itself.

    Attributes:
        tilt_deg: Angle between the z axes of base and world at the newest pose [deg].
        lies: Whether the rover has tipped over and not come back.
    """

    def __init__(self) -> None:
        self.tilt_deg = 0.0
        self.lies = False

    def has_begun(self, orientation_wxyz: Array) -> bool:
        """Return whether the rover tips over with this pose, base in the world frame, (4,)."""
        self.tilt_deg = float(tilt_deg(orientation_wxyz))
        lay = self.lies
        self.lies = self.tilt_deg > (_UPRIGHT_DEG if lay else TIPPED_DEG)
        return self.lies and not lay
