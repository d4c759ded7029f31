"""The files of a data set, and the manifest of an episode: its files with their hashes.

    README.md, card.json      the data card
    episodes.csv              the episodes as a table
    croissant.json            all of it in the vocabulary of MLCommons
    campaign.json             the campaign that it comes from
    episodes/0007/            bag, scenario.yaml, rover.yaml, exported formats, manifest.json
    failed/0008/              error.json, logs: episodes that could not be made
    partial/                  what is being made, or was when the machine stopped

An episode is finished when its folder has its name. The folder is filled under another name, gets
its manifest, is forced to the disk, and is renamed last. So a power cut never leaves a folder that
looks finished and is not.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from lunar_rover_sim.base.errors import brief, CampaignError, one_line
from lunar_rover_sim.base.files.atomic import atomic_write, sync_folder
from lunar_rover_sim.base.files.paths import file_hash
from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.run.plan import WORLD_LINK

EPISODES = 'episodes'
FAILED = 'failed'
PARTIAL = 'partial'
CAMPAIGN_FILE = 'campaign.json'
CARD_FILE = 'card.json'
README_FILE = 'README.md'
EPISODE_TABLE = 'episodes.csv'
CROISSANT_FILE = 'croissant.json'
ERROR_FILE = 'error.json'
LOG_FILE = 'campaign.log'
PLAN_FILE = 'planned.yaml'
TASK_FILE = 'task.json'
TOKEN_FILE = '.token'
LOCK_FILE = '.lock'
STOP_FILE = '.stop'
MANIFEST = 'manifest.json'
FORMAT = 1
_MOST_BYTES = 1 << 24


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, whole or not at all, and force it to the disk.

    Raises:
        ValueError: If the content is not JSON (such as NaN).
        OSError: If it cannot be written.
    """
    atomic_write(path, json_text(content))


def json_text(content: Any) -> str:
    """Return the text of a JSON file; raise ValueError if the content is not JSON, such as NaN."""
    return json.dumps(content, indent=1, allow_nan=False) + '\n'


def read_json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file; raise CampaignError if there is none."""
    try:
        document = json.loads(read_text(path, _MOST_BYTES, CampaignError))
    except (ValueError, RecursionError) as error:
        reason = one_line(error)[:200]
        raise CampaignError(f'{path}: cannot be read: {reason}') from None
    if not isinstance(document, dict):
        raise CampaignError(f'{path}: not an object')
    return document


def file_table(folder: Path) -> dict[str, dict[str, Any]]:
    """Return relative path → size and SHA-256 of every regular file below a folder.

    Links (that to the world) and the manifest itself are left out. Each file is forced to the
    disk before it is read.
    """
    table = {}
    for name, path in sorted(episode_files(folder).items()):
        with path.open('rb') as file:
            os.fsync(file.fileno())
        table[name] = {
            'bytes': path.stat().st_size, 'sha256': file_hash(path)}
    for path in sorted(p for p in folder.rglob('*') if p.is_dir() and not p.is_symlink()):
        sync_folder(path)
    return table


def why_unfinished(folder: Path, scenario_hash: str | None = None) -> str | None:
    """Return why a folder is not that of a whole, unchanged episode of its plan; None if it is.

    Args:
        scenario_hash: SHA-256 of the scenario that it must have been made from; None for any.
    """
    try:
        manifest = read_json(folder / MANIFEST)
        if manifest.get('format') != FORMAT:
            return f'format {brief(manifest.get("format"))} of its manifest is not {FORMAT}'
        if scenario_hash is not None and manifest.get('scenario_sha256') != scenario_hash:
            return 'it was made from another scenario'
        files = manifest.get('files')
        if not isinstance(files, dict) or not files:
            return 'its manifest lists no files'
        found = episode_files(folder)
        for name, entry in files.items():
            path = found.get(name)
            if path is None or not isinstance(entry, dict):
                return f'{brief(name)} is missing'
            if path.stat().st_size != entry.get('bytes'):
                return f'{name} has {path.stat().st_size} of {brief(entry.get("bytes"))} bytes'
        # Sizes first: they need no reading.
        for name, entry in files.items():
            if file_hash(found[name]) != entry.get('sha256'):
                return f'{name} is not what was recorded'
    except (CampaignError, OSError) as error:
        return str(error)
    return None


def episode_files(folder: Path) -> dict[str, Path]:
    """Return relative path → path of the files of an episode; links and manifest are left out."""
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob('*')
            if path.is_file() and not path.is_symlink() and path.name != MANIFEST}


def strangers(folder: Path) -> list[str]:
    """Return what is neither file nor folder in an episode, but for the link to its world."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob('*')
                  if path.is_symlink() or not (path.is_file() or path.is_dir())
                  if path != folder / WORLD_LINK)
