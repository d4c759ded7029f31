"""The result of one drive of the traverse study."""

from __future__ import annotations

import dataclasses

import numpy as np

from lunar_rover_sim.frames import Array

PATH_PERIOD_S = 0.2                   # of the recorded path
STRANDED_S, STRANDED_M = 60.0, 0.5    # a rover that stays this long this near its end is stranded
DRIVEN, TIPPED_OVER, STRANDED, DUG_IN = 'driven', 'tipped over', 'stranded', 'dug in'  # outcomes


@dataclasses.dataclass(frozen=True)
class Traverse:
    """One drive over one world.

    outcome: 'driven' (all the time), 'tipped over', 'stranded' (all the time, but stuck in one
        place at the end, although it backed up), 'dug in' (stranded, with feet deep in regolith),
        or an error of the simulation
    driven_s: simulated time [s]; distance_m: length of the horizontal path at 5 Hz [m]
    waypoints, stuck, tilted: waypoints reached, times stuck, times stopped by tilt and recovered
    slip: of all feet, as `SlipMeter.total`
    transport_mechanical, transport_electric: energy / (mass gravity distance), of the positive
        power at the legs and of that drawn from the supply (nothing is recuperated)
    tilt_mean_deg, tilt_p95_deg, tilt_max_deg: angle between base z and the vertical [deg]
    pitch_rms_deg: RMS of the pitch about its mean over two seconds: that of the walk [deg]
    penetration_max_m: greatest penetration of a spoke tip into ground or rock, at 200 Hz [m]
    path_m: (n, 3) positions at 5 Hz, world frame [m]
    """

    seed: int
    outcome: str
    driven_s: float
    distance_m: float
    waypoints: int
    stuck: int
    tilted: int
    slip: float
    transport_mechanical: float
    transport_electric: float
    tilt_mean_deg: float
    tilt_p95_deg: float
    tilt_max_deg: float
    pitch_rms_deg: float
    penetration_max_m: float
    path_m: Array

    @property
    def tipped_over(self) -> bool:
        """Whether it ended on its side or back."""
        return self.outcome == TIPPED_OVER

    @property
    def speed_mps(self) -> float:
        """Mean speed [m/s]."""
        return self.distance_m / self.driven_s if self.driven_s else 0.0


def is_stranded(path_m: Array) -> bool:
    """Return whether an (n, 3) path at 5 Hz [m] has been near its end for long."""
    last = path_m[-round(STRANDED_S / PATH_PERIOD_S):, :2]
    return (len(last) * PATH_PERIOD_S >= STRANDED_S
            and float(np.linalg.norm(last - last[-1], axis=1).max()) < STRANDED_M)
