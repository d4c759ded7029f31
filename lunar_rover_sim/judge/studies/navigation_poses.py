"""Poses by which a rover of the navigation study maps and drives: the truth and estimates."""

from __future__ import annotations

from collections import deque
from contextlib import ExitStack
import math
import sys

import numpy as np

from lunar_rover_sim.autonomy.navigation.config import SLAM, TRUTH, WHEELS
from lunar_rover_sim.autonomy.navigation.poses import AnchoredPoses, LevelledWheels
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import SlamError
from lunar_rover_sim.base.frames import Array, matrix_from_wxyz, se3, tilt_deg
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.camera.encoding import eight_bits
from lunar_rover_sim.image.stereo.points import grey
from lunar_rover_sim.judge.slam.program import Tracker
from lunar_rover_sim.judge.slam.protocol import FrameSet, TRACKING
from lunar_rover_sim.judge.studies.walking import STATE_PERIOD_S
from lunar_rover_sim.products.sequences.sensors import described_sensors
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.sensors.imu import ImuNoise
from lunar_rover_sim.sensors.wheel_odometry import Rolling, WheelOdometry

REFERENCE = 'reference'                             # the built-in odometry
DRIFT = 'drift='
_REFERENCE_COMMAND = f'{sys.executable} -m lunar_rover_sim.judge.slam.client'


class Poses(Closing):
    """The truth; others derive from it. Used as a context manager.

    Attributes:
        error_m: Distance of the last estimated position from the true one then.
        tilt_deg: By the IMU; of truth and drift the true one.
    """

    def __init__(self, state: RoverState) -> None:
        self.error_m, self.tilt_deg = 0.0, float(tilt_deg(state.orientation_wxyz))
        self._newest: tuple[int, Array] | None = state.stamp_ns, state.T_world_base

    def close(self) -> None:
        """Release what it holds."""

    def add(self, state: RoverState) -> None:
        """Take in the next state."""
        self._take(state, state.T_world_base)

    def present(self, state: RoverState) -> Array | None:
        """Return the pose (4, 4) for what is seen at the newest state; None: there is none."""
        if self._newest is None or self._newest[0] != state.stamp_ns:
            return None
        return self._newest[1]

    def newest(self, now_ns: int) -> tuple[int, Array] | None:
        """Return stamp [ns] and (4, 4) of the newest pose that a command may use; None: none."""
        return self._newest

    def _take(self, state: RoverState, T_world_base: Array) -> None:
        self._newest = state.stamp_ns, T_world_base
        self.tilt_deg = float(tilt_deg(T_world_base[:3, :3]))
        self.error_m = float(np.linalg.norm(T_world_base[:2, 3] - state.position_m[:2]))


class Drifting(Poses):
    """The truth with a position that walks off by a share of the way.

    The share is one standard deviation after a metre; the heading walks off with it, by a radian
    per metre of error.
    """

    def __init__(self, state: RoverState, share: float, seed: int) -> None:
        super().__init__(state)
        self._share = share
        self._rng = np.random.default_rng([seed, 47])
        self._off, self._before = np.eye(4), state.T_world_base

    def add(self, state: RoverState) -> None:
        """Take in the next state."""
        T = state.T_world_base
        way = math.sqrt(float(np.linalg.norm(T[:3, 3] - self._before[:3, 3])))
        yaw = self._share * way * self._rng.standard_normal()
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.eye(4)
        turn[:2, :2] = [[c, -s], [s, c]]
        turn[:2, 3] = self._share * way * self._rng.standard_normal(2)
        about, back = np.eye(4), np.eye(4)      # the present place
        about[:3, 3], back[:3, 3] = T[:3, 3], -T[:3, 3]
        self._off = self._off @ about @ turn @ back
        self._before = T
        self._take(state, self._off @ T)


class Wheels(Poses):
    """Wheel odometry, with the angles of the IMU."""

    def __init__(self, state: RoverState, scenario: Scenario, seed: int) -> None:
        super().__init__(state)
        physics = scenario.physics_node
        self._start = state.T_world_base
        self._wheels = WheelOdometry(scenario.rover, physics.wheel_odometry.counts_per_turn,
                                     Rolling.of(physics.wheel_odometry, physics.ground.name,
                                                scenario.rover.name))
        self._levelled = LevelledWheels()
        self._imu = ImuNoise(physics.imu, 1.0 / STATE_PERIOD_S, np.random.default_rng([seed, 47]))

    def add(self, state: RoverState) -> None:
        """Take in the next state."""
        sample = self._imu.measure(state.specific_force_mps2, state.imu_rate_radps)
        self._levelled.add_imu(state.stamp_ns, sample.rate, sample.specific_force)
        self._wheels.add(state.joint_angle_rad, STATE_PERIOD_S)
        self._take(state, self._levelled.base(self._wheels.pose, self._start))


class Slam(Poses):
    """A SLAM program over pipes, as behind slam_node, that gets rendered pairs.

    Its poses begin at the true start; wheels say where another map of its begins. In lockstep a
    command is made from the pose of `navigator_node.map_lag_s` before. A program that ends while
    the rover drives gives no more poses.

    Attributes:
        problem: Why the program gives no more poses; empty while it does.
    """

    def __init__(self, scenario: Scenario, world: World, simulation: Simulation,
                 command: str, seed: int) -> None:
        super().__init__(simulation.state)
        self.problem = ''
        self._wheels = Wheels(simulation.state, scenario, seed)
        self._lag_ns = round(scenario.navigator_node.map_lag_s * 1e9)
        self._frame_ns = scenario.render_node.frame_period_ns
        self._newest = None
        self._ready: deque[tuple[int, Array]] = deque()
        with ExitStack() as owned:
            self._renderer = owned.enter_context(scenario.renderer(world))
            self._renderer.follow(simulation.overlay)
            self._anchored = AnchoredPoses(self._renderer.rig.T_base_left)
            physics, node = scenario.physics_node, scenario.slam_node
            suite = described_sensors(
                scenario.rover, scenario.render_node.camera, physics.imu,
                scenario.render_node.frame_rate_hz, physics.state_rate_hz, physics.gravity_mps2)
            self._tracker = owned.enter_context(
                Tracker(command, suite, 'stereo', node.ready_s, node.answer_s))
            self._owned = owned.pop_all()

    def close(self) -> None:
        """End the program and the renderer."""
        self._owned.close()

    def add(self, state: RoverState) -> None:
        """Take in the next state; where a frame is due, have it tracked."""
        self._wheels.add(state)
        self.tilt_deg = self._wheels.tilt_deg
        if self.problem or state.stamp_ns % self._frame_ns:
            return
        frame = self._renderer.render(state, state.stamp_ns // self._frame_ns, ('left', 'right'))
        try:
            pose = self._tracker.track(FrameSet(state.stamp_ns, tuple(
                eight_bits(grey(image)) for image in (frame.left, frame.right)
                if image is not None)))
        except SlamError as error:
            self.problem = str(error)
            return
        if pose.state != TRACKING:
            self._anchored.lose()
            return
        rolled = self._wheels.present(state)
        assert rolled is not None
        T = self._anchored.base(se3(matrix_from_wxyz(pose.wxyz), pose.position_m), rolled,
                                state.T_world_base)
        self._take(state, T)
        self.tilt_deg = self._wheels.tilt_deg
        self._ready.append((state.stamp_ns, T))

    def newest(self, now_ns: int) -> tuple[int, Array] | None:
        """Return stamp [ns] and (4, 4) of the newest pose that a command may use; None: none."""
        while len(self._ready) > 1 and self._ready[1][0] <= now_ns - self._lag_ns:
            self._ready.popleft()
        if self._ready and self._ready[0][0] <= now_ns - self._lag_ns:
            return self._ready[0]
        return None


def poses_of(kind: str, scenario: Scenario, world: World, simulation: Simulation,
             seed: int) -> Poses:
    """Return a source of poses.

    Args:
        kind: truth; wheels; drift=SHARE; reference, the built-in odometry; or slam, the program of
            `slam_node.command`.
        seed: Of the noise.

    Raises:
        SlamError: If the program cannot be used.
    """
    state = simulation.state
    if kind == WHEELS:
        return Wheels(state, scenario, seed)
    if kind.startswith(DRIFT):
        return Drifting(state, float(kind.removeprefix(DRIFT)), seed)
    if kind in (REFERENCE, SLAM):
        command = _REFERENCE_COMMAND if kind == REFERENCE else scenario.slam_node.command
        return Slam(scenario, world, simulation, command, seed)
    assert kind == TRUTH
    return Poses(state)
