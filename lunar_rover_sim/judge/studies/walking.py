"""Walking on a simulation without ROS: what walks where, and the one loop that walks it."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.frames import rpy_from_wxyz, tilt_deg, wxyz_from_rpy
from lunar_rover_sim.ground.regolith.config import REGOLITH, RIGID
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.rover.gait.controller import GaitController, LegCommand
from lunar_rover_sim.rover.physics.foot_motion import SlipMeter
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.run.scenario import Scenario

STATE_PERIOD_S = 0.005   # period of the controller
WALKED, DUG_IN = 'walked', 'dug in'     # outcomes that several studies have


def with_physics(scenario: Scenario, **changes: Any) -> Scenario:
    """Return a scenario with other parameters of its `physics_node`."""
    return dataclasses.replace(scenario, physics_node=dataclasses.replace(
        scenario.physics_node, **changes))


def on_ground(scenario: Scenario, name: str) -> Scenario:
    """Return a scenario on `rigid` ground or a preset of soil, whose other parameters stay.

    Raises:
        ConfigError: For a preset that does not exist.
    """
    ground = scenario.physics_node.ground
    return with_physics(scenario, ground=(
        dataclasses.replace(ground, model=RIGID) if name == RIGID else
        dataclasses.replace(ground, model=REGOLITH, preset=name)))


@dataclasses.dataclass(frozen=True)
class Walk:
    """A recorded walk, one sample per controller period.

    time_s (n,); position_m (n, 3), world frame; rpy_rad (n, 3), yaw unwrapped, positive pitch nose
    down; joint_angle_rad, reference_rad, phase (n, legs); contact_force_n (n, legs, 3), world axes
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    rpy_rad: NDArray[np.float64]
    joint_angle_rad: NDArray[np.float64]
    contact_force_n: NDArray[np.float64]
    reference_rad: NDArray[np.float64]
    phase: NDArray[np.float64]

    def steps(self) -> NDArray[np.float64]:
        """Return (n - 1, 3) ways along and across the mean heading [m] and turns [rad]."""
        step, yaw = np.diff(self.position_m[:, :2], axis=0), self.rpy_rad[:, 2]
        heading = 0.5 * (yaw[1:] + yaw[:-1])
        c, s = np.cos(heading), np.sin(heading)
        return np.column_stack([step[:, 0] * c + step[:, 1] * s, step[:, 1] * c - step[:, 0] * s,
                                np.diff(yaw)])

    def tilt_deg(self) -> NDArray[np.float64]:
        """Return (n,) angles between the z axes of base and world [deg]."""
        return tilt_deg(wxyz_from_rpy(*self.rpy_rad.T).T)

    def mean_velocity(self, from_s: float, to_s: float) -> tuple[float, float]:
        """Return the mean forward speed [m/s] and yaw rate [rad/s] between two times."""
        chosen = np.flatnonzero((self.time_s >= from_s - 1e-9) & (self.time_s <= to_s + 1e-9))
        first, last = chosen[[0, -1]]
        duration, yaw = self.time_s[last] - self.time_s[first], self.rpy_rad[:, 2]
        forward = np.sum(self.steps()[first:last, 0])
        return float(forward / duration), float((yaw[last] - yaw[first]) / duration)


def flat_world(half_extent_m: float = 15.0, cell_m: float = 0.025) -> World:
    """Return perfectly flat, empty ground."""
    n = 2 * math.ceil(half_extent_m / cell_m) + 1
    ground = HeightGrid(np.zeros((n, n), np.float32), cell_m)
    rocks = Rocks(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 3)),
                  np.zeros((0, 4)), np.zeros(0, np.float32), np.array([0.1]))
    return World((ground,), np.ones((n, n), np.float32), rocks, (), Scenario.load('flat').world,
                 'flat')


def sloping_world(slope_deg: float, half_extent_m: float = 5.0) -> World:
    """Return a plane that rises towards +x, without rocks."""
    world = flat_world(half_extent_m, 1.0)
    ground = world.ground
    x = (np.arange(ground.n) - (ground.n - 1) / 2) * ground.cell_m
    heights = np.tile(math.tan(math.radians(slope_deg)) * x, (ground.n, 1)).astype(np.float32)
    return dataclasses.replace(world, levels=(HeightGrid(heights, ground.cell_m),))


def by_gait(controller: GaitController) -> Callable[[RoverState], LegCommand]:
    """Return what answers states by a gait."""
    return lambda state: controller.update(state.stamp_ns, state.joint_angle_rad,
                                           state.joint_velocity_radps)


class Walker:
    """A rover that walks, one period of its controller after the other, and what that costs.

    Args:
        slip_every: Periods after which the feet are looked at; 0 for never.

    Attributes:
        period_s: `STATE_PERIOD_S`, in whole steps of the simulation [s].
        legs: The last answer.
        periods: Number of periods since the start, or since `begin`, as all that follows.
        energy_j: Drawn from the supply.
        feet: Their ways.
    """

    def __init__(self, simulation: Simulation, answer: Callable[[RoverState], LegCommand],
                 slip_every: int = 0) -> None:
        self._simulation, self._answer, self._slip_every = simulation, answer, slip_every
        self._steps = max(1, round(STATE_PERIOD_S / simulation.config.step_s))
        self.period_s = self._steps * simulation.config.step_s
        self.legs: LegCommand
        self.begin()

    def begin(self) -> None:
        """Measure from here on."""
        self.periods, self.energy_j = 0, 0.0
        self.feet = SlipMeter(len(self._simulation.rover.legs.each))

    def step(self) -> RoverState:
        """Answer the state, go on to the next one, and return it."""
        self.legs = self._answer(self._simulation.state)
        self._simulation.command(self.legs.velocity_radps)
        state = self._simulation.advance(self._steps)
        self.periods += 1
        self.energy_j += self.period_s * self._simulation.rover.motor.drawn_w(
            state.motor_torque_nm, state.joint_velocity_radps)
        if self._slip_every and self.periods % self._slip_every == 0:
            self.feet.add(self._simulation.foot_motion, self._slip_every * self.period_s)
        return state

    def has_dug_in(self) -> bool:
        """Return whether its feet are deep in regolith."""
        contact = self._simulation.ground_contact
        return contact is not None and contact.dug_in


def walk(simulation: Simulation, controller: GaitController, duration_s: float,
         command: Callable[[GaitController, int], object]) -> Walk:
    """Walk from the start pose for a time [s] and return what was recorded.

    The controller is updated every `STATE_PERIOD_S`; its command holds until the next update.

    Args:
        command: Called as command(controller, stamp_ns) before each update of the controller.
    """
    walker, state = Walker(simulation, by_gait(controller)), simulation.reset()
    controller.reset()
    rows: list[tuple] = []
    for _ in range(round(duration_s / walker.period_s)):
        command(controller, state.stamp_ns)
        state = walker.step()
        rows.append((state.stamp_ns * 1e-9, state.position_m,
                     rpy_from_wxyz(state.orientation_wxyz), state.joint_angle_rad,
                     state.contact_force_n, walker.legs.angle_rad, walker.legs.phase))
    columns = [np.array(column) for column in zip(*rows)]
    columns[2][:, 2] = np.unwrap(columns[2][:, 2])
    return Walk(*columns)
