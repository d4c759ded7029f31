"""A LiDAR or time-of-flight camera on the rover: scans of the ground and the rocks."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
import dataclasses

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.far_rocks import far_rocks
from lunar_rover_sim.ground.world.follower import Follower
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.lidar.beam_pattern import beam_pattern
from lunar_rover_sim.image.lidar.motion import ScanMotion
from lunar_rover_sim.image.lidar.optics import DROP, LidarConfig
from lunar_rover_sim.image.lidar.own_body import OwnBody
from lunar_rover_sim.image.lidar.ray_arrays import HeightPyramid, RockHulls, SoftCells
from lunar_rover_sim.image.lidar.ray_caster import NOTHING, RayCaster, RayHits, ROVER
from lunar_rover_sim.image.lidar.returns import ReturnModel
from lunar_rover_sim.image.lidar.scan import Scan
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import lidar_pose
from lunar_rover_sim.rover.pose import Posed

_STREAM = 7                 # of random numbers, among those of a seed


@dataclasses.dataclass(frozen=True, eq=False)
class _Surroundings:
    """A window of a site as rays are cast on it, in a frame of its own."""

    world: World
    middle_m: Array
    half_m: float
    pyramid: HeightPyramid
    caster: RayCaster
    returns: ReturnModel


class Lidar:
    """A sensor at its mount on a rover on a world.

    Poses are in the frame of the world that it is given, a window of a site: that of the site.

    Attributes:
        world: The window that it scans.
        pattern: Its beams.
        T_base_lidar: (4, 4) its mount.
        legs_met: Whether any beam may meet a leg of the rover.
    """

    def __init__(self, world: World, rover: RoverDescription, config: LidarConfig,
                 seed: int = 1, follower: Follower | None = None) -> None:
        """Prepare the ground within reach.

        Args:
            follower: Makes each scan in the window of the site that it gives for the start;
                without one the window changes by `enter` alone.

        Raises:
            ConfigError: For a mount from which every beam meets the rover's body.
        """
        self._config, self._seed = config, seed
        self.pattern = beam_pattern(config.optics, config.rate_hz)
        self.T_base_lidar = lidar_pose(rover)
        self._legs = len(rover.legs.each)
        self._own = OwnBody(rover, self.pattern)
        self._range_m = config.optics.max_range_m
        self._overlay: Overlay | None = None
        self._soft: SoftCells | None = None
        self._pool = ThreadPoolExecutor(1)
        self._coming: tuple[World, Future[_Surroundings]] | None = None
        self._around = self._prepared(world)
        self._follower = follower

    def _prepared(self, given: World) -> _Surroundings:
        """Return the ground within reach of a window."""
        world = given.local()
        reach = world.ground.half_extent_m + self._range_m
        rocks = world.rocks.joined(far_rocks(world, reach))
        hulls = RockHulls(rocks, world.rock_shapes)
        pyramids = []
        for grid in world.levels:
            pyramids.append(HeightPyramid(grid, hulls))
            if grid.half_extent_m >= reach:
                break
        return _Surroundings(
            given, np.array([*given.ground.middle_m, 0.0]), world.ground.half_extent_m,
            pyramids[0], RayCaster(pyramids, hulls),
            ReturnModel(self._config, world.albedo, world.ground.cell_m, rocks.albedo))

    @property
    def world(self) -> World:
        """The window that it scans."""
        return self._around.world

    def ahead(self, world: World) -> None:
        """Begin to prepare another window of the site in a thread, so that `enter` is quick."""
        if self._coming is None or self._coming[0] is not world:
            self._coming = world, self._pool.submit(self._prepared, world)

    def enter(self, world: World) -> None:
        """Scan another window of the site from now on, in the same frame."""
        coming, self._coming = self._coming, None
        self._around = (coming[1].result() if coming is not None and coming[0] is world
                        else self._prepared(world))
        if self._overlay is not None:
            self.follow(self._overlay)

    def __repr__(self) -> str:
        return (f'Lidar({self._config.part}, {len(self.pattern)} beams, '
                f'{self._config.rate_hz:g} Hz)')

    @property
    def legs_met(self) -> bool:
        """Whether any beam may meet a leg of the rover."""
        return self._own.legs_met

    def follow(self, overlay: Overlay) -> None:
        """Use the deformed ground of `overlay` from now on; it is read at every scan."""
        self._overlay = overlay
        self._soft = SoftCells(self._around.pyramid, overlay, self._around.middle_m[:2])
        self._around.caster.soft = self._soft

    def scan(self, motion: ScanMotion | Posed, index: int = 0) -> Scan:
        """Return a scan.

        Args:
            motion: Of base_link, from the start of the scan on; or a state, whose velocities last.
            index: Of the scan; each has its own noise, the same one at every call.

        Raises:
            ConfigError: If the sensor is not over the ground that the rover walks on.
        """
        if not isinstance(motion, ScanMotion):
            motion = ScanMotion.of(motion, 1e-9 * self._config.period_ns, self._legs)
        times = np.append(0.0, self.pattern.column_s)
        R_base, p_base = motion.at(times)
        self._go_on(*p_base[0, :2].tolist())
        R = R_base @ self.T_base_lidar[:3, :3]
        p = p_base + R_base @ self.T_base_lidar[:3, 3]
        origin, direction = self._rays(R[1:], p[1:])
        hits = self._cast(origin, direction, R_base[1:], motion.joint_angles(times[1:]))
        rng = np.random.default_rng([self._seed, _STREAM, index])
        returns = self._around.returns.measure(origin - self._around.middle_m, direction, hits,
                                               rng)
        return Scan(self.pattern, returns, R, p)

    def true_hits(self, T_world_base: Array, joint_angle_rad: Array | None = None) -> RayHits:
        """Return what the beams of a sensor at rest meet, (4, 4) pose of base_link.

        Beams on the rover meet nothing, with `own_body` end they meet the ROVER.

        Args:
            joint_angle_rad: (legs,) angles; None: legs are met by no beam.
        """
        T_base = np.asarray(T_world_base, float)
        T, columns = T_base @ self.T_base_lidar, self.pattern.columns
        origin, direction = self._rays(np.broadcast_to(T[:3, :3], (columns, 3, 3)),
                                       np.broadcast_to(T[:3, 3], (columns, 3)))
        angles = None if joint_angle_rad is None else np.broadcast_to(
            np.asarray(joint_angle_rad, float), (columns, self._legs))
        return self._cast(origin, direction, np.broadcast_to(T_base[:3, :3], (columns, 3, 3)),
                          angles)

    def _go_on(self, x_m: float, y_m: float) -> None:
        """Enter the window of a place, and prepare the next one before it is needed."""
        if self._follower is None:
            return
        world = self._follower.at(x_m, y_m)
        if world is not self.world:
            self.enter(world)
        elif (coming := self._follower.next) is not None:
            self.ahead(coming)

    def _rays(self, R: Array, p: Array) -> tuple[Array, Array]:
        """Return (n, 3) origins and directions of all beams from poses of the columns."""
        pattern = self.pattern
        local = pattern.direction.reshape(pattern.columns, pattern.rings, 3)
        direction = (local @ R.transpose(0, 2, 1)).reshape(-1, 3)
        return np.repeat(p, pattern.rings, axis=0), direction

    def _cast(self, origin: Array, direction: Array, R_base: Array,
              joint_angle_rad: Array | None) -> RayHits:
        """Return what rays meet; R_base: (columns, 3, 3); joint_angle_rad: (columns, legs)."""
        half, middle = self._around.half_m, self._around.middle_m
        x, y = origin[0, :2].tolist()
        origin = origin - middle    # the frame that rays are cast in
        if not np.abs(origin[::self.pattern.rings, :2]).max() < half:    # once a column
            of = 'the origin' if not middle.any() else '(%g, %g)' % tuple(middle[:2])
            raise ConfigError(f'the LiDAR at ({x:.2f}, {y:.2f}) m is not over the ground of the '
                              f'rover; valid is within {half:g} m of {of}, in x and y')
        if self._soft is not None:
            self._soft.update()
        hits = self._around.caster.cast(origin, direction, self._range_m, self._own.free)
        self._end_on_rover(hits, R_base, joint_angle_rad)
        return hits

    def _end_on_rover(self, hits: RayHits, R_base: Array, joint_angle_rad: Array | None) -> None:
        """Let beams end on the rover, or return nothing."""
        own, drop = self._own, self._config.own_body == DROP
        body = np.flatnonzero(np.isfinite(own.body_m) & (own.body_m <= self._range_m))
        parts = [] if drop else [(body, own.body_m[body], own.body_normal[body])]
        if joint_angle_rad is not None and own.legs_met:
            parts.append(own.legs(joint_angle_rad))
        for beam, distance, normal in parts:
            nearer = distance < hits.distance_m[beam]
            beam = beam[nearer]
            hits.distance_m[beam] = np.inf if drop else distance[nearer]
            hits.target[beam] = NOTHING if drop else ROVER
            turn = R_base[self.pattern.column[beam]]
            hits.normal[beam] = 0.0 if drop else np.einsum('ijk,ik->ij', turn, normal[nearer])
