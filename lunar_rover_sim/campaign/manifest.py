"""The manifest of an episode: what it holds, byte for byte, and how it came about.

An episode is finished when its folder stands under its name: the folder is made under another
one, filled, given its manifest, forced to the disk, and renamed last. So there is no moment at
which a power cut leaves a folder that looks finished and is not.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from lunar_rover_sim.errors import BagError
from lunar_rover_sim.parameters import brief

MANIFEST = 'manifest.json'
FORMAT = 1
_MOST_BYTES = 1 << 24
_BLOCK = 1 << 20


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, whole or not at all, and force it to the disk."""
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    text = json.dumps(content, indent=1, allow_nan=False) + '\n'
    with partial.open('w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    sync_folder(path.parent)


def read_json(path: Path, most_bytes: int = _MOST_BYTES) -> dict[str, Any]:
    """Return the object in a JSON file; BagError where there is none."""
    try:
        with path.open('rb') as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            raise BagError(f'{path}: larger than {most_bytes} bytes')
        document = json.loads(content)
    except (OSError, ValueError, RecursionError) as error:
        raise BagError(f'{path}: cannot be read: {" ".join(str(error).split())[:200]}') from None
    if not isinstance(document, dict):
        raise BagError(f'{path}: not an object')
    return document


def file_table(folder: Path) -> dict[str, dict[str, Any]]:
    """Return relative path → size and SHA-256 of every regular file below a folder.

    Links (that to the world) and the manifest itself are left out. Each file is forced to the
    disk before it is read.
    """
    table = {}
    for path in sorted(_files(folder)):
        with path.open('rb') as file:
            os.fsync(file.fileno())
        table[path.relative_to(folder).as_posix()] = {
            'bytes': path.stat().st_size, 'sha256': file_hash(path)}
    for path in sorted(p for p in folder.rglob('*') if p.is_dir() and not p.is_symlink()):
        sync_folder(path)
    return table


def file_hash(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open('rb') as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def why_unfinished(folder: Path, scenario_hash: str | None = None) -> str | None:
    """Return why an episode's folder is not that of its plan, whole and unchanged; None if it is.

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
        found = {path.relative_to(folder).as_posix(): path for path in _files(folder)}
        for name, entry in files.items():
            path = found.get(name)
            if path is None or not isinstance(entry, dict):
                return f'{brief(name)} is missing'
            if path.stat().st_size != entry.get('bytes'):
                return f'{name} has {path.stat().st_size} of {brief(entry.get("bytes"))} bytes'
        # Sizes first: they tell without reading.
        for name, entry in files.items():
            if file_hash(found[name]) != entry.get('sha256'):
                return f'{name} is not what was recorded'
    except (BagError, OSError) as error:
        return str(error)
    return None


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob('*')
            if path.is_file() and not path.is_symlink() and path.name != MANIFEST]
