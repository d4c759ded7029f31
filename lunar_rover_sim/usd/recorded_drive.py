"""What a stage of a drive needs to know besides its motion, from the scenario in the bag."""

from __future__ import annotations

import dataclasses

from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.errors import BagError, UsdError
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.node_config import PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.usd.world_stage import StageSettings


@dataclasses.dataclass(frozen=True)
class RecordedDrive:
    """The rover, its cameras and the physics of a recording."""

    rover: RoverDescription
    physics: PhysicsNodeConfig
    render: RenderNodeConfig

    @property
    def stage_settings(self) -> StageSettings:
        """What the stage of the world is to be made for."""
        return settings_of(self.physics, self.render)


def settings_of(physics: PhysicsNodeConfig, render: RenderNodeConfig) -> StageSettings:
    """Return what the stage of a world is to be made for, by the parameters of the nodes."""
    return StageSettings(render.sun, render.reflectance, physics.gravity_mps2,
                         physics.contact.sliding_friction, render.detail)


def recorded_drive(bag: Bag) -> RecordedDrive:
    """Return what the scenario of a bag says.

    Raises UsdError where there is none, or it is not of this version.
    """
    try:
        found = RecordedRun(bag).nodes
    except BagError as error:
        raise UsdError(str(error)) from None
    return RecordedDrive(found.rover, found.physics, found.render)
