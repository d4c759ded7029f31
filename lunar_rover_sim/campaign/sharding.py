"""The shards of a whole data set, split by world into those for training, validation and test.

A shard holds samples of one drive, and all drives on a world are in one split: a network is tested
on worlds that it was not trained on. Worlds are split within each scenario that the campaign
starts from.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
import dataclasses
import hashlib
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import CampaignError, ConfigError
from lunar_rover_sim.base.files.atomic import partial_folder
from lunar_rover_sim.base.files.paths import BAG_FOLDER, counted
from lunar_rover_sim.campaign.campaign_file import BASE
from lunar_rover_sim.campaign.dataset import manifests
from lunar_rover_sim.campaign.manifest import CAMPAIGN_FILE, EPISODES, read_json
from lunar_rover_sim.products.sequences.export import export, WEBDATASET
from lunar_rover_sim.products.sequences.webdataset import (check_size, described, INDEX_FILE,
                                                           index_text, Shard, shard_name,
                                                           ShardOptions, VOCABULARY_FILE)

TRAIN, VALIDATION, TEST = SPLITS = ('train', 'val', 'test')
VOCABULARIES = 'label_info'     # a folder with a file for each drive


@dataclasses.dataclass(frozen=True)
class Episode:
    """An episode: its name, the scenario that it starts from, and the hash of its world."""

    name: str
    base: str
    world: str


def write_shards(dataset: Path, output: Path, size: int, shares: Mapping[str, float],
                 seen: Callable[[str], None] = lambda name: None) -> list[str]:
    """Write the shards of a data set into the new folder `output`; return sentences about them.

    Args:
        size: Samples a shard.
        shares: Share of the worlds of each scenario for VALIDATION and TEST.
        seen: Called with the name of each episode.

    Raises:
        CampaignError: If the folder is no data set, an episode has neither a bag nor shards, or
            there are too few worlds.
        ConfigError: If shares are not valid.
        SequenceError: If the size is not valid, and as `export` does.
    """
    check_size(size)
    if output.exists():
        raise CampaignError(f'{output}: exists already and is not overwritten; name another '
                            'folder')
    drives = _drives(dataset)
    split_of = split_worlds(drives, shares)
    with partial_folder(output, CampaignError) as partial:
        folder = partial / output.name
        folder.mkdir()
        made: dict[str, list[Shard]] = defaultdict(list)
        for drive in drives:
            seen(drive.name)
            made[split_of[drive.world]] += _take(dataset / EPISODES / drive.name, drive.name,
                                                 folder, split_of[drive.world],
                                                 len(made[split_of[drive.world]]), size)
        name = str(read_json(dataset / CAMPAIGN_FILE).get('campaign', {}).get('name', ''))
        for split, shards in made.items():
            ours = [drive for drive in drives if split_of[drive.world] == split]
            (folder / f'{split}.json').write_text(index_text(f'{name} {split}', shards, {
                'drives': {drive.name: {BASE: drive.base, 'world': drive.world}
                           for drive in ours}}), encoding='ascii')
        folder.rename(output)
    return [f'{output}/{split}: {counted(sum(s.samples for s in made[split]), "sample")} in '
            f'{counted(len(made[split]), "shard")}, '
            f'{counted(list(split_of.values()).count(split), "world")}'
            for split in SPLITS if split in made]


def split_worlds(drives: list[Episode], shares: Mapping[str, float]) -> dict[str, str]:
    """Return the split of each world by its hash.

    The order in which worlds are taken follows from their hashes, so that it is always the same.

    Raises:
        ConfigError: For shares that are not valid.
        CampaignError: If a scenario has too few worlds for them.
    """
    for split, share in shares.items():
        if not 0.0 <= share < 1.0 or sum(shares.values()) >= 1.0:
            raise ConfigError(f'--{split}: {share:g} is not valid; valid is at least 0, and less '
                              'than 1 for all splits together')
    base_of: dict[str, str] = {}
    for drive in drives:
        base_of.setdefault(drive.world, drive.base)
    result: dict[str, str] = {}
    for base in sorted(set(base_of.values())):
        worlds = sorted((world for world in base_of if base_of[world] == base),
                        key=lambda world: hashlib.sha256(world.encode()).digest())
        counts = {split: max(1, round(share * len(worlds)))
                  for split, share in shares.items() if share > 0.0}
        if sum(counts.values()) >= len(worlds) and counts:
            raise CampaignError(f'{base}: {len(worlds)} worlds are too few for '
                                f'{", ".join(counts)} and {TRAIN}; valid is at least '
                                f'{sum(counts.values()) + 1}')
        splits = [split for split, count in counts.items() for _ in range(count)]
        splits += [TRAIN] * (len(worlds) - len(splits))
        result.update(zip(worlds, splits))
    return result


def _drives(dataset: Path) -> list[Episode]:
    recorded = read_json(dataset / CAMPAIGN_FILE).get('campaign')
    base = str(recorded.get(BASE, '')) if isinstance(recorded, dict) else ''
    drives = []
    for manifest in manifests(dataset):
        name, drawn = manifest['name'], manifest.get('drawn') or {}
        drives.append(Episode(name, str(drawn.get(BASE, base)), _world(dataset / EPISODES / name)))
    if not drives:
        raise CampaignError(f'{dataset}: has no finished episodes')
    return drives


def _world(episode: Path) -> str:
    """Return the hash of the world of an episode."""
    if (episode / BAG_FOLDER).is_dir():
        with open_bag(episode / BAG_FOLDER) as bag:
            if bag.has(topics.WORLD_HASH.name):
                return str(bag.first(topics.WORLD_HASH.name).data)
        raise CampaignError(f'{episode / BAG_FOLDER}: lacks {topics.WORLD_HASH.name}, by which '
                            'drives are split')
    if (episode / WEBDATASET).is_dir():
        world = read_json(episode / WEBDATASET / INDEX_FILE).get('world')
        if isinstance(world, str) and world:
            return world
        raise CampaignError(f'{episode / WEBDATASET / INDEX_FILE}: names no world')
    raise CampaignError(f'{episode}: has neither {BAG_FOLDER} nor {WEBDATASET}; valid is a data '
                        f'set with bags, or with {WEBDATASET} among its formats')


def _take(episode: Path, name: str, folder: Path, split: str, first: int,
          size: int) -> list[Shard]:
    """Put the shards of an episode into a folder; return what they have become.

    They are made from the bag; without a bag, the shards of the episode are copied.

    Args:
        first: Number of the first one.
    """
    made = episode / WEBDATASET
    fresh = (episode / BAG_FOLDER).is_dir()
    if fresh:
        made = folder / f'.{name}'
        export(episode / BAG_FOLDER, made, WEBDATASET, shards=ShardOptions(name, size))
    shards: list[Shard] = []
    for entry in _listed(made / INDEX_FILE):
        target = folder / shard_name(split, first + len(shards))
        shutil.copyfile(made / entry['url'], target)
        shards.append(described(target, int(entry['nsamples'])))
    if (made / VOCABULARY_FILE).is_file():
        (folder / VOCABULARIES).mkdir(exist_ok=True)
        shutil.copyfile(made / VOCABULARY_FILE, folder / VOCABULARIES / f'{name}.json')
    if fresh:
        shutil.rmtree(made)
    return shards


def _listed(index: Path) -> list[dict[str, Any]]:
    """Return the entries of an index, whose names are those of files beside it."""
    entries = read_json(index).get('shardlist')
    if not isinstance(entries, list) or not all(
            isinstance(entry, dict) and isinstance(entry.get('nsamples'), int)
            and Path(str(entry.get('url'))).name == entry.get('url') for entry in entries):
        raise CampaignError(f'{index}: is not a list of shards')
    return entries
