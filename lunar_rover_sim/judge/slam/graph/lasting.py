"""Errors of motions that last: each one is small, but they add up as the way, not as its root.

The wheels do not tell where the rover goes in the axes of its base. A body that walks nose up
goes below where it looks, and one on a slope slides aside, by much the same share of every step.
Images tell that share (`Course`).

A lamp on the rover casts shadows whose edges go along with it. Behind relief of height r, lit from
h above the ground, an edge moves by r / (h - r) of the rover's step: all steps look too long by
much the same share, which images cannot tell (`Shadows`).
"""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.judge.slam.graph.measured import WalkingBias

# Standard deviation of the share before images told it, and its walk for each root of a second.
_FIRST_COURSE, _COURSE_WALK = 0.1, 1e-3
# Of the share of a step by which shadows go along: relief of 5 mm, lit from 0.25 m.
_WITH_LAMP = 0.02
_SUN_NS = 120_000_000_000       # without the sun for so long, what images show is lit by a lamp
_ASIDE = np.diag([0.0, 1.0, 1.0])


class Course:
    """Where the rover goes while its wheels roll ahead: across and up, as shares of the way.

    Images that are wrong about the length of a step are right about its direction: along the way
    nothing is learnt.
    """

    def __init__(self) -> None:
        self._bias = WalkingBias(_COURSE_WALK, _FIRST_COURSE)
        self._unseen_m = 0.0        # way since images told the share

    def shift(self, ahead_m: float) -> Array:
        """Return the shift (3,) beside one ahead, in the axes of the base."""
        return np.asarray(ahead_m * (_ASIDE @ self._bias.value))

    def covariance(self, ahead_m: float) -> Array:
        """Return the covariance (3, 3) of it.

        Over a way w in steps the errors add up to a variance that goes with w^2.
        """
        way_m = abs(ahead_m)
        return np.asarray(_ASIDE @ self._bias.covariance @ _ASIDE
                          * (2.0 * self._unseen_m + way_m) * way_m)

    def pass_unseen(self, stamp_ns: int, ahead_m: float) -> None:
        """Take a step up to a stamp that images did not tell."""
        self._bias.walk_to(stamp_ns)
        self._unseen_m += abs(ahead_m)

    def learn(self, stamp_ns: int, ahead_m: float, off_m: Array, covariance: Array) -> None:
        """Learn by images of a step up to a stamp.

        Args:
            off_m: (3,) the shift by images less that which was expected.
            covariance: (3, 3) of both.
        """
        self._bias.walk_to(stamp_ns)
        self._bias.learn(ahead_m * np.eye(3)[1:], off_m[1:], covariance[1:, 1:])
        self._unseen_m = 0.0


class Shadows:
    """By how much motions of images may be too long, because shadows went along with a lamp."""

    def __init__(self) -> None:
        self._sun_ns: int | None = None
        self._since_m = np.zeros(3)

    def see_sun(self, stamp_ns: int) -> None:
        """Take it that the sun is seen."""
        self._sun_ns = stamp_ns

    def begin(self, place_m: Array) -> None:
        """Begin anew at a place (3,) of the map that something else told."""
        self._since_m = place_m.copy()

    def covariance(self, stamp_ns: int, before_m: Array, place_m: Array) -> Array:
        """Return the covariance (3, 3), in the map, of a motion that ends at a stamp.

        Errors of the motions so far add up to that share of the distance from where they began.

        Args:
            before_m, place_m: (3,) where it begins and ends.
        """
        if self._sun_ns is not None and stamp_ns - self._sun_ns <= _SUN_NS:
            return np.zeros((3, 3))
        before, now = before_m - self._since_m, place_m - self._since_m
        step = now - before
        square = float(step @ step)
        if square == 0.0:
            return np.zeros((3, 3))
        # On the way back they become less, which no factor of its own can tell.
        more = max(0.0, float(now @ now - before @ before))
        return np.asarray(_WITH_LAMP**2 * more * np.outer(step, step) / square)
