"""What a LiDAR needs to know of a scenario."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from lunar_rover_sim.illumination.config import ReflectanceConfig
from lunar_rover_sim.lidar.config import LidarConfig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.model import World


class Seeded(Protocol):
    """What all nodes of a scenario share."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""


class Reflecting(Protocol):
    """What is drawn."""

    @property
    def reflectance(self) -> ReflectanceConfig:
        """Kind and brightness of the regolith."""


@runtime_checkable
class ScannedScenario(Protocol):
    """What `Lidar.from_scenario` needs of a scenario."""

    @property
    def shared(self) -> Seeded:
        """Parameters of all nodes."""

    @property
    def rover(self) -> RoverDescription:
        """The rover."""

    @property
    def lidar_node(self) -> LidarConfig:
        """The sensor."""

    @property
    def render_node(self) -> Reflecting:
        """What the cameras see: the laser falls on the same regolith."""

    def load_world(self) -> World:
        """Return the world, built if need be."""
