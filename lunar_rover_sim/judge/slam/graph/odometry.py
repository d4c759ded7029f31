"""An odometry with a memory: keyframes in a graph, which loops close.

A frame is located against the last keyframe, from corners that are tracked from where inertial
samples and wheels predict them, or else from descriptors. A frame that has moved on is a keyframe:
its motion, the wheels, gravity, and the sun or the stars become factors of the graph. A place that
was seen before becomes a loop, if geometry and the covariance of the graph agree with it. Where
images tell nothing the wheels carry on, or else nothing but a bound on the speed: the covariance
grows.

The map has its origin at the first pose of the base, and z up; x is that of the world where sun
or stars tell it, else where the rover looked. With maps from orbit poses are told in the site.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, inverse, se3
from lunar_rover_sim.judge.evaluation.trajectory import Stamps, Trajectory, wxyz
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Image
from lunar_rover_sim.judge.slam.graph.anchor import Anchor
from lunar_rover_sim.judge.slam.graph.attitude import Attitude, EXACT
from lunar_rover_sim.judge.slam.graph.lasting import Course, Shadows
from lunar_rover_sim.judge.slam.graph.measured import Aids, Wheels
from lunar_rover_sim.judge.slam.graph.places import evenly_lit, Keyframe, keyframe, Places
from lunar_rover_sim.judge.slam.graph.pose_graph import (adjoint, composed, difference, fused,
                                                         gate, PoseGraph, rolled)
from lunar_rover_sim.judge.slam.graph.two_pairs import matched_motion, Motion, tracked_motion
from lunar_rover_sim.products.sequences.sensors import SensorSuite

_KEYFRAME_M, _KEYFRAME_RAD = 0.25, math.radians(12.0)
_KEYFRAME_FLOW = 0.12           # median way in the image, in its widths
_WELL_SEEN = 40                 # a keyframe is due if fewer corners agree
_LOOP_INLIERS = 25
_LOOP_GAP = 24                  # keyframes that a loop is long at least: over less, little adds up
_LOOP_CANDIDATES = 2
_MOST_SPEED_MPS = 0.3           # without anything that measures it, for the standard deviation
_MOST_RATE_RADPS = 0.3
_MOVED_M = 0.1                  # a correction by more is told


@dataclasses.dataclass
class Counts:
    """What happened so far.

    Attributes:
        frames, keyframes: Taken.
        unseen: Keyframes whose motion images did not tell.
        loops: Closed.
        loops_far, loops_few: Refused: against the covariance, and by geometry.
        sun_refused, stars_refused, wheels_refused: Against the covariance.
        restarts: How often the graph was singular and began anew.
        places: Remembered.
    """

    frames: int = 0
    keyframes: int = 0
    unseen: int = 0
    loops: int = 0
    loops_far: int = 0
    loops_few: int = 0
    sun_refused: int = 0
    stars_refused: int = 0
    wheels_refused: int = 0
    restarts: int = 0
    places: int = 0

    @property
    def words(self) -> str:
        """All of it in a line."""
        text = (f'{self.keyframes} keyframes of {self.frames} frames, {self.unseen} without images'
                f', {self.loops} loops, {self.loops_far + self.loops_few} refused '
                f'({self.loops_few} by geometry, {self.loops_far} by covariance)')
        for name in ('sun', 'stars', 'wheels'):
            if count := getattr(self, f'{name}_refused'):
                text += f', {name} refused {count} times'
        return text + (f', {self.restarts} restarts: the graph was singular' if self.restarts
                       else '')


@dataclasses.dataclass(frozen=True)
class Located:
    """The answer to a frame.

    Attributes:
        T_map_left: (4, 4) pose of the left camera.
        covariance: (6, 6) of x, y, z and of the turn about the axes of the map.
        seen: Whether images told it.
        news: What the estimate did that moves it; empty for nothing.
    """

    T_map_left: Array
    covariance: Array
    seen: bool
    news: str = ''


class GraphOdometry:
    """Takes pairs one after the other, with what was measured beside them.

    Args:
        camera: Rectified pairs, without distortion.
        T_base_left: (4, 4) mount of the left camera.
        gravity_mps2: That the accelerometers feel.
        accel_walk: Random walk of their bias [m/s^3/sqrt(Hz)].
        gyro_walk: That of the gyroscope [rad/s^2/sqrt(Hz)].
        loops: Whether loops are looked for.
        anchor: Finds the place of the map on a site; poses are those in the site then.

    Raises:
        SlamError: Without GTSAM, or without a baseline.
    """

    def __init__(self, camera: Camera, T_base_left: Array, gravity_mps2: float,
                 loops: bool = True, anchor: Anchor | None = None,
                 accel_walk: float = 0.0, gyro_walk: float = 0.0) -> None:
        if not camera.baseline_m > 0.0:
            raise SlamError('baseline: 0 is not valid; the graph needs a stereo pair')
        self._camera, self._T_base_left = camera, np.array(T_base_left)
        self._T_left_base = inverse(T_base_left)
        self._loops = loops
        self._graph, self._anchor = PoseGraph(), anchor
        self._places = Places()
        self._attitude = Attitude(gravity_mps2, accel_walk, gyro_walk)
        self._course, self._shadows = Course(), Shadows()
        self.counts = Counts()
        self._first_key = 0
        self._key = -1                          # of the last keyframe
        self._stamp_ns = 0                      # of the last keyframe
        self._keyframe: Keyframe | None = None
        self._wheels: Wheels | None = None      # at the last keyframe
        self._relative = np.eye(4)              # last frame in the last keyframe, base
        self._frame_ns = 0
        self._seen = False                      # whether images told the last keyframe
        self._pose, self._covariance = np.eye(4), np.zeros((6, 6))     # of the last keyframe
        self._told = self._pose, self._covariance       # the same, or in the site
        self._site = np.eye(4), np.eye(6)               # of the anchor, at the last keyframe
        # Stamp, key, pose and covariance in that keyframe of every frame.
        self._frames: list[tuple[int, int, Array, Array]] = []
        self._live: dict[int, tuple[Array, Array]] = {}     # keys, as told when they were new
        self._ended: dict[int, tuple[Array, Array]] = {}    # keys of graphs before a restart

    @classmethod
    def of(cls, suite: SensorSuite, loops: bool = True,
           anchor: Anchor | None = None) -> GraphOdometry:
        """Return the graph for the sensors of a bag."""
        return cls(Camera.of(suite), suite.T_base_imu @ suite.T_imu_left, suite.gravity_mps2,
                   loops, anchor, suite.noise.accel_bias_random_walk,
                   suite.noise.gyro_bias_random_walk)

    def __repr__(self) -> str:
        return f'GraphOdometry({self.counts})'

    def add(self, stamp_ns: int, left: Image | None, right: Image | None,
            aids: Aids = Aids()) -> Located | None:
        """Take a pair, or None where images are missing; return None until there is a first pose.

        Args:
            stamp_ns: Later than the one before.
            left, right: (h, w) of 8 bits.
            aids: Measured since the pair before.

        Raises:
            SlamError: If the stamp is not later.
        """
        if self._frames and stamp_ns <= self._frame_ns:
            raise SlamError(f'stamp: {stamp_ns} ns does not follow {self._frame_ns} ns; stamps '
                            'must increase')
        left, right = (image if image is None else evenly_lit(image) for image in (left, right))
        self._attitude.take(aids)
        if aids.sun is not None:
            self._shadows.see_sun(stamp_ns)
        self.counts.frames += 1
        if self._key < 0:
            return self._first(stamp_ns, left, right, aids)
        guess, guess_covariance, ahead_m = self._predicted(stamp_ns, aids.wheels)
        motion = None
        if left is not None and self._keyframe is not None:
            T_left_before = self._T_left_base @ inverse(guess) @ self._T_base_left
            motion = tracked_motion(self._camera, self._keyframe, left, T_left_before)
        news = ''
        if motion is None or self._is_due(motion, left):
            news = self._make_keyframe(stamp_ns, left, right, aids, motion, guess,
                                       guess_covariance, ahead_m)
            relative, covariance = np.eye(4), np.zeros((6, 6))
            seen = self._seen
        else:
            relative, covariance = self._in_base(motion)
            seen = True
        self._relative, self._frame_ns = relative, stamp_ns
        self._frames.append((stamp_ns, self._key, relative, covariance))
        return self._located(relative, covariance, seen, news)

    # Frames

    def _first(self, stamp_ns: int, left: Image | None, right: Image | None,
               aids: Aids) -> Located | None:
        if left is None or right is None:
            return None
        knows_heading = self._attitude.begin(self._graph, stamp_ns, aids.inertial)
        if self._anchor is not None:
            self._anchor.begin(self._graph, knows_heading)
        self._graph.solve()
        self._take(0, stamp_ns, keyframe(self._camera, left, right), aids.wheels)
        self._frame_ns = stamp_ns
        self._frames.append((stamp_ns, 0, np.eye(4), np.zeros((6, 6))))
        return self._located(np.eye(4), np.zeros((6, 6)), True, '')

    def _predicted(self, stamp_ns: int,
                   wheels: Wheels | None) -> tuple[Array, Array, float | None]:
        """Return the pose of the base in the last keyframe without images, and its covariance.

        The third is the way ahead by the wheels [m], None without them.
        """
        dt = max(1e-3, (stamp_ns - self._stamp_ns) * 1e-9)
        turn = self._attitude.turn(self._stamp_ns, stamp_ns)
        sigma = np.full(6, _MOST_SPEED_MPS * dt)
        sigma[:3] = min(_MOST_RATE_RADPS * dt, math.pi)
        ahead_m = None
        if wheels is not None and self._wheels is not None:
            T, covariance = rolled(self._wheels, wheels)
        else:
            T, covariance = se3(self._relative[:3, :3], self._relative[:3, 3]), np.diag(sigma**2)
        # Half of the turn lies before the middle of the way.
        way = _half(T).inv().apply(T[:3, 3])
        if wheels is not None and self._wheels is not None:
            ahead_m = float(way[0])
            way += self._course.shift(ahead_m)
            covariance[3:, 3:] += self._course.covariance(ahead_m)
        if turn is not None:
            T = se3(turn[0], T[:3, 3])
            covariance[:3, :] = covariance[:, :3] = 0.0
            covariance[:3, :3] = turn[1]
        return se3(T[:3, :3], _half(T).apply(way)), covariance, ahead_m

    def _is_due(self, motion: Motion, left: Image | None) -> bool:
        assert left is not None
        T = motion.T_a_b
        angle = Rotation.from_matrix(T[:3, :3]).magnitude()
        return bool(np.linalg.norm(T[:3, 3]) > _KEYFRAME_M or angle > _KEYFRAME_RAD
                    or motion.inliers < _WELL_SEEN
                    or motion.flow_px > _KEYFRAME_FLOW * left.shape[1])

    def _in_base(self, motion: Motion) -> tuple[Array, Array]:
        """Return a motion and its covariance of the base."""
        T = self._T_base_left @ motion.T_a_b @ self._T_left_base
        A = adjoint(self._T_base_left)
        return T, A @ motion.covariance @ A.T

    def _located(self, relative: Array, covariance: Array, seen: bool, news: str) -> Located:
        T, P = composed(*self._told, relative, covariance)
        return Located(T @ self._T_base_left, self._of_left(T, P), seen, news)

    def _of_left(self, T_map_base: Array, covariance: Array) -> Array:
        """Return the covariance of position and turn of the left camera about the map's axes."""
        A = adjoint(self._T_left_base)
        R = (T_map_base @ self._T_base_left)[:3, :3]
        J = np.zeros((6, 6))
        J[:3, 3:] = J[3:, :3] = R
        P = J @ A @ covariance @ A.T @ J.T
        return np.asarray(0.5 * (P + P.T))

    # Keyframes

    def _make_keyframe(self, stamp_ns: int, left: Image | None, right: Image | None, aids: Aids,
                       motion: Motion | None, guess: Array, guess_covariance: Array,
                       ahead_m: float | None) -> str:
        new = None
        if left is not None and right is not None:
            new = keyframe(self._camera, left, right)
            if motion is None and self._keyframe is not None:
                motion = matched_motion(self._camera, self._keyframe, new)
        relative, covariance = guess, guess_covariance
        self._seen = motion is not None
        if motion is not None:
            relative, covariance = self._in_base(motion)
            error = difference(relative, guess)
            S = covariance + guess_covariance
            self._attitude.learn_by_images(self._stamp_ns, stamp_ns, relative[:3, :3],
                                           covariance[:3, :3])
            if error @ np.linalg.solve(S, error) > gate(6):
                self.counts.wheels_refused += 1     # geometry has checked the images
            else:
                relative, covariance = fused(relative, covariance, guess, guess_covariance)
                if ahead_m is not None:
                    self._course.learn(stamp_ns, ahead_m, error[3:], S[3:, 3:])
            covariance[3:, 3:] += self._by_lamp(stamp_ns, relative)
        elif ahead_m is not None:
            self._course.pass_unseen(stamp_ns, ahead_m)
        self.counts.unseen += not self._seen
        before, key = self._key, self._key + 1
        T, P = composed(self._pose, self._covariance, relative, covariance)
        self._graph.add(key, T)
        self._graph.between(before, key, relative, covariance)
        refused = self._attitude.hold(self._graph, key, stamp_ns, T[:3, :3], P[:3, :3])
        self.counts.sun_refused += 'sun' in refused
        self.counts.stars_refused += 'stars' in refused
        news = self._solve(key, T, P)
        self._take(key, stamp_ns, new, aids.wheels)
        if self._loops and new is not None:
            news = self._close_loops(key, new) or news
            if len(new) >= _LOOP_INLIERS:
                self._places.add(key, new, self._pose)
        self.counts.places = len(self._places)
        if self._anchor is not None:
            news = '; '.join(filter(None, (news, self._look(key, new))))
        return news

    def _by_lamp(self, stamp_ns: int, relative: Array) -> Array:
        """Return what shadows add to the covariance (3, 3) of a motion, in its axes."""
        T = self._pose @ relative
        R = T[:3, :3]
        return np.asarray(R.T @ self._shadows.covariance(
            stamp_ns, self._pose[:3, 3], T[:3, 3]) @ R)

    def _look(self, key: int, new: Keyframe | None) -> str:
        """Compare the relief with the map from orbit; return what moved."""
        assert self._anchor is not None
        self._anchor.add(key, self._pose, np.zeros((0, 3)) if new is None else new.points_m,
                         self._T_base_left)
        news = self._anchor.look(self._graph)
        if not self._graph.has_new:
            return news
        again = self._solve(key, self._pose, self._covariance)
        self._read_back()
        self._shadows.begin(self._pose[:3, 3])
        return again or news

    def _take(self, key: int, stamp_ns: int, new: Keyframe | None, wheels: Wheels | None) -> None:
        self._key, self._stamp_ns = key, stamp_ns
        self._keyframe = new
        self._wheels = wheels
        self._relative = np.eye(4)
        self.counts.keyframes += 1
        self._read_back()

    def _read_back(self) -> None:
        self._pose = self._graph.pose(self._key)
        self._covariance = self._graph.covariance(self._key)
        self._told = self._in_site(self._key)
        if self._anchor is not None:
            self._site = self._anchor.site(self._graph)
        self._live[self._key] = self._told

    def _in_site(self, key: int) -> tuple[Array, Array]:
        """Return pose and covariance of a keyframe as they are told."""
        if self._anchor is not None:
            return self._anchor.told(self._graph, key)
        return self._graph.pose(key), self._graph.covariance(key)

    def _solve(self, key: int, T: Array, P: Array) -> str:
        """Solve the graph; if it is singular, begin another one at the last pose."""
        try:
            self._graph.solve()
            if np.isfinite(self._graph.pose(key)).all() \
                    and np.isfinite(self._graph.covariance(key)).all():
                return ''
            raise SlamError('the graph is singular: a pose is not finite')
        except (SlamError, RuntimeError):
            self.counts.restarts += 1
            # Poses of a singular graph mean nothing: they stay as they were when they were made.
            self._ended.update((k, self._live[k]) for k in range(self._first_key, key))
            self._graph, self._places = PoseGraph(), Places()
            if self._anchor is not None:
                self._anchor.begin(self._graph, True, *self._site)
            self._first_key = key
            self._graph.add(key, T)
            self._graph.prior(key, T, P + EXACT**2 * np.eye(6))
            self._graph.solve()
            return 'the graph was singular: it begins anew here'

    @property
    def _known(self) -> dict[int, tuple[Array, Array]]:
        """Poses and covariances of the keys of this graph."""
        return {key: self._in_site(key)
                for key in range(self._first_key, self._key + 1)}

    # Loops

    def _close_loops(self, key: int, new: Keyframe) -> str:
        """Look for places that are seen again; return what moved."""
        P = self._of_left(self._pose, self._covariance)
        slack_m = 3.0 * math.sqrt(max(0.0, np.linalg.eigvalsh(P[:2, :2])[-1]))
        slack_rad = 3.0 * math.sqrt(max(0.0, P[5, 5]))
        before, closed = self._pose, 0
        for place in self._places.candidates(new, self._pose, slack_m, slack_rad,
                                             key - _LOOP_GAP, _LOOP_CANDIDATES):
            motion = matched_motion(self._camera, place.keyframe, new)
            if motion is None or motion.inliers < _LOOP_INLIERS:
                self.counts.loops_few += 1
                continue
            relative, covariance = self._in_base(motion)
            predicted = inverse(self._graph.pose(place.key)) @ self._pose
            error = difference(relative, predicted)
            S = self._graph.relative_covariance(place.key, key) + covariance
            if error @ np.linalg.solve(S, error) > gate(6):
                self.counts.loops_far += 1
                continue
            self._graph.between(place.key, key, relative, covariance)
            closed += 1
        if not closed:
            return ''
        self.counts.loops += closed
        T, P = self._pose, self._covariance
        if news := self._solve(key, T, P):
            self._read_back()
            return news
        self._read_back()
        self._places.move(self._graph.poses())
        moved = float(np.linalg.norm(self._pose[:3, 3] - before[:3, 3]))
        return f'a loop moved the estimate by {moved:.2f} m' if moved > _MOVED_M else ''

    # Results

    @property
    def words(self) -> str:
        """What happened so far, in a line."""
        return self.counts.words + ('' if self._anchor is None else f'; {self._anchor.words}')

    @property
    def frames_ns(self) -> Stamps:
        """(n,) stamps of all frames that have a pose."""
        return np.array([ns for ns, *_ in self._frames], np.int64)

    def trajectory(self) -> Trajectory:
        """Return T_map_left of all frames with covariances, by all that is known now.

        Raises:
            SlamError: If there is no pose.
        """
        if not self._frames:
            raise SlamError('nothing was tracked')
        known = {**self._ended, **self._known}
        poses, covariances = [], []
        for _, key, relative, own in self._frames:
            T, P = composed(*known[key], relative, own)
            poses.append(T @ self._T_base_left)
            covariances.append(self._of_left(T, P))
        T = np.array(poses)
        return Trajectory(self.frames_ns, T[:, :3, 3], wxyz(Rotation.from_matrix(T[:, :3, :3])),
                          'graph', np.array(covariances))


def _half(T: Array) -> Rotation:
    """Return half of a turn."""
    return Rotation.from_rotvec(0.5 * Rotation.from_matrix(T[:3, :3]).as_rotvec())
