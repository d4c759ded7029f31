"""`Reach`: come to a goal among craters and rocks, by velocity commands at 5 Hz.

The packaged gait follows the commands. The policy sees where the goal is, and the elevation around
the rover: the true one (`truth`), rocks as half balls, or the map of what the stereo camera has
seen (`seen`), made by the core of mapping_node at the true pose.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from lunar_rover_sim.autonomy.learning.randomisation import check_ranges, even
from lunar_rover_sim.autonomy.learning.senses import Channel, Sample, scaled, Upright
from lunar_rover_sim.autonomy.learning.task import Driver, Ending, RoverTask, TaskConfig
from lunar_rover_sim.autonomy.navigation.config import MapConfig, TRUTH
from lunar_rover_sim.autonomy.navigation.elevation_map import Elevation, ElevationMap
from lunar_rover_sim.base.frames import Array, rpy_from_wxyz
from lunar_rover_sim.base.parameters import group, param
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.stereo.seen_depth import SeenDepth
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.gait.controller import GaitController
from lunar_rover_sim.rover.physics.state import RoverState

# Cells of the elevation, in base axes [m].
AHEAD_M = tuple(round(-0.3 + 0.15 * k, 2) for k in range(11))
ASIDE_M = tuple(round(-0.6 + 0.15 * k, 2) for k in range(9))
REACHED = Ending('reached', 'reached', failed=False)
SEEN = 'seen'


@dataclasses.dataclass(frozen=True)
class ReachConfig(TaskConfig):
    """Parameters of `Reach`."""

    episode_s: float = param(60.0, 'length of an episode', unit='s', low=0.1, high=3600.0)
    elevation: str = param(TRUTH, 'elevation that is observed: the truth, or the map of what the'
                           ' camera has seen; a cell that it has not seen is as high as base_link',
                           choices=(TRUTH, SEEN))
    sun: SunConfig = group(SunConfig)
    goal_m: tuple[float, ...] = param((2.0, 4.0), 'distance of the goal, least and greatest',
                                      unit='m', length=2, low=0.5, high=8.0)
    reached_m: float = param(0.3, 'distance at which the goal is reached', unit='m', low=0.05)
    progress_weight: float = param(1.0, 'reward of each metre towards the goal', low=0.0)
    reached_reward: float = param(2.0, 'reward of the goal', low=0.0)
    energy_weight: float = param(0.1, 'cost of energy over weight times a metre', low=0.0)
    time_weight: float = param(0.01, 'cost of each second', low=0.0)

    def validate(self) -> None:
        """Raise ConfigError for a range that is upside down."""
        check_ranges(self, 'goal_m')


class ReachDriver(Driver):
    """Velocity commands to the packaged gait."""

    decision_ns, follow_ns = 200_000_000, 20_000_000
    channels: tuple[Channel, ...] = ()

    def __init__(self, config: ReachConfig, rover: RoverDescription) -> None:
        """Walk with the gait of a rover on the ground of a task."""
        gait = GaitConfig().for_rover(rover)
        self._gait = GaitController(gait, GaitCalibration.of(gait, config.ground, rover.name),
                                    rover.legs)
        self.upright = Upright(rover)
        self.actions = (Channel('forward', 'm/s', 0.1, 0.1), Channel('yaw_rate', 'rad/s', 0.3))
        self.reset()

    def reset(self) -> None:
        """Stand."""
        self._gait.reset()
        self.upright.reset()
        self.action = np.array([-1.0, 0.0])

    def set_velocity(self, forward_mps: float, yaw_rate_radps: float) -> None:
        """Set the velocity that the gait follows."""
        self._gait.set_velocity(forward_mps, yaw_rate_radps)

    def feel(self, sample: Sample) -> None:
        """Take in a sample, and let the gait answer it."""
        self.upright.feel(sample)
        self._asked = self._gait.update(sample.stamp_ns, sample.angle_rad, sample.speed_radps)

    def observation(self) -> np.ndarray:
        """Return nothing: what is seen is the task's, which knows the goal."""
        return np.empty(0, np.float32)

    def decide(self, action: Array) -> None:
        """Take an action: forward speed and yaw rate."""
        self.action = action
        self.set_velocity(*(channel.offset + channel.scale * number
                            for channel, number in zip(self.actions, action.tolist())))

    def legs(self) -> tuple[Array, Array]:
        """Return leg speeds and reference angles."""
        return self._asked.velocity_radps, self._asked.angle_rad


class Reach(RoverTask):
    """Come to a goal."""

    name = 'reach'
    config: ReachConfig
    driver: ReachDriver
    size_m = 25.6
    obstacles = True

    def make_driver(self) -> ReachDriver:
        """Return the driver of the rover as its file describes it."""
        return ReachDriver(self.config, self.rover)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Goal, attitude, last action and elevations."""
        return (Channel('goal_distance', 'm', 3.0), Channel('goal_bearing_sin', '', 1.0),
                Channel('goal_bearing_cos', '', 1.0),
                *(Channel(f'up_{axis}', '', 0.3) for axis in 'xy'),
                Channel('last_forward', '', 1.0), Channel('last_yaw_rate', '', 1.0),
                *(Channel(f'elevation/{x:g}/{y:g}', 'm', 0.1) for x in AHEAD_M for y in ASIDE_M))

    def begin(self, rng: np.random.Generator) -> None:
        """Draw the goal."""
        distance, angle = even(rng, self.config.goal_m), rng.uniform(-math.pi, math.pi)
        start = self._simulation.state.position_m[:2]
        self.goal_m = start + distance * np.array([math.cos(angle), math.sin(angle)])
        self._energy_j = self._time_s = 0.0
        self._distance_m = distance
        if self.config.elevation == SEEN:
            self._seen = SeenDepth(self._simulation.world, self.rover, CameraConfig(),
                                   self.config.sun, int(rng.integers(2**31)))
            self._map = ElevationMap(MapConfig().by_pose(TRUTH))
            self._mapped: Elevation | None = None

    def watch(self, state: RoverState, interval_s: float) -> None:
        """Sum up energy."""
        self._energy_j += self.power_w(state) * interval_s
        self._time_s += interval_s

    def reward(self) -> float:
        """Return the reward of the decision that is over."""
        c, distance = self.config, self._now_m()
        total = (c.progress_weight * (self._distance_m - distance)
                 - c.energy_weight * self._energy_j / self.weight_n
                 - c.time_weight * self._time_s
                 + (c.reached_reward if distance < c.reached_m else 0.0))
        self._distance_m, self._energy_j, self._time_s = distance, 0.0, 0.0
        return total

    def ending(self) -> Ending | None:
        """Return whether the goal is reached."""
        return REACHED if self._now_m() < self.config.reached_m else None

    def observation(self) -> np.ndarray:
        """Return what a policy sees now, scaled."""
        x, y, z = self.state.position_m.tolist()
        yaw = float(rpy_from_wxyz(self.state.orientation_wxyz)[2])
        to_goal = self.goal_m - (x, y)
        bearing = math.atan2(to_goal[1], to_goal[0]) - yaw
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, aside = np.meshgrid(AHEAD_M, ASIDE_M, indexing='ij')
        places = np.stack([x + c * ahead - s * aside, y + s * ahead + c * aside], -1)
        return scaled([math.hypot(*to_goal), math.sin(bearing), math.cos(bearing),
                       *self.driver.upright.up[:2], *self.driver.action,
                       *(self._elevation(places.reshape(-1, 2)) - z)], self.channels)

    def _now_m(self) -> float:
        return math.hypot(*(self.goal_m - self.state.position_m[:2]))

    def _elevation(self, places: Array) -> Array:
        """Return the heights at (n, 2) places; that of the rover where they are not known."""
        if self.config.elevation == SEEN:
            return self._seen_elevation(places)
        world = self._simulation.world
        height = np.nan_to_num(world.ground.height_at(places), nan=self.state.position_m[2])
        rocks = world.rocks
        away = np.linalg.norm(rocks.position_m[:, :2] - self.state.position_m[:2], axis=1)
        for k in np.flatnonzero(away < 2.5):
            radius = 0.5 * float(rocks.diameter_m[k])
            apart = np.sum((places - rocks.position_m[k, :2]) ** 2, axis=1)
            top = rocks.position_m[k, 2] + np.sqrt(np.maximum(radius ** 2 - apart, 0.0))
            height = np.where(apart < radius ** 2, np.maximum(height, top), height)
        return height

    def _seen_elevation(self, places: Array) -> Array:
        """Look; return heights of the map of the decision before, as a graph would have it."""
        state, seen, before = self.state, self._seen, self._mapped
        T, config = state.T_world_base, self._map.config
        self._map.add_depth(state.stamp_ns, seen.look(T, config.max_range_m), seen.K,
                            seen.real_baseline_m, T @ seen.T_base_camera, state.position_m)
        self._mapped = self._map.elevation()
        if before is None:
            return np.full(len(places), state.position_m[2])
        column, row = np.floor((places - before.origin_m) / before.cell_m).astype(int).T
        n = len(before.height_m)
        inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
        height = np.where(inside, before.height_m[np.clip(row, 0, n - 1),
                                                  np.clip(column, 0, n - 1)], np.nan)
        return np.nan_to_num(height, nan=state.position_m[2])
