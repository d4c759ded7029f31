"""The file names of stages. The command line imports it, also where OpenUSD is missing."""

from __future__ import annotations

from pathlib import Path

SUFFIXES = ('.usd', '.usda', '.usdc', '.usdz')


def is_stage(path: Path) -> bool:
    """Return whether a file name has the suffix of a stage."""
    return path.suffix.lower() in SUFFIXES


def is_package(path: Path) -> bool:
    """Return whether a stage of this name is one file with all its parts."""
    return path.suffix.lower() == '.usdz'


def parts_name(path: Path) -> str:
    """Return the name of the folder with the parts of a stage, beside it."""
    return f'{path.stem}_parts'


def stage_bytes(path: Path) -> int:
    """Return the size of a file, with its parts where it is a stage that has some."""
    size = path.stat().st_size
    if is_stage(path) and not is_package(path):
        parts = path.with_name(parts_name(path))
        size += sum(file.stat().st_size for file in parts.rglob('*') if file.is_file())
    return size
