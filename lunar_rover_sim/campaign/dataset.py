"""The folder of a data set: which episodes are finished, failed or missing, and which changed.

It is verified against its plan and its manifests: what was changed, deleted, added or renamed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import dataclasses
import hashlib
import json
import os
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim.bag.content_hash import bag_hash
from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import brief, CampaignError, LunarRoverSimError
from lunar_rover_sim.base.files.atomic import atomic_write, sync_folder
from lunar_rover_sim.base.files.paths import BAG_FOLDER, file_hash, lock
from lunar_rover_sim.base.files.results import csv_table
from lunar_rover_sim.campaign.campaign_file import (Campaign, draw, episode_names, EpisodePlan,
                                                    parse_campaign)
from lunar_rover_sim.campaign.episode import EpisodeTask
from lunar_rover_sim.campaign.manifest import (CAMPAIGN_FILE, episode_files, EPISODES, ERROR_FILE,
                                               FAILED, LOCK_FILE, MANIFEST, PARTIAL, read_json,
                                               strangers, TOKEN_FILE, why_unfinished, write_json)
from lunar_rover_sim.campaign.statistics import MEANINGS

# Columns that are no statistics, with their meanings.
FIRST_COLUMNS = {'folder': 'folder of the episode in the data set',
                 'bag_hash': 'hash of the contents of its bag'}


def episode_table(card: dict[str, Any]) -> str:
    """Return the table of a data card; what is not known is empty, text is UTF-8."""
    rows = []
    for name, episode in card['episodes'].items():
        values = [episode['statistics'].get(column) for column in MEANINGS]
        rows.append([f'{EPISODES}/{name}', episode.get('bag_hash') or '',
                     *(value if isinstance(value, (int, float)) else '' for value in values)])
    return csv_table([*FIRST_COLUMNS, *MEANINGS], rows)


@dataclasses.dataclass
class DatasetProgress:
    """The state of a data set: names of finished, failed and missing episodes.

    Attributes:
        failed: Name → error.
        remade: Name → why a finished episode is made again.
    """

    finished: list[str] = dataclasses.field(default_factory=list)
    failed: dict[str, str] = dataclasses.field(default_factory=dict)
    missing: list[str] = dataclasses.field(default_factory=list)
    remade: dict[str, str] = dataclasses.field(default_factory=dict)


class Dataset(Closing):
    """The folder of a data set that is being made; locked while it is open. Context manager.

    Raises:
        CampaignError: If the folder holds something else or is in use, or cannot be written.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self.folder = folder.resolve()
        self.campaign = campaign
        self._lock: int | None = None
        _refuse_foreign(self.folder)
        try:
            for name in (EPISODES, PARTIAL):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            self._lock = lock(self.folder / LOCK_FILE)
        except BlockingIOError:
            raise CampaignError(f'{folder}: another campaign is writing into it') from None
        except OSError as error:
            raise CampaignError(f'{folder}: cannot be written: {error.strerror}') from None
        # Left by a campaign that was interrupted.
        for left in (self.folder / PARTIAL).iterdir():
            shutil.rmtree(left, ignore_errors=True)
        self.token = os.urandom(16).hex()
        atomic_write(self.folder / TOKEN_FILE, self.token + '\n', CampaignError)

    def survey(self, plans: Sequence[EpisodePlan], retry: bool,
               seen: Callable[[str], None] = lambda name: None) -> DatasetProgress:
        """Return which episodes are finished, failed and missing; all their files are read.

        Args:
            retry: Failed episodes count as missing.
            seen: Called with the name of each episode.

        Raises:
            CampaignError: If an episode was made from another scenario, so that the folder belongs
                to another campaign.
        """
        progress = DatasetProgress()
        for plan in plans:
            name = plan.name
            seen(name)
            there = self.folder / EPISODES / name
            if there.exists():
                reason = why_unfinished(there, plan.scenario_hash)
                if reason is None:
                    progress.finished.append(name)
                    continue
                if _made_from_another(there, plan):
                    raise CampaignError(f'{there}: was made from another scenario; give -o '
                                        'another folder, or the campaign that was here')
                there.rename(self.folder / PARTIAL / f'{name}.damaged')
                sync_folder(there.parent)
                progress.remade[name] = reason
            error = self.folder / FAILED / name / ERROR_FILE
            if error.is_file() and not retry:
                progress.failed[name] = str(read_json(error).get('error', ''))
                continue
            progress.missing.append(name)
        return progress

    def record(self) -> None:
        """Write the campaign into the folder."""
        mapping = self.campaign.to_mapping()
        write_json(self.folder / CAMPAIGN_FILE, {
            'campaign': mapping, 'sha256': mapping_hash(mapping)})

    def tasks(self, plans: Sequence[EpisodePlan], names: Sequence[str]) -> list[EpisodeTask]:
        """Return the tasks of the named episodes, in the order of the plan."""
        wanted, config = set(names), self.campaign.config
        return [EpisodeTask(plan, config.formats, config.keep_bag, config.timeout_s, self.token)
                for plan in plans if plan.name in wanted]

    def close(self) -> None:
        """Remove unfinished attempts, and release the folder."""
        if self._lock is not None:
            for left in (self.folder / PARTIAL).glob('*'):
                shutil.rmtree(left, ignore_errors=True)
            os.close(self._lock)
            self._lock = None


def mapping_hash(mapping: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a campaign as plain values."""
    return hashlib.sha256(json.dumps(mapping, sort_keys=True).encode()).hexdigest()


def manifests(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the manifests of the episodes in the folder of a data set, by name.

    Raises:
        CampaignError: If the folder is not a data set, or a manifest is damaged.
    """
    if not (folder / EPISODES).is_dir():
        raise CampaignError(f'{folder}: is not a data set (it has no folder {EPISODES})')
    for path in sorted((folder / EPISODES).glob(f'*/{MANIFEST}')):
        manifest = read_json(path)
        if not isinstance(manifest.get('statistics'), dict):
            raise CampaignError(f'{path}: has no statistics')
        if not isinstance(manifest.get('drawn') or {}, dict):
            raise CampaignError(f'{path}: drawn is not a mapping of parameters')
        yield {**manifest, 'name': path.parent.name}


def failures(folder: Path) -> dict[str, str]:
    """Return name → error of the episodes that failed."""
    return {path.parent.name: str(read_json(path).get('error', ''))
            for path in sorted((folder / FAILED).glob(f'*/{ERROR_FILE}'))}


def _refuse_foreign(folder: Path) -> None:
    """Raise CampaignError if a folder holds something else than a data set."""
    try:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    except OSError as error:
        raise CampaignError(f'{folder}: cannot be read: {error.strerror}') from None
    if folder.exists() and not folder.is_dir():
        raise CampaignError(f'{folder}: is not a folder')
    if names and EPISODES not in names:
        raise CampaignError(f'{folder}: holds something that is not a data set; give -o another '
                            'folder')


def _made_from_another(there: Path, plan: EpisodePlan) -> bool:
    try:
        return read_json(there / MANIFEST).get('scenario_sha256') != plan.scenario_hash
    except CampaignError:
        return False  # damaged, to be made again


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
    try:
        manifest = read_json(episode / MANIFEST)
    except CampaignError as error:
        return str(error)
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
