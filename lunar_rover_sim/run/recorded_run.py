"""The run behind a bag: scenario, rover, nodes, frames of the rover, and world."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
import dataclasses
import functools
from pathlib import Path

import numpy as np

from lunar_rover_sim.bag.ground_points import ground_at
from lunar_rover_sim.bag.messages import header_ns, transform_matrix
from lunar_rover_sim.bag.reader import Bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario, RecordedScenario
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, ConfigError, nearest, WorldError
from lunar_rover_sim.base.frames import (Array, BASE_FRAME, IMU_FRAME, LEFT_OPTICAL_FRAME,
                                         LIDAR_FRAME, RIGHT_OPTICAL_FRAME)
from lunar_rover_sim.base.parameters import merge
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.world.cache import cache_folder
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.mounts import imu_pose, lidar_pose, optical_poses
from lunar_rover_sim.run.node_config import MappingNodeConfig, PhysicsNodeConfig, RenderNodeConfig
from lunar_rover_sim.run.plan import WORLD_LINK
from lunar_rover_sim.run.scenario import SHARED

FRAMES = {'base': BASE_FRAME, 'imu': IMU_FRAME, 'left': LEFT_OPTICAL_FRAME,
          'right': RIGHT_OPTICAL_FRAME, 'lidar': LIDAR_FRAME}


@dataclasses.dataclass(frozen=True)
class RecordedNodes:
    """The rover, its physics, its cameras and their light, and how it maps."""

    rover: RoverDescription
    physics: PhysicsNodeConfig
    render: RenderNodeConfig
    mapping: MappingNodeConfig

    @classmethod
    def of(cls, scenario: RecordedScenario) -> RecordedNodes | None:
        """Return those of a scenario; None where it describes no rover.

        Raises:
            ConfigError: The scenario is not of this version.
        """
        values = scenario.sections.get('rover')
        if not values:
            return None
        shared = scenario.sections.get(SHARED, {})

        def node(name: str) -> dict[str, object]:
            return merge(dict(shared), dict(scenario.sections.get(name, {})))

        return cls(RoverDescription.from_mapping(values, 'rover'),
                   PhysicsNodeConfig.from_mapping(node('physics_node'), 'physics_node'),
                   RenderNodeConfig.from_mapping(node('render_node'), 'render_node'),
                   MappingNodeConfig.from_mapping(node('mapping_node'), 'mapping_node'))


class DrivenSite:
    """The site of a drive, in the windows in which the rover was.

    Attributes:
        world: The window that the scenario names.
        windows: Stamps [ns] from which windows hold, and their middles [m].
    """

    def __init__(self, world: World, windows: Sequence[tuple[int, tuple[float, float]]]) -> None:
        self.world, self.windows = world, windows
        self._site, self._last = Site.of(world), world

    def at(self, time_ns: int | None = None) -> World:
        """Return the window in which the rover was at a time, None: at the end.

        Raises:
            WorldError: If it is neither kept nor can be built.
        """
        middle = self.world.ground.middle_m
        for since_ns, told in self.windows:
            if time_ns is None or since_ns <= time_ns or since_ns == self.windows[0][0]:
                middle = told
        for known in (self._last, self.world):
            if known.ground.middle_m == middle:
                return known
        self._last = self._site.window(middle)
        return self._last

    @property
    def reach_m(self) -> float:
        """Greatest |x| and |y| of the fine ground of its windows [m]."""
        half = self.world.ground.half_extent_m
        return half + max(max(map(abs, middle)) for middle in (
            self.world.ground.middle_m, *(middle for _, middle in self.windows)))


class RecordedRun:
    """The run of an open bag; what it says is read when it is asked for.

    Args:
        bag: An open bag.
    """

    def __init__(self, bag: Bag) -> None:
        self._bag = bag

    @functools.cached_property
    def scenario(self) -> RecordedScenario:
        """Sections of the scenario; empty where none was recorded."""
        return recorded_scenario(self._bag)

    @functools.cached_property
    def rover(self) -> RoverDescription | None:
        """The rover; None where no scenario describes it.

        Raises:
            BagError: The scenario is not of this version.
        """
        values = self.scenario.sections.get('rover')
        if not values:
            return None
        try:
            return RoverDescription.from_mapping(values, 'rover')
        except ConfigError as error:
            raise self._of_another_version(error) from None

    @functools.cached_property
    def nodes(self) -> RecordedNodes:
        """The rover and the parameters of physics and rendering.

        Raises:
            BagError: There is no scenario, or it is not of this version.
        """
        try:
            found = RecordedNodes.of(self.scenario)
        except ConfigError as error:
            raise self._of_another_version(error) from None
        if found is None:
            raise BagError(f'{self._bag.path}: holds no scenario, so the rover of the drive is '
                           'not known')
        return found

    def _of_another_version(self, error: ConfigError) -> BagError:
        return BagError(f'{self._bag.path}: its scenario is not of this version: {error}')

    def frame(self, name: str) -> Array:
        """Return T_base_frame (4, 4) of one of `FRAMES`: from tf_static, else from the rover.

        Raises:
            ConfigError: There is no such frame.
            BagError: The bag does not say where the frame is.
        """
        check_frame(name)
        if name == 'base':
            return np.eye(4)
        found = self.frame_from_tf(FRAMES[name])
        if found is not None:
            return found
        if self.rover is None:
            raise BagError(f'{self._bag.path}: holds neither tf_static nor a scenario; where '
                           f'{FRAMES[name]} is on the rover is not known')
        return rover_frame(self.rover, name)

    def frame_from_tf(self, child: str) -> Array | None:
        """Return T_base_child (4, 4) from tf_static; None where it lacks the frame."""
        if not self._bag.has(topics.TF_STATIC.name):
            return None
        parents: dict[str, tuple[str, Array]] = {}
        for _, _, message in self._bag.messages([topics.TF_STATIC.name]):
            for transform in message.transforms:
                parents[transform.child_frame_id] = (transform.header.frame_id,
                                                     transform_matrix(transform))
        T = np.eye(4)
        for _ in range(len(parents)):
            if child not in parents:
                return None
            parent, T_parent_child = parents[child]
            T = T_parent_child @ T
            if parent == BASE_FRAME:
                return T
            child = parent
        return None

    def world(self, folder: Path | str | None = None) -> World | None:
        """Return the world that was driven on; None where no folder holds one of its hash.

        It is looked for beside the bag (a link that `run` makes), in the scenario's folder and in
        the cache.

        Args:
            folder: Folder of the world, instead of these.

        Raises:
            WorldError: `folder` is given and holds another world, or none.
        """
        found = self._found_world(folder)
        return None if found is None else found[1]

    @functools.cached_property
    def windows(self) -> tuple[tuple[int, tuple[float, float]], ...]:
        """Stamps [ns] from which windows of the site hold, and their middles [m]."""
        if not self._bag.has(topics.WORLD_WINDOW.name):
            return ()
        return tuple((header_ns(message), (message.point.x, message.point.y))
                     for _, _, message in self._bag.messages([topics.WORLD_WINDOW.name]))

    def driven(self, folder: Path | str | None = None) -> DrivenSite | None:
        """Return the site that was driven on, by the world that `world` finds; None without."""
        world = self.world(folder)
        return None if world is None else DrivenSite(world, self.windows)

    def world_folder(self, folder: Path | str | None = None) -> Path:
        """Return the folder of `world`; WorldError where there is none."""
        found = self._found_world(folder)
        if found is None:
            raise WorldError(f'{self._bag.path}: its world is not found; give the folder of its '
                             'world')
        return found[0]

    def _found_world(self, folder: Path | str | None) -> tuple[Path, World] | None:
        wanted = (str(self._bag.first(topics.WORLD_HASH.name).data)
                  if self._bag.has(topics.WORLD_HASH.name) else None)
        if folder is not None:
            given = load_world(folder, verify=False)
            if wanted not in (None, given.hash):
                raise WorldError(f'{folder}: hash {given.hash[:12]} is not that of the world of '
                                 f'{self._bag.path}, {str(wanted)[:12]}')
            return Path(folder), given
        for candidate in self._world_folders(wanted) if wanted is not None else ():
            with suppress(WorldError):
                world = load_world(candidate, verify=False)
                if world.hash == wanted:
                    return candidate, world
        return None

    def _world_folders(self, wanted: str) -> Iterator[Path]:
        yield self._bag.path.absolute().parent / WORLD_LINK
        named = self.scenario.get('physics_node', 'world')
        if isinstance(named, str) and named:
            yield Path(named)
        for file in sorted(cache_folder().glob('*/world.yaml')):
            if f'hash: {wanted}' in file.read_text(encoding='utf-8', errors='replace'):
                yield file.parent

    def ground(self, time_s: float | None = None,
               folder: Path | str | None = None) -> tuple[World, Overlay]:
        """Return the untouched window in which the rover was, and the changes of the ground.

        Args:
            time_s: Simulated time [s]; None: the end.
            folder: As for `world`.

        Raises:
            WorldError: The world is not found, or `folder` holds another one.
            BagError: As `ground_at`.
        """
        driven = DrivenSite(load_world(self.world_folder(folder)), self.windows)
        time_ns = _ns(time_s)
        return driven.at(time_ns), ground_at(self._bag, time_ns, driven.reach_m)


def _ns(time_s: float | None) -> int | None:
    return None if time_s is None else round(time_s * NS_PER_S)


def check_frame(name: str) -> None:
    """Raise ConfigError unless a frame is one of `FRAMES`."""
    if name not in FRAMES:
        raise ConfigError(f'frame: {name!r} is not valid; {nearest(name, FRAMES)}')


def rover_frame(rover: RoverDescription, name: str) -> Array:
    """Return T_base_frame (4, 4) of one of `FRAMES` on a rover; ConfigError on another name."""
    check_frame(name)
    left, right = optical_poses(rover)
    return {'base': np.eye(4), 'imu': imu_pose(rover), 'left': left, 'right': right,
            'lidar': lidar_pose(rover)}[name]
