"""One drive of the traverse study: the loop of controller and physics, and what it measures."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from lunar_rover_sim.errors import PhysicsError, StudyError
from lunar_rover_sim.frames import Array, path_length
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.path_following.config import DriveConfig
from lunar_rover_sim.path_following.driver import DONE, Driver, STOPPED
from lunar_rover_sim.physics.foot_motion import SlipMeter
from lunar_rover_sim.physics.penetration import TipPenetration
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.studies.traverse_result import (DRIVEN, DUG_IN, is_stranded, PATH_PERIOD_S,
                                                     STRANDED, TIPPED_OVER, Traverse)
from lunar_rover_sim.studies.walking import STATE_PERIOD_S
from lunar_rover_sim.world.grid import HeightGrid

REST_S = 5.0                   # a rover that is tilted past the limit has this time to come back
ON_ITS_SIDE_DEG = 70.0         # if it is tilted less than this after REST_S, it backs up once
BACK_UP_S, BACK_UP_MPS = 6.0, -0.08   # a rover that is stuck backs up, and takes another way
PITCH_MEAN_S = 2.0             # window of the moving mean: steps are shorter, slopes longer
DRIVE_PERIODS = 10             # periods of the controller per update of the driver: 20 Hz
PATH_PERIODS = round(PATH_PERIOD_S / STATE_PERIOD_S)


class TraverseDrive:
    """A drive in progress; `run` it once.

    plan: returns (n, 2) waypoints from a position (2,) on, or raises StudyError
    """

    def __init__(self, simulation: Simulation, controller: GaitController, config: DriveConfig,
                 plan: Callable[[Array], Array], ground: HeightGrid) -> None:
        self._simulation = simulation
        self._controller = controller
        self._config = config
        self._plan = plan
        self._half_extent_m = ground.half_extent_m
        self._steps = max(1, round(STATE_PERIOD_S / simulation.config.step_s))
        self._period_s = self._steps * simulation.config.step_s
        self._back_up_periods = round(BACK_UP_S / self._period_s)
        self._next = 0                    # index of the waypoint ahead
        self._reached = self._stuck = self._tilted = 0
        self._measurement = _Measurement(simulation, ground, self._period_s)
        self._state = simulation.state
        self._waypoints = plan(self._state.position_m[:2])
        self._driver = self._make_driver()

    def run(self, seed: int, duration_s: float) -> Traverse:
        """Drive until the time [s] is over or the rover has tipped over; return the result."""
        outcome, periods = DRIVEN, round(duration_s / self._period_s)
        velocity, back_up = (0.0, 0.0), 0
        tilted_since: int | None = None
        backed_up = False       # from a lasting tilt; a second one counts as tipped over
        try:
            for k in range(periods):
                if back_up > 0:
                    back_up -= 1
                    if back_up == 0:
                        self._go_elsewhere()
                elif tilted_since is not None:
                    if k - tilted_since >= REST_S / self._period_s:
                        if _tilt_deg(self._state) > self._config.tilt_limit_deg:
                            if backed_up or _tilt_deg(self._state) > ON_ITS_SIDE_DEG:
                                outcome = TIPPED_OVER
                                break
                            backed_up = True
                        tilted_since, self._tilted = None, self._tilted + 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                elif k % DRIVE_PERIODS == 0:
                    state = self._state
                    command = self._driver.update(state.stamp_ns, state.position_m,
                                                  state.orientation_wxyz)
                    velocity = (command.forward_mps, command.yaw_rate_radps)
                    if command.status == DONE:
                        self._reached += 1
                        self._go_on()
                    elif command.status == STOPPED and command.reason.startswith('tilted'):
                        tilted_since = k
                    elif command.status == STOPPED:
                        self._stuck += 1
                        back_up, velocity = self._back_up_periods, (BACK_UP_MPS, 0.0)
                    else:
                        backed_up = False
                self._step(velocity)
                if k % PATH_PERIODS == 0:
                    self._measurement.path_m.append(self._state.position_m)
        except PhysicsError as error:
            outcome = str(error)
        return self._measurement.result(
            seed, outcome, self._state.stamp_ns * 1e-9,
            (self._reached, self._stuck, self._tilted))

    def _go_on(self) -> None:
        self._next = min(self._next + 1, len(self._waypoints) - 1)
        self._driver = self._make_driver()

    def _go_elsewhere(self) -> None:
        """Plan a new route from here; go on along the old one if there is none."""
        try:
            self._waypoints = self._plan(self._state.position_m[:2])
        except StudyError:
            self._go_on()
        else:
            self._next = 0
            self._driver = self._make_driver()

    def _make_driver(self) -> Driver:
        x, y = self._waypoints[self._next]
        config = dataclasses.replace(
            self._config, mode='waypoints', shape='none', relative=False, laps=1,
            start_delay_s=0.0, waypoints_x_m=(float(x),), waypoints_y_m=(float(y),))
        return Driver(config, self._half_extent_m)

    def _step(self, velocity: tuple[float, float]) -> None:
        state = self._state
        self._controller.set_velocity(*velocity, state.stamp_ns)
        legs = self._controller.update(state.stamp_ns, state.joint_angle_rad,
                                       state.joint_velocity_radps)
        self._simulation.command(legs.velocity_radps)
        self._state = self._simulation.advance(self._steps)
        self._measurement.add()


class _Measurement:
    """What a drive sums up, period by period."""

    def __init__(self, simulation: Simulation, ground: HeightGrid, period_s: float) -> None:
        self._simulation = simulation
        self._period_s = period_s
        self._tips = TipPenetration(simulation, ground)
        self._feet = SlipMeter()
        self._mechanical_j = self._electric_j = 0.0
        self._tilts_deg: list[float] = []
        self._pitches_deg: list[float] = []
        self._penetration_m = 0.0
        self.path_m: list[Array] = []

    def add(self) -> None:
        """Take in the state of the simulation after a period."""
        # Plain floats: on four numbers they take a third of the time of arrays.
        state, dt = self._simulation.state, self._period_s
        motor = self._simulation.rover.motor
        self._tilts_deg.append(_tilt_deg(state))
        self._pitches_deg.append(_pitch_deg(state))
        for torque, speed in zip(state.motor_torque_nm.tolist(),
                                 state.joint_velocity_radps.tolist()):
            self._mechanical_j += max(torque * speed, 0.0) * dt
            self._electric_j += max(motor.electric_power_w(torque, speed), 0.0) * dt
        self._penetration_m = max(self._penetration_m, self._tips.deepest_m())
        self._feet.add(self._simulation.foot_motion, dt)

    def result(self, seed: int, outcome: str, driven_s: float,
               counts: tuple[int, int, int]) -> Traverse:
        """Return the result; counts: waypoints reached, times stuck, times tilted."""
        path = np.array(self.path_m).reshape(-1, 3)
        distance = path_length(path[:, :2])
        mass = self._simulation.rover.total_mass_kg
        weight = max(mass * self._simulation.config.gravity_mps2, 1e-9)
        tilts = np.array(self._tilts_deg or [0.0])
        if outcome == DRIVEN and is_stranded(path):
            contact = self._simulation.ground_contact
            outcome = DUG_IN if contact is not None and contact.dug_in else STRANDED
        return Traverse(
            seed, outcome, driven_s, distance, *counts,
            self._feet.total,
            self._mechanical_j / (weight * distance) if distance else math.nan,
            self._electric_j / (weight * distance) if distance else math.nan,
            float(tilts.mean()), float(np.percentile(tilts, 95.0)), float(tilts.max()),
            self._pitch_rms_deg(), self._penetration_m, path)

    def _pitch_rms_deg(self) -> float:
        """Return the RMS of the pitch about its moving mean [deg]."""
        pitch = np.array(self._pitches_deg or [0.0])
        return float(np.std(pitch - uniform_filter1d(pitch, round(PITCH_MEAN_S / self._period_s))))


def _pitch_deg(state: RoverState) -> float:
    """Return the angle by which base x points down [deg]."""
    w, x, y, z = state.orientation_wxyz.tolist()
    return math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z)))))


def _tilt_deg(state: RoverState) -> float:
    """Return the angle between base z and the vertical [deg]."""
    _, x, y, _ = state.orientation_wxyz.tolist()
    return math.degrees(math.acos(max(-1.0, 1.0 - 2.0 * (x * x + y * y))))
