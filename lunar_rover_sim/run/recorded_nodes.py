"""The rover and the parameters of the nodes of a recording, from the scenario in its bag."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.errors import BagError, ConfigError
from lunar_rover_sim.parameters import merge
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.scenario import SHARED


@dataclasses.dataclass(frozen=True)
class RecordedNodes:
    """The rover, its physics, and its cameras and their light."""

    rover: RoverDescription
    physics: PhysicsNodeConfig
    render: RenderNodeConfig


def recorded_nodes(bag: Bag) -> RecordedNodes:
    """Return the rover and the parameters from the scenario in a bag.

    Raises BagError where there is none, or it is not of this version.
    """
    scenario = recorded_scenario(bag)
    if not scenario.sections.get('rover'):
        raise BagError(f'{bag.path}: holds no scenario, so the rover of the drive is not known')
    shared = scenario.sections.get(SHARED, {})

    def node(name: str) -> dict[str, object]:
        return merge(dict(shared), dict(scenario.sections.get(name, {})))

    try:
        return RecordedNodes(
            RoverDescription.from_mapping(scenario.sections['rover'], 'rover'),
            PhysicsNodeConfig.from_mapping(node('physics_node'), 'physics_node'),
            RenderNodeConfig.from_mapping(node('render_node'), 'render_node'))
    except ConfigError as error:
        raise BagError(f'{bag.path}: its scenario is not of this version: {error}') from None
