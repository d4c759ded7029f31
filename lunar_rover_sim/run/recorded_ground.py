"""The world of a recording, with what its rover had changed of the ground at a time."""

from __future__ import annotations

from pathlib import Path

from lunar_rover_sim import topics
from lunar_rover_sim.bag.ground_history import ground_at
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.errors import WorldError
from lunar_rover_sim.regolith.overlay import Overlay
from lunar_rover_sim.run.plan import WORLD_LINK
from lunar_rover_sim.seconds import NS_PER_S
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.world_folder import load_world


def world_beside(bag_path: Path) -> Path:
    """Return the folder of the world beside a bag, where `record` puts it; else WorldError."""
    folder = bag_path.absolute().parent / WORLD_LINK
    if not folder.exists():
        raise WorldError(f'{bag_path}: no world lies beside it; give the folder of its world')
    return folder


def recorded_ground(bag_path: Path, world: str | Path | None = None,
                    time_s: float | None = None) -> tuple[World, Overlay]:
    """Return the untouched world of a bag and the changes of its ground.

    world: its folder; None: the one beside the bag, where `record` puts it
    time_s: simulated time [s]; None: the end
    Raises WorldError for another world than the recorded one, BagError as `ground_at`.
    """
    folder = Path(world) if world is not None else world_beside(bag_path)
    with open_bag(bag_path) as bag:
        loaded = load_world(folder)
        if bag.has(topics.WORLD_HASH.name):
            recorded = str(bag.first(topics.WORLD_HASH.name).data)
            if recorded != loaded.hash:
                raise WorldError(f'{folder}: hash {loaded.hash[:12]} is not that of the world of '
                                 f'{bag_path}, {recorded[:12]}')
        time_ns = None if time_s is None else round(time_s * NS_PER_S)
        return loaded, ground_at(bag, time_ns, loaded.ground.half_extent_m)
