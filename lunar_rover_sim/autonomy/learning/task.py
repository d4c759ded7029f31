"""The part that tasks share: an episode of one rover on its ground, from conditions to outcome.

A task file (`walk.py`, `gait_task.py`, `reach.py`) says what is seen, what an action means, what
is rewarded and when an episode ends. This one builds the episode, steps it, and watches it. None
of them needs gymnasium.
"""

from __future__ import annotations

import abc
import collections
from collections.abc import Sequence
import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lunar_rover_sim.autonomy.learning.randomisation import (Conditions, even, GROUNDS, physics_of,
                                                             Randomisation, terrain)
from lunar_rover_sim.autonomy.learning.senses import Channel, of_legs, Sample, scaled
from lunar_rover_sim.base.errors import (brief, ConfigError, GroundLeftError, LearningError,
                                         PhysicsError)
from lunar_rover_sim.base.frames import Array, tilt_deg
from lunar_rover_sim.base.parameters import group, param, Parameters
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.rover.description import DEFAULT_ROVER, load_rover
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.sensors.imu import ImuConfig, ImuNoise

STATE_HZ = 200          # of the messages of physics_node
FALLEN_DEG = 60.0       # tilt at which an episode ends
PUSH_S = 0.2
_PLACES = 8             # most draws of conditions until the rover stands


@dataclasses.dataclass(frozen=True)
class TaskConfig(Parameters):
    """Parameters that all tasks have; a task adds its own."""

    ground: str = param('highland', 'rigid, or a soil', choices=GROUNDS)
    rover: str = param(DEFAULT_ROVER, 'a packaged rover, quad or hexapod, or a rover file')
    episode_s: float = param(20.0, 'length of an episode', unit='s', low=0.1, high=3600.0)
    imu_noise: bool = param(True, 'whether the IMU has the noise of `physics_node.imu`')
    privileged: bool = param(False, 'whether observations are a mapping of `policy` and'
                             ' `privileged`; info has the privileged ones in any case')
    failure_cost: float = param(1.0, 'cost of an episode that ends by a fall, by digging in or by'
                                ' a divergence', low=0.0)
    randomise: Randomisation = group(Randomisation)


class Ending(NamedTuple):
    """Why an episode ended before its time was over.

    Attributes:
        kind: By which endings are counted.
        words: What happened.
        failed: Whether it is a failure.
    """

    kind: str
    words: str
    failed: bool = True


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a step gives.

    Attributes:
        observation: Scaled, of the task's channels.
        reward: Of the step.
        ending: Why the episode ended; None where it did not, or where its time is over.
        truncated: Whether its time is over.
    """

    observation: np.ndarray
    reward: float
    ending: Ending | None
    truncated: bool

    @property
    def terminated(self) -> bool:
        """Whether the episode ended before its time was over."""
        return self.ending is not None


class Driver(abc.ABC):
    """From samples and actions to leg speeds: the part of a task that runs on the rover, too.

    Attributes:
        channels: Of the observation.
        actions: Of the action; each number is within -1 and 1.
        decision_ns: Period of decisions.
        follow_ns: Period at which leg speeds are computed anew.
    """

    channels: tuple[Channel, ...]
    actions: tuple[Channel, ...]
    decision_ns: int
    follow_ns: int

    @abc.abstractmethod
    def reset(self) -> None:
        """Forget everything but the command."""

    @abc.abstractmethod
    def set_velocity(self, forward_mps: float, yaw_rate_radps: float) -> None:
        """Set the velocity that is asked for, forward [m/s] and yaw rate [rad/s]."""

    @abc.abstractmethod
    def feel(self, sample: Sample) -> None:
        """Take in a sample; call it at each stamp that is a multiple of `follow_ns`."""

    @abc.abstractmethod
    def observation(self) -> np.ndarray:
        """Return what a policy sees now, scaled."""

    @abc.abstractmethod
    def decide(self, action: Array) -> None:
        """Take an action, (n,) within -1 and 1, that holds until the next."""

    @abc.abstractmethod
    def legs(self) -> tuple[Array, Array]:
        """Return (legs,) leg speeds [rad/s] and reference angles [rad] after a `feel`."""


class RoverTask(abc.ABC):
    """Episodes of one rover, one after the other."""

    name: str
    config: TaskConfig
    privileged_channels: tuple[Channel, ...]
    size_m: float = 12.8        # of the ground
    obstacles: bool = False     # craters and rocks

    def __init__(self, config: TaskConfig) -> None:
        self.config = config
        self.rover = load_rover(config.rover)
        self.driver = self.make_driver()
        self.simulation: Simulation | None = None
        self.counts: collections.Counter[str] = collections.Counter()
        legs = self.rover.legs.names
        self.privileged_channels = (
            Channel('forward_velocity', 'm/s', 0.2), Channel('lateral_velocity', 'm/s', 0.2),
            Channel('yaw_rate', 'rad/s', 0.5), Channel('slope', 'deg', 10.0),
            Channel('friction_factor', '', 1.0), Channel('bearing_factor', '', 1.0),
            Channel('mass_factor', '', 1.0), Channel('delay', 'decisions', 3.0),
            *of_legs('sinkage', 'm', 0.01, legs), *of_legs('slip', 'm/s', 0.1, legs),
            *of_legs('load', 'N', 2.0, legs))

    # What a task says.

    @abc.abstractmethod
    def make_driver(self) -> Driver:
        """Return what turns actions into leg speeds."""

    @abc.abstractmethod
    def begin(self, rng: np.random.Generator) -> None:
        """Set the command, and forget the episode before."""

    @abc.abstractmethod
    def watch(self, state: RoverState, interval_s: float) -> None:
        """Take in the state at the end of an interval [s]."""

    @abc.abstractmethod
    def reward(self) -> float:
        """Return the reward of the decision that is over."""

    @property
    def commanded(self) -> tuple[float, float]:
        """The velocity that is asked for: forward [m/s] and yaw rate [rad/s]."""
        return 0.0, 0.0

    def ending(self) -> Ending | None:
        """Return why the episode ends now, beside a fall."""
        return None

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the observation."""
        return self.driver.channels

    @property
    def actions(self) -> tuple[Channel, ...]:
        """Channels of the action."""
        return self.driver.actions

    def observation(self) -> np.ndarray:
        """Return what a policy sees now, scaled."""
        return self.driver.observation()

    def decide(self, action: Array) -> None:
        """Take an action."""
        self.driver.decide(action)

    # What all have.

    def reset(self, rng: np.random.Generator) -> np.ndarray:
        """Begin an episode with conditions drawn from `rng`; return the first observation.

        Raises:
            LearningError: The rover stands nowhere on ground like this.
        """
        self.close()
        self._rng = rng
        for _ in range(_PLACES):
            self.conditions = self.config.randomise.draw(rng)
            try:
                self._build(self.conditions)
                break
            except (ConfigError, PhysicsError) as error:
                refusal = str(error)
        else:
            raise LearningError(f'reset: the rover stands nowhere on ground {self.config.ground}: '
                                f'{refusal}')
        self._noise = ImuNoise(ImuConfig(enabled=self.config.imu_noise), STATE_HZ, rng)
        self._delayed: collections.deque[Array] = collections.deque(
            [np.zeros(len(self.actions))] * self.conditions.delay)
        self._next_push_s, self._push_until_s = self._rest(), math.inf
        self.driver.reset()
        self.begin(rng)
        state = self._simulation.state
        self.state = state
        self.driver.feel(Sample.of(state, self._noise))
        return self.observation()

    def step(self, action: ArrayLike) -> Outcome:
        """Make one decision.

        Raises:
            LearningError: The action has another shape or is not finite, or there is no episode.
        """
        values = checked_action(action, self.actions)
        simulation = self._simulation
        self._delayed.append(values)
        self.decide(self._delayed.popleft())
        self._push()
        step_ns = simulation.config.step_ns
        state_steps = 1_000_000_000 // STATE_HZ // step_ns
        steps = self.driver.follow_ns // step_ns
        try:
            for _ in range(self.driver.decision_ns // self.driver.follow_ns):
                simulation.command(self.driver.legs()[0])
                if steps > state_steps:
                    # The IMU of the node measures over the last period of states alone.
                    self._see(simulation.advance(steps - state_steps),
                              (steps - state_steps) * step_ns * 1e-9)
                self._see(simulation.advance(state_steps), state_steps * step_ns * 1e-9)
                self.driver.feel(Sample.of(self.state, self._noise))
            ending = self._fallen() or self.ending()
        except GroundLeftError as error:
            ending = Ending('left', str(error))
        except PhysicsError as error:
            ending = Ending('diverged', str(error))
        over = self.state.stamp_ns * 1e-9 >= self.config.episode_s - 1e-9
        # The reward may draw the next command, which the observation shows.
        reward = self.reward()
        if ending is not None:
            self.counts[ending.kind] += 1
            reward -= self.config.failure_cost if ending.failed else 0.0
        return Outcome(self.observation(), reward, ending, over and ending is None)

    def privileged(self) -> np.ndarray:
        """Return what no rover measures, scaled: soil, slip, sinkage, true motion."""
        c, state, legs = self.conditions, self.state, len(self.rover.legs.each)
        contact = self._simulation.ground_contact
        load = np.sqrt(np.sum(np.square(state.contact_force_n), axis=1))
        return scaled([*state.linear_velocity_mps[:2], state.angular_velocity_radps[2],
                       c.slope_deg, c.friction_factor, c.bearing_factor, c.mass_factor, c.delay,
                       *(np.zeros(legs) if contact is None else contact.sinkage_m),
                       *(np.zeros(legs) if contact is None else contact.slip_mps), *load],
                      self.privileged_channels)

    def power_w(self, state: RoverState) -> float:
        """Return the electric power of all motors, none of which feeds back [W]."""
        return self._motor.drawn_w(state.motor_torque_nm, state.joint_velocity_radps)

    def close(self) -> None:
        """Release the simulation."""
        if self.simulation is not None:
            self.simulation.close()
            self.simulation = None

    @property
    def world(self) -> World | None:
        """The ground of the episode, on which the rover is now."""
        return None if self.simulation is None else self.simulation.world

    @property
    def _simulation(self) -> Simulation:
        if self.simulation is None:
            raise LearningError('step: there is no episode; call reset first')
        return self.simulation

    def _see(self, state: RoverState, interval_s: float) -> None:
        self.state = state
        self.watch(state, interval_s)

    def _fallen(self) -> Ending | None:
        tilt = float(tilt_deg(self.state.orientation_wxyz))
        contact = self._simulation.ground_contact
        if tilt > FALLEN_DEG:
            return Ending('fallen', f'fallen: tilted by {tilt:.0f} deg')
        if contact is not None and contact.dug_in:
            return Ending('dug in', 'dug in: two legs are in the ground')
        return None

    def _build(self, conditions: Conditions) -> None:
        config = self.config
        world = terrain(conditions.terrain_seed, self.size_m, self.obstacles,
                        conditions.slope_deg, conditions.slope_azimuth_deg)
        rover = conditions.rover(self.rover)
        self.simulation = Simulation(world, rover, physics_of(config.ground, conditions))
        self._motor, self.weight_n = rover.motor, (
            rover.total_mass_kg * self.simulation.config.gravity_mps2)

    def _rest(self) -> float:
        return even(self._rng, self.config.randomise.push_every_s)

    def _push(self) -> None:
        """Begin or end a push, where it is time."""
        push_n = self.config.randomise.push_n
        now_s = self.state.stamp_ns * 1e-9
        if push_n[1] > 0.0 and now_s >= self._next_push_s:
            angle, force = self._rng.uniform(0.0, 2.0 * math.pi), even(self._rng, push_n)
            self._simulation.apply_force([force * math.cos(angle), force * math.sin(angle), 0.0])
            self._push_until_s = now_s + PUSH_S
            self._next_push_s = self._push_until_s + self._rest()
        elif now_s >= self._push_until_s:
            self._simulation.apply_force(np.zeros(3))
            self._push_until_s = math.inf


def checked_action(action: ArrayLike, actions: Sequence[Channel]) -> Array:
    """Return an action as (n,) numbers cut off at -1 and 1.

    Raises:
        LearningError: It has another shape, or is not finite.
    """
    try:
        values = np.asarray(action, dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (len(actions),) or not np.isfinite(values).all():
        raise LearningError(f'action: {brief(action)} is not valid; valid are {len(actions)} '
                            f'finite numbers of -1 to 1: {actions[0].name} to {actions[-1].name}')
    return np.minimum(np.maximum(values, -1.0), 1.0)
