"""A data set against its plan and its manifests: what was changed, deleted, added or renamed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import json
from pathlib import Path
from typing import Any

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.base.errors import brief, CampaignError, LunarRoverSimError
from lunar_rover_sim.base.files.paths import BAG_FOLDER, file_hash
from lunar_rover_sim.campaign.campaign_file import Campaign, parse_campaign
from lunar_rover_sim.campaign.dataset import failures, mapping_hash
from lunar_rover_sim.campaign.episode_plans import draw, episode_names
from lunar_rover_sim.campaign.manifest import (CAMPAIGN_FILE, episode_files, EPISODES, MANIFEST,
                                               PARTIAL, read_json, strangers, why_unfinished)


@dataclasses.dataclass(frozen=True)
class Verification:
    """What was found.

    Attributes:
        planned: Number of episodes of the plan.
        failed: Names of those that could not be made.
        problems: Name of an episode, of a file beside them, or of the plan → what is wrong.
    """

    planned: int
    failed: tuple[str, ...]
    problems: dict[str, str]


def status(dataset: Path) -> dict[str, Any]:
    """Return how far a data set is, as plain values; no file of an episode is read.

    Args:
        dataset: Its folder, also while a campaign is writing into it.

    Returns:
        `campaign`, its name; `planned`, the number of episodes; `finished`, `missing` and
        `under_way`, names of episodes; `failed`, name → error.

    Raises:
        CampaignError: The folder is no data set, or its plan was changed.
    """
    campaign = _campaign(dataset / CAMPAIGN_FILE)
    names, failed = list(episode_names(campaign)), failures(dataset)
    finished = [name for name in names if (dataset / EPISODES / name / MANIFEST).is_file()]
    failed = {name: error for name, error in failed.items() if name not in finished}
    under_way = sorted(path.name for path in (dataset / PARTIAL).glob('*'))
    return {'campaign': campaign.config.name, 'planned': len(names), 'finished': finished,
            'failed': failed, 'under_way': under_way,
            'missing': [name for name in names if name not in failed and name not in finished]}


def verify(dataset: Path, seen: Callable[[str], None] = lambda name: None) -> Verification:
    """Compare a data set with its plan, and each episode with its manifest; all files are read.

    Statistics and checks in a manifest are not computed anew, nor is the hash of a bag that was
    not kept.

    Args:
        seen: Called with the name of each episode.

    Raises:
        CampaignError: If the folder is no data set.
    """
    folder = dataset / EPISODES
    there = {path.name: path for path in folder.iterdir()} if folder.is_dir() else {}
    if not there:
        raise CampaignError(f'{dataset}: holds no episodes')
    problems: dict[str, str] = {}
    plan: dict[str, dict[str, Any]] = {}
    try:
        campaign = _campaign(dataset / CAMPAIGN_FILE)
        plan = dict(zip(episode_names(campaign), draw(campaign)))
    except LunarRoverSimError as error:
        problems[CAMPAIGN_FILE] = f'the plan is not known: {error}'
    failed = failures(dataset)
    for name in sorted({*there, *plan}):
        seen(name)
        if name not in there:
            if name not in failed:
                problems[name] = 'is missing'
            continue
        known = name in plan or not plan
        reason = _problem(there[name], plan.get(name)) if known else 'is not in the plan'
        if reason:
            problems[name] = reason
    return Verification(len(plan) or len(there), tuple(n for n in failed if n not in there),
                        problems)


def _campaign(path: Path) -> Campaign:
    """Return the campaign that a data set was made from; raise CampaignError or ConfigError."""
    document = read_json(path)
    mapping = document.get('campaign')
    if not isinstance(mapping, Mapping) or document.get('sha256') != mapping_hash(mapping):
        raise CampaignError(f'{path}: was changed')
    return parse_campaign(json.dumps(mapping), path)


def _problem(episode: Path, drawn: Mapping[str, Any] | None) -> str | None:
    """Return what is wrong with the folder of an episode; None if nothing is.

    Args:
        drawn: The values of its plan; None where the plan is not known.
    """
    if not episode.is_dir() or episode.is_symlink():
        return 'is not the folder of an episode'
    if not (episode / MANIFEST).is_file():
        return f'{MANIFEST} is missing'
    manifest = _read(episode / MANIFEST)
    if isinstance(manifest, str):
        return manifest
    if manifest.get('name') != episode.name:
        return f'is episode {brief(manifest.get("name"))}: the folder was renamed'
    # As JSON writes them.
    if drawn is not None and manifest.get('drawn') != json.loads(json.dumps(dict(drawn))):
        return 'its drawn values are not those of the plan'
    listed = manifest.get('files')
    listed = listed if isinstance(listed, dict) else {}
    found = episode_files(episode)
    parts = []
    gone = {name: entry for name, entry in listed.items() if name not in found}
    for name in sorted(set(found) - set(listed)):
        digest = file_hash(found[name])
        before = next((old for old, entry in gone.items()
                       if isinstance(entry, dict) and entry.get('sha256') == digest), None)
        if before is None:
            parts.append(f'{name} was added')
        else:
            del gone[before]
            parts.append(f'{before} was renamed to {name}')
    parts += [f'{brief(name)} is missing' for name in gone]
    parts += [f'{name} is no file, and was added' for name in strangers(episode)]
    return '; '.join(parts) or why_unfinished(episode) or _other_bag(episode, manifest)


def _other_bag(episode: Path, manifest: Mapping[str, Any]) -> str | None:
    """Return that the manifest names another hash than that of the bag; None without a bag."""
    bag = episode / BAG_FOLDER
    if not bag.is_dir():
        return None
    try:
        found = bag_hash(bag)
    except LunarRoverSimError as error:
        return str(error)
    named = manifest.get('bag_hash')
    return None if named == found else f'bag_hash {brief(named)} is not that of its bag, {found}'


def _read(path: Path) -> dict[str, Any] | str:
    """Return the object in a JSON file, or why it cannot be read."""
    try:
        return read_json(path)
    except CampaignError as error:
        return str(error)
