"""What the renderer needs to know of a scenario."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from lunar_rover_sim.rendering.config import RenderConfig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.world.model import World


class Seeded(Protocol):
    """What all nodes of a scenario share."""

    @property
    def seed(self) -> int:
        """Seed of everything random."""


@runtime_checkable
class RenderedScenario(Protocol):
    """What `Renderer.from_scenario` needs of a scenario."""

    @property
    def shared(self) -> Seeded:
        """Parameters of all nodes."""

    @property
    def rover(self) -> RoverDescription:
        """The rover."""

    @property
    def render_node(self) -> RenderConfig:
        """Camera, light and detail."""

    def load_world(self) -> World:
        """Return the world, built if need be."""
