"""The folder of a data set: which episodes are finished, failed or missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import dataclasses
import hashlib
import json
import os
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import CampaignError
from lunar_rover_sim.base.files.atomic import atomic_write, sync_folder
from lunar_rover_sim.base.files.paths import lock
from lunar_rover_sim.base.files.results import csv_table
from lunar_rover_sim.campaign.campaign_file import Campaign
from lunar_rover_sim.campaign.episode import EpisodeTask
from lunar_rover_sim.campaign.episode_plans import EpisodePlan
from lunar_rover_sim.campaign.manifest import (CAMPAIGN_FILE, EPISODES, ERROR_FILE, FAILED,
                                               LOCK_FILE, MANIFEST, PARTIAL, read_json, TOKEN_FILE,
                                               why_unfinished, write_json)
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

    def manifests(self) -> Iterator[dict[str, Any]]:
        """Yield the manifests of the finished episodes, by name."""
        yield from manifests(self.folder)

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
