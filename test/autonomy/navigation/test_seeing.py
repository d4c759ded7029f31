"""What a rover does that sees a plain with walls, by rays of our own: depth, map, navigator."""

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.command import Failure, Status
from lunar_rover_sim.autonomy.navigation.config import (MapConfig, NavigatorConfig,
                                                        TraversabilityConfig)
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.autonomy.navigation.navigator import Navigator
from lunar_rover_sim.autonomy.navigation.traversability import (LETHAL, Limits, traversability,
                                                                UNKNOWN)
from lunar_rover_sim.base.frames import matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.camera.sensor import ImageSensor, SensorModel
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.image.stereo.sgm import SgmMatcher
from lunar_rover_sim.rover.description import load_rover

W, H, F = 96, 72, 69.0
K = np.array([[F, 0.0, 47.5], [0.0, F, 35.5], [0.0, 0.0, 1.0]])
LIMITS = Limits.of(load_rover(None), TraversabilityConfig())
EYE_M, AHEAD_M, PITCH_RAD = 0.28, 0.12, np.radians(10.0)
TICK_S, LOOK_TICKS = 0.1, 5


class Plain:
    """Level ground with boxes (x0, x1, y0, y1, height), and shadows (x0, x1, y0, y1)."""

    def __init__(self, *boxes, shadows=()):
        self.boxes, self.shadows = boxes, shadows

    def depth(self, T):
        """Return the depth (h, w) that a camera at T (4, 4) sees; NaN where nothing is lit."""
        v, u = np.mgrid[0:H, 0:W]
        rays = np.stack([(u - K[0, 2]) / F, (v - K[1, 2]) / F, np.ones(u.shape)], -1) @ T[:3, :3].T
        with np.errstate(divide='ignore', invalid='ignore'):
            depth = np.where(rays[..., 2] < 0.0, -T[2, 3] / rays[..., 2], np.inf)
            for x0, x1, y0, y1, height in self.boxes:
                low, high = np.array([x0, y0, 0.0]), np.array([x1, y1, height])
                near, far = ((corner - T[:3, 3]) / rays for corner in (low, high))
                enter = np.minimum(near, far).max(axis=-1)
                leave = np.maximum(near, far).min(axis=-1)
                depth = np.where((enter < leave) & (enter > 0.0), np.minimum(depth, enter), depth)
        at = T[:3, 3] + np.where(np.isfinite(depth), depth, 0.0)[..., None] * rays
        for x0, x1, y0, y1 in self.shadows:
            inside = (at[..., 0] > x0) & (at[..., 0] < x1) & (at[..., 1] > y0) & (at[..., 1] < y1)
            depth[inside & (at[..., 2] < 0.01)] = np.nan
        return depth.astype(np.float32)


class Rover:
    """A point that does what the navigator says; `covered_s`: when its lens is covered."""

    def __init__(self, plain, goal, covered_s=np.inf, **config):
        self.plain, self.covered_s = plain, covered_s
        self.map = ElevationMap(MapConfig(size_m=12.8).by_pose('truth'))
        self.navigator = Navigator(NavigatorConfig(
            has_goal=True, goal_x_m=goal[0], goal_y_m=goal[1], start_delay_s=0.0, **config),
            LIMITS.radius_m)
        self.x = self.y = self.yaw = 0.0
        self.grid, self.path, self.commands = None, [], []

    @property
    def at(self):
        return np.array([self.x, self.y])

    def tick(self):
        k = len(self.commands)
        now = round(k * TICK_S * 1e9)
        if k % LOOK_TICKS == 0:
            R = matrix_from_wxyz(wxyz_from_rpy(0.0, PITCH_RAD, self.yaw)) @ R_BODY_OPTICAL
            ahead = AHEAD_M * np.array([np.cos(self.yaw), np.sin(self.yaw)])
            T = se3(R, (*(self.at + ahead), EYE_M))
            seen = self.plain.depth(T) if k * TICK_S < self.covered_s \
                else np.full((H, W), np.nan, np.float32)
            self.map.add_depth(now, seen, K, 0.1, T, (*self.at, 0.1))
            if self.map.has_seen:
                self.grid = traversability(self.map.elevation(), LIMITS, 2, self.at)
        command = self.navigator.update(now, now, (*self.at, 0.1),
                                        wxyz_from_rpy(0.0, 0.0, self.yaw), self.grid)
        self.yaw += TICK_S * command.yaw_rate_radps
        self.x += TICK_S * command.forward_mps * np.cos(self.yaw)
        self.y += TICK_S * command.forward_mps * np.sin(self.yaw)
        self.path.append(self.at)
        self.commands.append(command)
        return command

    def drive(self, seconds):
        while len(self.commands) < seconds / TICK_S and not self.tick().status.is_end:
            pass
        return self.commands[-1]


def test_a_covered_lens_stops_it_at_once_and_for_good():
    """It turns back to where it saw something and all around, on the spot, and gives up."""
    rover = Rover(Plain(), (6.0, 0.0), covered_s=8.0)
    end = rover.drive(120.0)
    assert end.failure is Failure.LOST and 'no depth' in end.reason
    path = np.array(rover.path)
    assert path[79, 0] > 0.5                # it drove before
    # map_age_s after the last frame, at 0.12 m/s.
    assert np.linalg.norm(path[-1] - path[79]) < 0.12 * (1.5 + 0.4)
    turn_s = 2.0 * np.pi / 0.15
    assert len(path) * TICK_S < 8.0 + 1.5 + 10.0 + 1.5 * turn_s + 2.5


@pytest.mark.parametrize('exposure_s', [1e-6, 0.5])
def test_the_noise_of_covered_lenses_is_no_depth(exposure_s):
    """No light, but read noise, dark current and patterns: pairs do not renew a map."""
    camera = CameraConfig(width=320, height=240)
    rig = StereoRig(load_rover(None), camera)
    chip = ImageSensor(rig, SensorModel(camera, SensorConfig()), 3)
    matcher, seen = SgmMatcher(SgmConfig(), rig), ElevationMap(MapConfig().by_pose('truth'))
    R = matrix_from_wxyz(wxyz_from_rpy(0.0, PITCH_RAD, 0.0)) @ R_BODY_OPTICAL
    for k in range(4):
        left, right = (chip.pixels(np.zeros((240, 320), np.float32), side, exposure_s, k)
                       for side in (0, 1))
        assert left.std() > 0.0 and (left != right).any()
        seen.add_depth(k * 10**8, matcher.match(left, right).depth_m, rig.K, rig.baseline_m,
                       se3(R, (AHEAD_M, 0.0, EYE_M)), (0.0, 0.0, 0.1))
    assert not seen.has_seen


def test_at_night_it_does_not_set_out():
    rover = Rover(Plain(), (6.0, 0.0), covered_s=0.0)
    assert rover.drive(80.0).failure is Failure.LOST
    assert rover.path[-1] == pytest.approx((0.0, 0.0), abs=1e-9)
    # It has looked around, on the spot: where all before it is dark, light may be behind it.
    assert sum(command.yaw_rate_radps for command in rover.commands) * TICK_S > 6.0
    dark_ahead = Rover(Plain(shadows=[(0.4, 9.0, -9.0, 9.0)]), (-2.0, 0.0))
    assert dark_ahead.drive(120.0).status is Status.ARRIVED


def test_it_sets_out_from_ground_that_its_cameras_do_not_see_and_arrives_behind_itself():
    rover = Rover(Plain(), (-1.5, 0.5))
    assert rover.drive(120.0).status is Status.ARRIVED


def test_a_goal_behind_a_wall_is_found_beyond_the_map():
    """The wall leaves the map of 12.8 m on one side, and ends on the other."""
    rover = Rover(Plain((2.0, 2.3, -1.2, 9.0, 0.4)), (7.5, 1.0))
    assert rover.drive(300.0).status is Status.ARRIVED
    path = np.array(rover.path)
    apart = np.hypot(np.maximum(np.maximum(2.0 - path[:, 0], path[:, 0] - 2.3), 0.0),
                     np.maximum(-1.2 - path[:, 1], 0.0))
    assert apart.min() > LIMITS.radius_m - 0.05


def test_a_shadow_is_driven_around_and_one_without_an_end_not_entered():
    around = Rover(Plain(shadows=[(1.5, 2.5, -0.8, 0.8)]), (4.0, 0.0))
    assert around.drive(200.0).status is Status.ARRIVED
    path = np.array(around.path)
    inside = (path[:, 0] > 1.55) & (path[:, 0] < 2.45) & (np.abs(path[:, 1]) < 0.75)
    assert not inside.any()
    endless = Rover(Plain(shadows=[(1.5, 2.8, -20.0, 20.0)]), (4.0, 0.0), patience_s=60.0)
    assert endless.drive(200.0).failure is Failure.BLOCKED
    assert np.array(endless.path)[:, 0].max() < 1.5


def test_the_hidden_side_of_a_rock_is_as_steep_and_a_goal_on_it_is_on_an_obstacle():
    rover = Rover(Plain((2.0, 2.9, -0.4, 0.4, 0.5)), (2.4, 0.0))
    rover.tick()
    for _ in range(2 * LOOK_TICKS):
        rover.tick()
    grid = rover.grid
    column, row = np.floor((np.array([2.4, 0.0]) - grid.origin_m) / grid.cell_m).astype(int)
    assert grid.cost[row, column] == LETHAL
    hidden = traversability(rover.map.elevation(), LIMITS).cost[row, column]
    assert hidden == UNKNOWN                # of the map alone
    end = rover.drive(150.0)
    assert end.failure is Failure.BLOCKED and 'on an obstacle' in end.reason
    # It may look at the rock from the side, but keeps off it.
    path = np.array(rover.path)
    off = np.maximum(np.abs(path - [2.45, 0.0]) - [0.45, 0.4], 0.0)
    assert np.hypot(*off.T).min() > LIMITS.radius_m - 0.05


def test_its_tilt_is_that_of_the_imu_not_of_a_pose_that_jumps():
    """An estimate says 35 degrees for a second, and 5 degrees while it lies on its side."""
    def told(pose_deg, imu_deg):
        rover = Rover(Plain(), (6.0, 0.0))
        rover.drive(3.0)
        found = []
        for k in range(10):
            now = round((3.0 + 0.1 * k) * 1e9)
            found.append(rover.navigator.update(
                now, now, (*rover.at, 0.1), wxyz_from_rpy(0.0, np.radians(pose_deg), rover.yaw),
                rover.grid, imu_deg))
        return found

    assert all(command.status is not Status.BACKING for command in told(35.0, 5.0))
    assert told(5.0, 80.0)[-1].failure is Failure.TILT


def test_it_backs_off_only_over_ground_that_is_clear():
    """Held by a rock that nobody sees, and let go; once with a wall 0.5 m behind its start."""
    def rearmost(*boxes):
        rover = Rover(Plain(*boxes), (6.0, 0.0), stuck_time_s=2.0, back_off_m=2.0)
        for _ in range(20):             # it sees what is there, and turns its back to it
            rover.x, rover.yaw = 0.3, np.pi
            rover.tick()
        rover.x = rover.y = rover.yaw = 0.0
        rover.drive(4.0)
        place = rover.at
        while rover.tick().status is not Status.BACKING:
            rover.x, rover.y = place
        while rover.tick().status is Status.BACKING:
            pass
        return rover.x

    assert -2.0 < rearmost() < -0.5     # all of it is clear
    assert -0.5 + LIMITS.radius_m - 0.05 < rearmost((-0.8, -0.5, -2.0, 2.0, 0.4)) < 0.1
