"""The sensor: its parameters, topics and measurement, and how that is read back.

Nodes, exports, pictures and the data card know a sensor by what its class says here. MuJoCo and
SciPy take time to import, and every command imports the parameters of the sensors: modules of this
room import both where they are used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from functools import cached_property
import math
from typing import Any, ClassVar, TYPE_CHECKING, TypeVar

import numpy as np

from lunar_rover_sim.base.files.state_file import attributes_but, restore_attributes
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.base.parameters import Parameters
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import of_legs, Topic
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.rover.description import RoverDescription

if TYPE_CHECKING:
    from lunar_rover_sim.rover.physics.simulation import Simulation
    from lunar_rover_sim.rover.physics.state import RoverState
    from lunar_rover_sim.sensors.sun_from_rover import SunFromRover

FROM_PRESET = -1.0      # of a parameter whose value a preset gives

P = TypeVar('P')


def over_preset(config: Parameters, preset: P) -> P:
    """Return a preset with the values that a configuration gives in their place.

    Args:
        config: Parameters with the field names of the preset, FROM_PRESET where none is given.
        preset: A dataclass.
    """
    names = [field.name for field in dataclasses.fields(preset)]    # type: ignore[arg-type]
    given = {name: value for name in names if (value := getattr(config, name)) != FROM_PRESET}
    return dataclasses.replace(preset, **given)     # type: ignore[type-var]


@dataclasses.dataclass(frozen=True)
class Content:
    """What a data card calls the data of one or more sensors.

    Attributes:
        name: The word in card.json.
        title: The words in the description of the data set.
    """

    name: str
    title: str


HEADING = Content('heading', 'sun sensor, star tracker or wheel odometry')
POWER = Content('power', 'power')


@dataclasses.dataclass(frozen=True)
class Platform:
    """What carries the sensors: the simulated rover on its site.

    Attributes:
        sun_config: The sun as the parameters give it, perhaps with a date.
        seed: Of the run.
        state_period_s: Time between two states [s].
    """

    simulation: Simulation
    sun_config: SunConfig
    seed: int
    state_period_s: float

    @property
    def rover(self) -> RoverDescription:
        """The rover."""
        return self.simulation.rover

    @cached_property
    def sun(self) -> SunFromRover:
        """What places on the rover see of the sun; one for all sensors."""
        from lunar_rover_sim.sensors.sun_from_rover import SunFromRover
        return SunFromRover(self.simulation, self.sun_config)


# What sensors measure. Other messages are given by the values of their fields, by dotted names.

@dataclasses.dataclass(frozen=True)
class Vector:
    """A vector, for geometry_msgs/Vector3Stamped.

    Attributes:
        xyz: Shape (3,).
    """

    xyz: Array


@dataclasses.dataclass(frozen=True)
class Attitude:
    """An orientation alone, for sensor_msgs/Imu.

    Attributes:
        R_world_base: Rotation, shape (3, 3).
        covariance_rad2: Of the error about the axes of the world, shape (3, 3) [rad^2].
    """

    R_world_base: Array
    covariance_rad2: Array


@dataclasses.dataclass(frozen=True)
class JointValues:
    """A value for each of some names, for sensor_msgs/JointState."""

    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float] = ()


@dataclasses.dataclass(frozen=True)
class Supply:
    """Voltage [V] and current [A] of a supply line, for sensor_msgs/BatteryState.

    Attributes:
        current_a: Negative where power is drawn, as the definition of the message says.
        gives: Whether the line gives power to the supply, rather than drawing from it.
    """

    line: str
    voltage_v: float
    current_a: float
    gives: bool = False


class Sensor:
    """Base of the sensors. A subclass says what it is in class attributes.

    Attributes:
        name: Of its parameters in physics_node, and of its values in exports.
        parameters: The class of its parameters; None where it has none.
        published: Its topics; rows of `topics.CONTRACT`, where LEG stands for each leg.
        content: What a data card calls it; None: its name.
        groups_as: Name in exports under which each topic stands by the last part of its name;
            '': a sensor of one topic, which stands under `name`.
        in_state: Whether it is part of every state, which `nodes.state_publisher` measures and
            publishes, read or not. The others are measured while somebody reads them.
        stream: Number of its stream of random numbers; 0 where it draws none. It never changes,
            so that recordings can be repeated.
    """

    name: ClassVar[str]
    parameters: ClassVar[type[Parameters] | None] = None
    published: ClassVar[tuple[Topic, ...]]
    content: ClassVar[Content | None] = None
    groups_as: ClassVar[str] = ''
    in_state: ClassVar[bool] = False
    stream: ClassVar[int] = 0

    def __init__(self, config: Any, platform: Platform) -> None:
        """Mount the sensor.

        Args:
            config: Its parameters.
            platform: What carries it.
        """
        self.config = config
        self.platform = platform

    @property
    def offered(self) -> tuple[Topic, ...]:
        """The topics that it publishes on its rover."""
        return of_legs(self.published, self.platform.rover.legs.names)

    def random_numbers(self) -> np.random.Generator:
        """Return a generator at the start of the sensor's stream."""
        return np.random.default_rng([self.platform.seed, self.stream])

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether it measures at a stamp [ns]: at its `rate_hz`, or else at every state."""
        rate_hz = getattr(self.config, 'rate_hz', None)
        return rate_hz is None or stamp_ns % (NS_PER_S // rate_hz) == 0

    def measure(self, state: RoverState, stamp_ns: int) -> Mapping[str, Any]:
        """Return what is measured now, by the name of its topic.

        It is a Vector, Attitude, JointValues or Supply, or a mapping of fields of the message,
        such as `temperature`, to values. A topic of which nothing can be measured is left out.

        Args:
            stamp_ns: Time for which it holds [ns].
        """
        raise NotImplementedError

    def restart(self) -> None:
        """Begin anew: the rover is back at its start, or nobody has read for a while."""

    def state(self) -> dict[str, Any]:
        """Return all that it goes on from."""
        return attributes_but(self, 'config', 'platform')

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` has returned, of a sensor with the same parameters."""
        restore_attributes(self, state)

    @classmethod
    def read(cls, topic: str, message: Any) -> dict[str, Any]:
        """Return the values of a recorded message, for JSON.

        Args:
            topic: Its name.
            message: As rosbags or rclpy deserialise it.
        """
        raise NotImplementedError

    @classmethod
    def card(cls) -> Content:
        """Return what a data card calls it."""
        return cls.content or Content(cls.name, cls.name.replace('_', ' '))


_DIGITS = 12


def number(value: Any, digits: int = _DIGITS) -> float | None:
    """Return a number for JSON, which has none that are not finite: None."""
    return round(float(value), digits) if math.isfinite(value) else None


def numbers(values: Any, digits: int = _DIGITS) -> list[float | None]:
    """Return the numbers of a list for JSON."""
    return [number(value, digits) for value in values]
