"""Motion during the exposure: the mean of radiance over it, from the picture at its stamp.

The exposure of the middle row is centred on the stamp; with a global shutter, that of all rows is.
Velocities are taken as constant. The picture at the stamp is sampled along the path of each
pixel, and what lies beyond the image repeats its edge. Parts of the rover in view move as their
links do. Shadows move with the ground, also those of the rover and of its lamp.
"""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.compiled import compiled, vectorised
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.workers import ONE_THREAD, Workers
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.image_geometry import ImageGeometry
from lunar_rover_sim.image.camera.motion import CameraTwist

F32 = NDArray[np.float32]

_STILL_PX = 0.2         # a picture in which nothing moves farther stays as it is: at an edge,
# the mean over such a path differs by less than 0.2 % of the step
_STENCIL_PX = 3.0       # up to this length, the mean over a path is one over 3 x 3 pixels
_STEP_PX = 1.5          # between samples on the longest path; most paths are half as long
_MOST_SAMPLES = 128
_GRID = np.linspace(0.0, 1.0, 5)    # places in the image, over its size, where paths are measured
_NEAREST_M = 0.1        # least depth that counts then
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_COLUMNS, _PAGE = 128, 144      # that are taken at a time; pages of their numbers:
# Way from the start of the path to its end, how far it bends, samples, the sum of their light,
# a place between four pixels, and those.
_WAY_U, _WAY_V, _BEND_U, _BEND_V, _NUMBER, _TOTAL = (k * _PAGE for k in range(6))
_U, _V, _A, _B, _C, _D = (k * _PAGE for k in range(6, 12))


@dataclasses.dataclass(frozen=True)
class MovingBody:
    """What a camera sees move.

    Attributes:
        twist: Motion of the camera relative to it.
        link: As in the image of links: 0 for the world, else 1 + the index of a link.
        nearness: Inverse depth of its origin, roughly [1/m].
    """

    twist: CameraTwist
    link: int = 0
    nearness: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Movement:
    """How a camera moves.

    Attributes:
        bodies: The world, then the links of the rover that move in the image.
        down: (3,) unit vector, camera axes.
        height_m: Of the camera above level ground under the rover.
    """

    bodies: Sequence[MovingBody]
    down: Array
    height_m: float


class MotionBlur:
    """Blurs radiance images by the motion during the exposure, and rolls the shutter."""

    def __init__(self, camera: CameraConfig, sensor: SensorConfig, image: ImageGeometry,
                 workers: Workers = ONE_THREAD, *, on_body: bool) -> None:
        """Prepare what does not depend on the motion.

        Args:
            camera: Has the distortion of the rows of the sensor.
            sensor: Has the line time of the shutter.
            image: Geometry of what is drawn, padding included.
            workers: Share the rows.
            on_body: Whether the camera moves with the body of the rover.
        """
        self._workers = workers
        self._image, self._on_body = image, on_body
        self._blur, self._line_time_s = sensor.motion_blur, sensor.line_time_s
        self._roll_s = camera.height * self._line_time_s
        self._distortion = tuple(float(k) for k in camera.distortion)
        places = np.stack(np.meshgrid(_GRID * (image.width - 1), _GRID * (image.height - 1)),
                          axis=-1).reshape(-1, 2)
        self._rays = image.rays(places)
        self._fastest = functools.lru_cache(2)(self._fastest_point)     # of both cameras
        # Compiled now: the first long path may come in the middle of a drive.
        at_rest = Movement([MovingBody(CameraTwist(np.zeros(3), np.zeros(3)))], np.zeros(3), 1.0)
        dark, nowhere = np.zeros((1, 1), np.float32), np.zeros((1, 1), np.uint8)
        self._gather(dark, nowhere, dark, dark, at_rest, 0.0, 1, None)
        _along_arcs(0, 0, dark, dark, *self._of_pinhole(at_rest.bodies[0].twist, 0.0), 1,
                    np.float32(_STEP_PX), dark)

    def is_seen(self, movement: Movement, exposure_s: float) -> bool:
        """Return whether anything moves far enough during an exposure to be seen."""
        path = self._fastest(movement) * (exposure_s * self._blur + self._roll_s)
        return path >= _STILL_PX

    def mean(self, radiance: F32, depth_m: F32, movement: Movement, exposure_s: float,
             link: NDArray[np.uint8] | None = None) -> F32:
        """Return the mean radiance of an image over an exposure.

        Args:
            radiance: (h, w) at the stamp [W m-2 sr-1].
            depth_m: (h, w); 0 is the sky; the sign does not count. Of a fisheye, the distance.
            movement: Of the camera.
            exposure_s: Time that light is gathered for.
            link: (h, w) 0, or 1 + the index of the link of the rover that a pixel shows; None
                where no link is seen.

        Returns:
            (h, w) radiance; the given image itself where nothing moves far enough to be seen.
        """
        exposure_s *= self._blur
        longest = self._fastest(movement) * (exposure_s + self._roll_s)
        if longest < _STILL_PX:
            return radiance
        world, mean = movement.bodies[0].twist, np.empty(radiance.shape, np.float32)
        samples = min(2 * math.ceil(0.5 * longest / _STEP_PX), _MOST_SAMPLES) if self._blur else 1
        if not self._line_time_s and not self._image.fisheye:
            lens, turn, shift = self._of_pinhole(world, exposure_s)
            if longest < _STENCIL_PX:
                self._workers.rows(_by_stencil, len(mean), radiance, depth_m, lens, turn, shift,
                                   mean)
            else:
                self._workers.rows(_along_arcs, len(mean), radiance, depth_m, lens, turn, shift,
                                   samples, np.float32(_STEP_PX), mean)
        else:
            everywhere = np.ones(radiance.shape, np.uint8)
            self._gather(mean, everywhere, radiance, depth_m, movement, exposure_s, samples, None)
        if link is not None:
            self._gather(mean, _around(link, longest), radiance, depth_m, movement, exposure_s,
                         samples, link)
        return mean

    def _fastest_point(self, movement: Movement) -> float:
        """Return about how fast points move in the image, at most [px/s].

        It is measured at 25 places, where the ground is taken to be level under the rover's feet.
        """
        height = max(movement.height_m, _NEAREST_M)
        ground = np.minimum(np.maximum(self._rays @ movement.down, 0.0) / height,
                            1.0 / _NEAREST_M)
        fastest = 0.0
        for body in movement.bodies:
            nearness = np.full(len(self._rays), body.nearness) if body.link else ground
            speed = self._image.image_speed(body.twist, self._rays, nearness)
            fastest = max(fastest, float(np.max(speed)))
        return fastest

    def _of_pinhole(self, twist: CameraTwist, exposure_s: float) -> tuple[F32, F32, F32]:
        """Return focal lengths and centre, turn and shift during the exposure."""
        K = self._image.K
        return (np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], np.float32),
                np.asarray(exposure_s * twist.angular_velocity_radps, np.float32),
                np.asarray(exposure_s * twist.linear_velocity_mps, np.float32))

    def _gather(self, mean: F32, where: NDArray[np.uint8], radiance: F32, depth_m: F32,
                movement: Movement, exposure_s: float, samples: int,
                link: NDArray[np.uint8] | None) -> None:
        """Fill in the mean of the pixels marked in `where`, along the path of each."""
        K, bodies = self._image.K, movement.bodies if link is not None else movement.bodies[:1]
        lens = tuple(float(x) for x in (K[0, 0], K[1, 1], K[0, 2], K[1, 2],
                                        *(self._image.fisheye or (0.0,) * 5)))
        self._workers.rows(
            _along_paths, len(mean), mean, where, radiance, depth_m, lens, self._image.ray_table,
            self._distortion, self._line_time_s, exposure_s, samples, _STEP_PX,
            np.array([[*body.twist.angular_velocity_radps, *body.twist.linear_velocity_mps]
                      for body in bodies], float),
            np.array([body.nearness for body in bodies], float),
            np.array([body.link for body in bodies], np.uint8),
            np.zeros((0, 0), np.uint8) if link is None else link, self._on_body)


def _around(link: NDArray[np.uint8], reach_px: float) -> NDArray[np.uint8]:
    """Return (h, w) where paths of such a length may meet a link."""
    side = 2 * math.ceil(reach_px) + 3
    return np.asarray(cv2.dilate(np.minimum(link, 1), np.ones((side, side), np.uint8)), np.uint8)


@compiled
def _by_stencil(first, last, radiance, depth, lens, turn, shift,  # type: ignore[no-untyped-def]
                result):
    """Fill in rows of the mean over short paths, by weights of 3 x 3 pixels.

    The weights are those of two samples between pixels, on either side. Over a path of p pixels
    along an axis the interpolated image has the mean of samples p / 4 away, which has the variance
    p / 4. Below a pixel that would blur far more than the path does: there the variance is that of
    the path, p^2 / 12.
    """
    h, w = radiance.shape
    one, zero, half, two = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(2.0)
    quarter, twelfth, shortest = np.float32(0.25), np.float32(1.0 / 12.0), np.float32(1.0)
    fx, fy, cx, cy = lens
    rx, ry, rz = turn
    sx, sy, sz = shift
    # Weights of a neighbour beside, above or below, and of one on the falling and the rising
    # diagonal.
    beside, over = np.empty(w, np.float32), np.empty(w, np.float32)
    falling, rising = np.empty(w, np.float32), np.empty(w, np.float32)
    x = (np.arange(w).astype(np.float32) - cx) / fx
    for r in range(first, last):
        y = (np.float32(r) - cy) / fy
        row = depth[r]
        for c in range(w):
            far = abs(row[c])
            near = one / far if far > zero else zero
            z = rx * y - ry * x[c] + sz * near
            px = (ry - rz * y + sx * near - x[c] * z) * fx
            py = (rz * x[c] - rx + sy * near - y * z) * fy
            ax, ay = abs(px), abs(py)
            long = min(max(two * (max(ax, ay) - shortest), zero), one)
            # What is very near may move farther than the longest path that was measured.
            vx = min(ax * (ax * twelfth * (one - long) + quarter * long), one)
            vy = min(ay * (ay * twelfth * (one - long) + quarter * long), one)
            beside[c], over[c] = half * vx * (one - vy), half * vy * (one - vx)
            joint = vx * vy
            down = px * py > zero
            falling[c] = half * joint if down else zero
            rising[c] = zero if down else half * joint
        own, up, down_row = radiance[r], radiance[max(r - 1, 0)], radiance[min(r + 1, h - 1)]
        out = result[r]
        west, middle, east = own[:w - 2], own[1:w - 1], own[2:]
        nw, north, ne = up[:w - 2], up[1:w - 1], up[2:]
        sw, south, se = down_row[:w - 2], down_row[1:w - 1], down_row[2:]
        a, b, f, g = beside[1:w - 1], over[1:w - 1], falling[1:w - 1], rising[1:w - 1]
        inner = out[1:w - 1]
        for c in range(w - 2):
            both = middle[c] + middle[c]
            inner[c] = (middle[c] + a[c] * (west[c] + east[c] - both)
                        + b[c] * (north[c] + south[c] - both) + f[c] * (nw[c] + se[c] - both)
                        + g[c] * (sw[c] + ne[c] - both))
        for c in (0, w - 1):
            c0, c1 = max(c - 1, 0), min(c + 1, w - 1)
            both = own[c] + own[c]
            out[c] = (own[c] + beside[c] * (own[c0] + own[c1] - both)
                      + over[c] * (up[c] + down_row[c] - both)
                      + falling[c] * (up[c0] + down_row[c1] - both)
                      + rising[c] * (down_row[c0] + up[c1] - both))


@vectorised
def _along_arcs(first, last, radiance, depth, lens, turn, shift,  # type: ignore[no-untyped-def]
                samples, apart, result):
    """Fill in rows of the mean along the paths of a pinhole camera that exposes all rows at once.

    Each path is a parabola through its start, middle and end, as in `_along_paths`.
    """
    h, w = radiance.shape
    s, place = np.empty(12 * _PAGE, np.float32), np.empty(_PAGE, np.uint32)
    image, wide, steps = radiance.ravel(), np.uint32(w), np.float32(samples)
    right, bottom = np.float32(w - 1), np.float32(h - 1)
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    # To the end of the exposure, for its start they change sign.
    rx, ry, rz = _HALF * turn[0], _HALF * turn[1], _HALF * turn[2]
    sx, sy, sz = _HALF * shift[0], _HALF * shift[1], _HALF * shift[2]
    square = rx * rx + ry * ry + rz * rz
    sine = _ONE - square * (_ONE / np.float32(6.0) - square / np.float32(120.0))
    cosine = _HALF - square / np.float32(24.0)
    tx, ty, tz = (_HALF * (ry * sz - rz * sy), _HALF * (rz * sx - rx * sz),
                  _HALF * (rx * sy - ry * sx))
    for r in range(first, last):
        y, own = (np.float32(r) - cy) / fy, np.float32(r)
        for start in range(0, w, _COLUMNS):
            count = min(_COLUMNS, w - start)
            for j in range(count):
                s[_A + j] = abs(depth[r, start + j])
            for j in range(count):
                x, far = (np.float32(start + j) - cx) / fx, s[_A + j]
                near = _ONE / far if far > _ZERO else _ZERO
                ax, ay, az = ry - rz * y, rz * x - rx, rx * y - ry * x
                qx, qy, qz = (cosine * (ry * az - rz * ay), cosine * (rz * ax - rx * az),
                              cosine * (rx * ay - ry * ax))
                ax, ay, az = sine * ax, sine * ay, sine * az
                # The depth falls by the shift along the view; to first order the place grows by
                # as much.
                grows = (_ONE - (tz + sz) * near) / (_ONE + qz + az)
                u1 = ((x + qx + ax) * grows + (tx + sx) * near - x) * fx
                v1 = ((y + qy + ay) * grows + (ty + sy) * near - y) * fy
                grows = (_ONE - (tz - sz) * near) / (_ONE + qz - az)
                u0 = ((x + qx - ax) * grows + (tx - sx) * near - x) * fx
                v0 = ((y + qy - ay) * grows + (ty - sy) * near - y) * fy
                length = np.sqrt((u1 - u0) * (u1 - u0) + (v1 - v0) * (v1 - v0))
                s[_WAY_U + j], s[_WAY_V + j] = u1 - u0, v1 - v0
                s[_BEND_U + j], s[_BEND_V + j] = _TWO * (u0 + u1), _TWO * (v0 + v1)
                s[_NUMBER + j] = min(np.floor(length / apart) + _TWO, steps)
                s[_TOTAL + j] = _ZERO
            most = np.int32(0)
            for j in range(count):
                most = max(most, np.int32(s[_NUMBER + j]))
            for i in range(most):
                taken = np.float32(i)
                for j in range(count):
                    part = (taken + _HALF) / s[_NUMBER + j] - _HALF
                    u = np.float32(start + j) + part * (s[_WAY_U + j] + part * s[_BEND_U + j])
                    v = own + part * (s[_WAY_V + j] + part * s[_BEND_V + j])
                    u, v = min(max(u, _ZERO), right), min(max(v, _ZERO), bottom)
                    column, row = min(np.floor(u), right - _ONE), min(np.floor(v), bottom - _ONE)
                    s[_U + j], s[_V + j] = u - column, v - row
                    place[j] = np.uint32(np.uint32(np.uint32(np.int32(row)) * wide)
                                         + np.uint32(np.int32(column)))
                for j in range(count):
                    k = place[j]
                    s[_A + j], s[_B + j] = image[k], image[np.uint32(k + np.uint32(1))]
                    k = np.uint32(k + wide)
                    s[_C + j], s[_D + j] = image[k], image[np.uint32(k + np.uint32(1))]
                for j in range(count):
                    upper = s[_A + j] + s[_U + j] * (s[_B + j] - s[_A + j])
                    lower = s[_C + j] + s[_U + j] * (s[_D + j] - s[_C + j])
                    light = upper + s[_V + j] * (lower - upper)
                    s[_TOTAL + j] += light if taken < s[_NUMBER + j] else _ZERO
            for j in range(count):
                result[r, start + j] = s[_TOTAL + j] / s[_NUMBER + j]


@compiled
def _place_of(x, y, z, lens):  # type: ignore[no-untyped-def]
    """Return the pixel (column, row) of a fisheye that shows a direction.

    What lies outside the image repeats its edge.
    """
    beside = math.sqrt(x * x + y * y)
    a = min(math.atan2(beside, z), lens[8] - 1.0 / lens[0])
    t = a * a
    radius = a * (1.0 + t * (lens[4] + t * (lens[5] + t * (lens[6] + t * lens[7]))))
    scale = radius / beside if beside > 1e-6 * abs(z) else 1.0 / z
    return x * scale * lens[0] + lens[2], y * scale * lens[1] + lens[3]


@compiled
def _source_at(x, y, z, t, nearness, twist, lens):  # type: ignore[no-untyped-def]
    """Return the pixel (column, row) that shows at the stamp what a ray shows at time t.

    Rodrigues' rotation, its sine and cosine as series (error below 1e-6 for turns up to 0.5 rad),
    then the shift by depth.
    """
    rx, ry, rz, vx, vy, vz = twist
    ax, ay, az = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
    s = (rx * rx + ry * ry + rz * rz) * t * t
    sine = t * (1.0 - s * (1.0 / 6.0 - s * (1.0 / 120.0)))
    cosine = t * t * (0.5 - s * (1.0 / 24.0 - s * (1.0 / 720.0)))
    gx = x + sine * ax + cosine * (ry * az - rz * ay)
    gy = y + sine * ay + cosine * (rz * ax - rx * az)
    gz = z + sine * az + cosine * (rx * ay - ry * ax)
    half = 0.5 * t * t
    dx = (t * vx + half * (ry * vz - rz * vy)) * nearness
    dy = (t * vy + half * (rz * vx - rx * vz)) * nearness
    dz = (t * vz + half * (rx * vy - ry * vx)) * nearness
    if lens[8] > 0.0:
        return _place_of(gx + dx, gy + dy, gz + dz, lens)
    # The depth falls by dz / nearness; to first order the place grows by as much.
    column = gx / gz * (1.0 - dz) + dx
    row = gy / gz * (1.0 - dz) + dy
    return column * lens[0] + lens[2], row * lens[1] + lens[3]


@compiled
def _nearest(column, row, h, w):  # type: ignore[no-untyped-def]
    """Return row and column of the nearest pixel of the image."""
    return (min(max(int(math.floor(row + 0.5)), 0), h - 1),
            min(max(int(math.floor(column + 0.5)), 0), w - 1))


@compiled
def _sampled(image, column, row):  # type: ignore[no-untyped-def]
    """Return an image at a place between pixels; beyond its edge, what its edge shows."""
    h, w = image.shape
    column, row = min(max(column, 0.0), w - 1.0), min(max(row, 0.0), h - 1.0)
    c, r = int(column), int(row)
    c1, r1 = min(c + 1, w - 1), min(r + 1, h - 1)
    x, y = column - c, row - r
    upper = image[r, c] + x * (image[r, c1] - image[r, c])
    lower = image[r1, c] + x * (image[r1, c1] - image[r1, c])
    return upper + y * (lower - upper)


@compiled
def _nearness_at(depth, column, row):  # type: ignore[no-untyped-def]
    """Return the inverse depth of the nearest pixel; 0 in the sky."""
    h, w = depth.shape
    r, c = _nearest(column, row, h, w)
    far = abs(depth[r, c])
    return 1.0 / far if far > 0.0 else 0.0


@compiled
def _part(image, link, which, column, row):  # type: ignore[no-untyped-def]
    """Return radiance at a place where a part shows; parts that move differently do not mix."""
    h, w = image.shape
    c, r = min(max(column, 0.0), w - 1.0), min(max(row, 0.0), h - 1.0)
    c0, r0 = int(c), int(r)
    c1, r1 = min(c0 + 1, w - 1) if c > c0 else c0, min(r0 + 1, h - 1) if r > r0 else r0
    if (link[r0, c0] == which and link[r0, c1] == which and link[r1, c0] == which
            and link[r1, c1] == which):
        return _sampled(image, column, row)
    r, c = _nearest(column, row, h, w)
    return float(image[r, c])


@compiled
def _row_time(x, y, z, lens, distortion, line_time):  # type: ignore[no-untyped-def]
    """Return the middle of the exposure of a row, after that of the middle row."""
    if lens[8] > 0.0:
        return (_place_of(x, y, z, lens)[1] - lens[3]) * line_time
    k1, k2, p1, p2, k3 = distortion
    r = x * x + y * y
    y = (y * (1.0 + r * (k1 + r * (k2 + r * k3))) + p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y)
    return y * lens[1] * line_time


@compiled
def _twist(twists, k):  # type: ignore[no-untyped-def]
    """Return the motion of a body as numbers: an array would be looked up again and again."""
    return (twists[k, 0], twists[k, 1], twists[k, 2], twists[k, 3], twists[k, 4], twists[k, 5])


@compiled
def _seen_at(image, depth, link, x, y, z, r, c, t, nearness,  # type: ignore[no-untyped-def]
             lens, twists, near, links, on_body):
    """Return radiance at time t and 1, or 0 and 0 where it is not known.

    The picture of the stamp does not show what lies behind the rover.
    """
    h, w = image.shape
    own = link[r, c]
    if on_body and own == 1:
        return float(image[r, c]), 1.0      # the body moves with the camera
    for k in range(1, len(links)):
        which, twist = links[k], _twist(twists, k)
        column, row = _source_at(x, y, z, t, near[k], twist, lens)
        if link[_nearest(column, row, h, w)] == which:
            there = _nearness_at(depth, column, row)
            column, row = _source_at(x, y, z, t, there, twist, lens)
        if link[_nearest(column, row, h, w)] == which:
            return _part(image, link, which, column, row), 1.0
    twist = _twist(twists, 0)
    if own > 0:
        column, row = _source_at(x, y, z, t, 0.0, twist, lens)
        nearness = _nearness_at(depth, column, row)
    column, row = _source_at(x, y, z, t, nearness, twist, lens)
    if link[_nearest(column, row, h, w)] == 0:
        return _part(image, link, 0, column, row), 1.0
    return 0.0, 0.0


@compiled
def _along_paths(start, end, mean, where, image, depth,  # type: ignore[no-untyped-def]
                 lens, all_rays, distortion, line_time, exposure, samples, apart, twists, near,
                 links, link, on_body):
    """Fill in the mean radiance of marked pixels of some rows, along the path of each."""
    w = image.shape[1]
    fisheye = lens[8] > 0.0
    # Samples lie at the middle of equal parts of the exposure.
    first, step = 0.5 / samples - 0.5, 1.0 / samples
    twist = _twist(twists, 0)
    for r in range(start, end):
        for c in range(w):
            if not where[r, c]:
                continue
            if fisheye:
                x, y, z = all_rays[r, c, 0], all_rays[r, c, 1], all_rays[r, c, 2]
                if math.isnan(x):       # beyond the limit of the image
                    mean[r, c] = 0.0
                    continue
            else:
                x, y, z = (c - lens[2]) / lens[0], (r - lens[3]) / lens[1], 1.0
            nearness = _nearness_at(depth, c, r)
            middle = 0.0
            if line_time > 0.0:
                middle = _row_time(x, y, z, lens, distortion, line_time)
                for _ in range(2):
                    column, row = _source_at(x, y, z, middle, nearness, twist, lens)
                    nearness = _nearness_at(depth, column, row)
            if len(link):
                total, known = 0.0, 0.0
                for i in range(samples):
                    light, one = _seen_at(image, depth, link, x, y, z, r, c,
                                          middle + (first + i * step) * exposure, nearness, lens,
                                          twists, near, links, on_body)
                    total += light
                    known += one
                mean[r, c] = total / known if known > 0.0 else image[r, c]
                continue
            # The path, by a parabola through its start, middle and end.
            half = 0.5 * exposure
            u0, v0 = _source_at(x, y, z, middle - half, nearness, twist, lens)
            u, v = _source_at(x, y, z, middle, nearness, twist, lens)
            u1, v1 = _source_at(x, y, z, middle + half, nearness, twist, lens)
            bend_u, bend_v = 2.0 * (u0 + u1 - 2.0 * u), 2.0 * (v0 + v1 - 2.0 * v)
            length = math.sqrt((u1 - u0)**2 + (v1 - v0)**2)
            count = min(int(length / apart) + 2, samples)
            total = 0.0
            for i in range(count):
                s = (i + 0.5) / count - 0.5
                total += _sampled(image, u + s * (u1 - u0 + s * bend_u),
                                  v + s * (v1 - v0 + s * bend_v))
            mean[r, c] = total / count
