"""Making a data set: what is there stays, what is missing is made, what fails is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import dataclasses
import fcntl
import hashlib
import json
import os
from pathlib import Path
import shutil
from typing import Any

from lunar_rover_sim.campaign.campaign_file import Campaign
from lunar_rover_sim.campaign.episode import EpisodeTask, Outcome
from lunar_rover_sim.campaign.episode_plans import EpisodePlan
from lunar_rover_sim.campaign.layout import (CAMPAIGN_FILE, EPISODES, ERROR_FILE, FAILED,
                                             LOCK_FILE, PARTIAL, TOKEN_FILE)
from lunar_rover_sim.campaign.manifest import (MANIFEST, read_json, sync_folder, why_unfinished,
                                               write_json)
from lunar_rover_sim.errors import BagError

# Takes the tasks and whom to tell of each outcome; returns when all are done.
Scheduler = Callable[[Sequence[EpisodeTask], Callable[[Outcome], None]], None]


@dataclasses.dataclass
class Progress:
    """Where a data set stands: names of episodes that are there, have failed, are to be made.

    remade: name → why an episode that was there is made again.
    """

    finished: list[str] = dataclasses.field(default_factory=list)
    failed: dict[str, str] = dataclasses.field(default_factory=dict)
    missing: list[str] = dataclasses.field(default_factory=list)
    remade: dict[str, str] = dataclasses.field(default_factory=dict)


class Dataset:
    """The folder of a data set that is being made; locked while it is open, context manager.

    Raises BagError where the folder holds something else, another campaign, or is in use.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self.folder = folder.resolve()
        self.campaign = campaign
        self._lock: int | None = None
        _refuse_foreign(self.folder)
        try:
            for name in (EPISODES, PARTIAL):
                (self.folder / name).mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.folder / LOCK_FILE, os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise BagError(f'{folder}: another campaign is writing into it') from None
        except OSError as error:
            self.close()
            raise BagError(f'{folder}: cannot be written: {error.strerror}') from None
        # What was being made when the last one ended is nothing that counts.
        for left in (self.folder / PARTIAL).iterdir():
            shutil.rmtree(left, ignore_errors=True)
        self.token = os.urandom(16).hex()
        (self.folder / TOKEN_FILE).write_text(self.token + '\n', encoding='ascii')

    def survey(self, plans: Sequence[EpisodePlan], retry: bool,
               seen: Callable[[str], None] = lambda name: None) -> Progress:
        """Return what is there and what is missing; every file of every episode is read.

        retry: make episodes again that failed. Raises BagError where an episode was made from
        another scenario: the folder then holds another campaign's.
        """
        progress = Progress()
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
                    raise BagError(f'{there}: was made from another scenario; give -o another '
                                   'folder, or the campaign that was here')
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
        """Write down which campaign this is."""
        mapping = self.campaign.to_mapping()
        write_json(self.folder / CAMPAIGN_FILE, {
            'campaign': mapping, 'sha256': hashlib.sha256(
                json.dumps(mapping, sort_keys=True).encode()).hexdigest()})

    def tasks(self, plans: Sequence[EpisodePlan], names: Sequence[str]) -> list[EpisodeTask]:
        """Return the tasks of the named episodes, in the order of the plan."""
        wanted, config = set(names), self.campaign.config
        return [EpisodeTask(plan, config.formats, config.keep_bag, config.timeout_s, self.token)
                for plan in plans if plan.name in wanted]

    def manifests(self) -> Iterator[dict[str, Any]]:
        """Yield the manifests of the episodes that are there, by name."""
        yield from manifests(self.folder)

    def close(self) -> None:
        """Clear away what was being made, and let others in."""
        if self._lock is not None:
            for left in (self.folder / PARTIAL).glob('*'):
                shutil.rmtree(left, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Dataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def manifests(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the manifests of the episodes in the folder of a data set, by name.

    Raises BagError where the folder is not one, or a manifest is damaged.
    """
    if not (folder / EPISODES).is_dir():
        raise BagError(f'{folder}: is not a data set (it has no folder {EPISODES})')
    for path in sorted((folder / EPISODES).glob(f'*/{MANIFEST}')):
        manifest = read_json(path)
        if not isinstance(manifest.get('statistics'), dict):
            raise BagError(f'{path}: has no statistics')
        yield {**manifest, 'name': path.parent.name}


def failures(folder: Path) -> dict[str, str]:
    """Return name → error of the episodes that failed."""
    return {path.parent.name: str(read_json(path).get('error', ''))
            for path in sorted((folder / FAILED).glob(f'*/{ERROR_FILE}'))}


def _refuse_foreign(folder: Path) -> None:
    """Raise BagError where a folder holds what is no data set; nothing of others is touched."""
    try:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    except OSError as error:
        raise BagError(f'{folder}: cannot be read: {error.strerror}') from None
    if folder.exists() and not folder.is_dir():
        raise BagError(f'{folder}: is not a folder')
    if names and EPISODES not in names:
        raise BagError(f'{folder}: holds something that is not a data set; give -o another folder')


def _made_from_another(there: Path, plan: EpisodePlan) -> bool:
    try:
        return read_json(there / MANIFEST).get('scenario_sha256') != plan.scenario_hash
    except BagError:
        return False  # damaged, to be made again
