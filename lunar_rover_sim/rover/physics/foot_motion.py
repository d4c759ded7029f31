"""Motion of each foot over the ground, from the true motion of the rover: sweep and slip.

A wheel of radius r slips by i = 1 - v / (r omega) (Wong, Theory of Ground Vehicles, 2008, ch. 2):
the share of its driven way by which it does not advance. For a spoke leg the driven way is what
the leg sweeps its foot backward past the axle, which changes over a step. So both are speeds of
the point with which the lowest tip of a leg stands on the ground, along the heading, counted while
the leg is loaded:

    sweep = -((w + q' y) x (c - a)) . h,    slip = sweep - (v + w x (a - o)) . h

with the point c, the axle a and its direction y, joint rate q', origin o, velocity v and rate w of
base_link, and h its x axis along the ground: the leg turns by its motor and with the body, and
what the axle does not advance is slip. A foot that holds has slip 0, the foot of a rover
that does not move slip = sweep. Over a time the slip ratio of a leg is the integral of slip over
that of sweep. At a single stamp it would be infinite where the sweep passes 0.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, rotated
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.state import RoverState

LOADED_PART = 0.005   # of the weight: a leg that carries less has no foot on the ground


@dataclasses.dataclass(frozen=True)
class FootMotion:
    """The feet at one stamp, in the order of the rover's legs.

    Attributes:
        loaded: (legs,) whether the leg stands on something; sweep and slip are 0 where it does
            not.
        sweep_mps: (legs,) speed backward past the axle.
        slip_mps: (legs,) speed backward over the ground.
        axle_mps: (legs,) speed of the axles ahead along the ground, loaded or not: sweep less
            slip.
    """

    loaded: NDArray[np.bool_]
    sweep_mps: Array
    slip_mps: Array
    axle_mps: Array


class FootObserver:
    """Computes the motion of the feet of a rover on a ground from its states."""

    def __init__(self, rover: RoverDescription, ground: HeightGrid, gravity_mps2: float) -> None:
        legs = rover.legs
        self._ground = ground
        self._radius_m = legs.tip_radius_m
        self._to_tip_m = legs.spoke_length_m - legs.tip_radius_m
        self._axles = np.array(legs.axle_positions_m())
        self._spokes = np.arange(legs.spokes) * legs.spoke_pitch_rad
        self._least_n = LOADED_PART * rover.total_mass_kg * gravity_mps2

    def observe(self, state: RoverState) -> FootMotion:
        """Return the motion of the feet at a state."""
        R_world_base = matrix_from_wxyz(state.orientation_wxyz)
        angle = state.joint_angle_rad[:, None] + self._spokes
        tips = self._axles[:, None] + self._to_tip_m * np.stack(
            [-np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
        tips = rotated(R_world_base, tips) + state.position_m
        foot = np.array([min(leg, key=self._height) for leg in tips.tolist()])
        normal = np.array([self._normal(x, y) for x, y, _ in foot.tolist()])
        # From base_link to axle and to the point on the ground, world axes.
        to_axle = rotated(R_world_base, self._axles)
        to_ground = foot - self._radius_m * normal - state.position_m
        axis = R_world_base[:, 1]
        rate = rotated(R_world_base, state.angular_velocity_radps)
        past_axle = np.cross(rate + state.joint_velocity_radps[:, None] * axis,
                             to_ground - to_axle)
        axle = rotated(R_world_base, state.linear_velocity_mps) + np.cross(rate, to_axle)
        along = np.sum(normal * R_world_base[:, 0], axis=1)
        ahead = R_world_base[:, 0] - normal * along[:, None]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        loaded = np.linalg.norm(state.contact_force_n, axis=1) > self._least_n
        axle_mps = np.sum(axle * ahead, axis=1)
        sweep_mps = -np.where(loaded, np.sum(past_axle * ahead, axis=1), 0.0)
        return FootMotion(loaded, sweep_mps, np.where(loaded, sweep_mps - axle_mps, 0.0),
                          axle_mps)

    def _height(self, tip: tuple[float, float, float]) -> float:
        """Return the height of a tip over the untouched ground [m]; infinite beyond it."""
        height = tip[2] - self._ground.height_at_point(tip[0], tip[1])
        return math.inf if math.isnan(height) else height

    def _normal(self, x: float, y: float) -> tuple[float, float, float]:
        """Return the normal of the untouched ground around a tip; upright beyond it."""
        at, reach = self._ground.height_at_point, self._radius_m
        slope_x = (at(x + reach, y) - at(x - reach, y)) / (2.0 * reach)
        slope_y = (at(x, y + reach) - at(x, y - reach)) / (2.0 * reach)
        if math.isnan(slope_x + slope_y):
            return 0.0, 0.0, 1.0
        up = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
        return -slope_x * up, -slope_y * up, up


class SlipMeter:
    """Sums up the ways of the feet.

    Attributes:
        swept_m, slipped_m: (legs,) ways backward past the axle and over the ground since the
            start.
        driven_m: Way of the rover by the mean sweep of the legs that are loaded at each time.
        way_m: Way that it went along its heading, also while no leg is loaded.
    """

    def __init__(self, legs: int) -> None:
        self.swept_m, self.slipped_m = np.zeros(legs), np.zeros(legs)
        self.driven_m = self.way_m = 0.0

    def add(self, motion: FootMotion, interval_s: float) -> None:
        """Add a motion that holds for a time [s]."""
        loaded = max(1, int(np.count_nonzero(motion.loaded)))
        self.driven_m += float(motion.sweep_mps.sum()) / loaded * interval_s
        self.way_m += float(motion.axle_mps.mean()) * interval_s
        self.swept_m += motion.sweep_mps * interval_s
        self.slipped_m += motion.slip_mps * interval_s

    @property
    def ratio(self) -> Array:
        """The (legs,) slip ratios so far; NaN of a leg that has not swept its foot."""
        return np.divide(self.slipped_m, self.swept_m, out=np.full(len(self.swept_m), math.nan),
                         where=self.swept_m != 0.0)

    @property
    def total(self) -> float:
        """The slip ratio of the rover so far, 1 - way / driven way; NaN if it was not driven.

        In a curve the feet inside are dragged ahead and those outside slip back; it is what
        remains.
        """
        return 1.0 - self.way_m / self.driven_m if self.driven_m else math.nan
