"""A spoke-leg micro rover on the Moon: MuJoCo walk, photorealistic stereo, rosbag2 record.

The names below are the way in for Python programs. Each is imported when it is first used, so that
a program that reads a bag does not load a renderer.
"""

from __future__ import annotations

import importlib
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from lunar_rover_sim.bag.reader import open_bag
    from lunar_rover_sim.base.errors import LunarRoverSimError
    from lunar_rover_sim.ground.world.build import build_world
    from lunar_rover_sim.ground.world.model import World
    from lunar_rover_sim.ground.world.world_folder import load_world, save_world
    from lunar_rover_sim.image.lidar.lidar import Lidar
    from lunar_rover_sim.image.rendering.renderer import Renderer
    from lunar_rover_sim.image.stereo.sgm import SgmMatcher
    from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
    from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
    from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry
    from lunar_rover_sim.rover.gait.controller import GaitController
    from lunar_rover_sim.rover.physics.simulation import Simulation
    from lunar_rover_sim.run.recording import record, Recording
    from lunar_rover_sim.run.scenario import Scenario

__version__ = '1.0.0'

_HOMES = {
    'build_world': 'ground.world.build',
    'evaluate': 'judge.evaluation.trajectory_evaluation',
    'GaitController': 'rover.gait.controller',
    'LunarRoverSimError': 'base.errors',
    'Lidar': 'image.lidar.lidar',
    'load_world': 'ground.world.world_folder',
    'open_bag': 'bag.reader',
    'record': 'run.recording',
    'Recording': 'run.recording',
    'Renderer': 'image.rendering.renderer',
    'save_world': 'ground.world.world_folder',
    'Scenario': 'run.scenario',
    'SgmMatcher': 'image.stereo.sgm',
    'Simulation': 'rover.physics.simulation',
    'Trajectory': 'judge.evaluation.trajectory',
    'VisualOdometry': 'judge.slam.reference.odometry',
    'World': 'ground.world.model',
}

__all__ = ['build_world', 'evaluate', 'GaitController', 'Lidar', 'load_world',
           'LunarRoverSimError', 'open_bag', 'record', 'Recording', 'Renderer', 'save_world',
           'Scenario', 'SgmMatcher', 'Simulation', 'Trajectory', 'VisualOdometry', 'World']


def __getattr__(name: str) -> Any:
    """Import a public name from its home (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(importlib.import_module(f'{__name__}.{_HOMES[name]}'), name)


def __dir__() -> list[str]:
    return sorted([*__all__, '__doc__', '__name__', '__version__'])
