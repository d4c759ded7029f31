"""The traverse study: minutes of waypoints over rough worlds, and their cost to the rover."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import functools

import numpy as np

from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.gait.controller import GaitController
from lunar_rover_sim.path_following.config import DriveConfig
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.studies.parallel import map_in_processes
from lunar_rover_sim.studies.traverse_drive import TraverseDrive
from lunar_rover_sim.studies.traverse_result import Traverse
from lunar_rover_sim.studies.waypoint_route import random_waypoints
from lunar_rover_sim.world.cache import cached
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.world_folder import load_world


@dataclasses.dataclass(frozen=True)
class TraverseSettings:
    """What drives: rover, physics, gait and path following.

    duration_s: simulated time of each drive [s]
    Raises ConfigError if the gait does not suit the spokes.
    """

    rover: RoverDescription = RoverDescription()
    physics: PhysicsConfig = PhysicsConfig()
    gait: GaitConfig = GaitConfig()
    drive: DriveConfig = DriveConfig()
    duration_s: float = 600.0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'gait', self.gait.for_rover(self.rover))


def traverse(world: World, seed: int, settings: TraverseSettings) -> Traverse:
    """Drive random waypoints over a world; raise StudyError if there is no route."""
    length_m = 1.5 * settings.drive.speed_mps * settings.duration_s
    plan = functools.partial(random_waypoints, world, length_m, np.random.default_rng(seed))
    with Simulation(world, settings.rover, settings.physics) as simulation:
        controller = GaitController(settings.gait, GaitCalibration.of(
            settings.gait, settings.physics.ground.name))
        return TraverseDrive(simulation, controller, settings.drive, plan,
                             world.ground).run(seed, settings.duration_s)


def study(worlds: WorldConfig, seeds: Sequence[int], settings: TraverseSettings, workers: int = 1,
          progress: Callable[[Traverse, int, int], object] | None = None) -> list[Traverse]:
    """Traverse one world per seed, shared by `workers` processes.

    progress: called after each drive with its result, the number of drives done, and of all
    """
    return map_in_processes(functools.partial(_traverse_seed, worlds, settings), seeds, workers,
                            progress)


def _traverse_seed(worlds: WorldConfig, settings: TraverseSettings, seed: int) -> Traverse:
    return traverse(load_world(cached(worlds, seed), verify=False), seed, settings)
