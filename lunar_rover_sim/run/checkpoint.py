"""Checkpoints of a run: folders in which each node has written its state at one time.

DIR/checkpoints/000000060000000000, by the simulated time [ns], holds NODE.npz of each node and
`manifest.json` with their hashes. Nodes write into a folder with another name; it takes its own
when all is there, so that what is there is whole.
"""

from __future__ import annotations

from collections.abc import Collection
import dataclasses
import json
from pathlib import Path
import shutil

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.atomic import atomic_write, sync_folder
from lunar_rover_sim.base.files.paths import file_hash

CHECKPOINT_FOLDER = 'checkpoints'
_MANIFEST = 'manifest.json'
_PARTIAL = '.partial'
_DIGITS = 18
_KEPT = 2       # whole checkpoints: the newest, and one should that be damaged


@dataclasses.dataclass(frozen=True)
class Checkpoint:
    """A checkpoint of a run.

    Attributes:
        folder: With the states of the nodes.
    """

    folder: Path

    @property
    def time_ns(self) -> int:
        """The simulated time [ns]."""
        return int(self.folder.name.removesuffix(_PARTIAL))

    def part(self, node: str) -> Path:
        """Return the file with the state of a node."""
        return self.folder / f'{node}.npz'

    def missing(self, nodes: Collection[str]) -> list[str]:
        """Return the nodes that have not written their state."""
        return [node for node in nodes if not self.part(node).is_file()]

    def is_whole(self) -> bool:
        """Return whether all that the manifest names is there as it was written."""
        try:
            told = json.loads((self.folder / _MANIFEST).read_text(encoding='utf-8'))
            return bool(told) and all(file_hash(self.folder / name) == value
                                      for name, value in told.items())
        except (OSError, ValueError, AttributeError, RecursionError):
            return False


def begin(folder: Path, time_ns: int) -> Checkpoint:
    """Make the folder into which the nodes write at a simulated time [ns].

    Args:
        folder: Of all checkpoints of the run.

    Raises:
        ConfigError: If it cannot be made.
    """
    begun = Checkpoint(folder / f'{time_ns:0{_DIGITS}d}{_PARTIAL}')
    try:
        begun.folder.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(f'{begun.folder}: cannot be made: {error.strerror}') from None
    return begun


def under_way(folder: Path) -> Checkpoint | None:
    """Return the checkpoint into which the nodes write at this moment; None where there is none.
    """
    found = sorted(folder.glob(f'*{_PARTIAL}'))
    return Checkpoint(found[-1]) if found else None


def seal(begun: Checkpoint) -> None:
    """Make a checkpoint to which all nodes have written one that counts; remove older ones.

    Raises:
        ConfigError: If it cannot be written.
    """
    parts = sorted(begun.folder.glob('*.npz'))
    told = {part.name: file_hash(part) for part in parts}
    atomic_write(begun.folder / _MANIFEST, json.dumps(told, indent=1), ConfigError)
    try:
        begun.folder.rename(begun.folder.with_name(begun.folder.name.removesuffix(_PARTIAL)))
        sync_folder(begun.folder.parent)
    except OSError as error:
        raise ConfigError(f'{begun.folder}: cannot be written: {error.strerror}') from None
    for old in _named(begun.folder.parent)[:-_KEPT]:
        shutil.rmtree(old.folder, ignore_errors=True)


def newest(folder: Path) -> Checkpoint | None:
    """Return the newest checkpoint that is whole; None where there is none."""
    return next((one for one in reversed(_named(folder)) if one.is_whole()), None)


def clear(folder: Path, after_ns: int = -1) -> None:
    """Remove the checkpoints after a simulated time [ns], and those that were under way."""
    for one in [*_named(folder), *map(Checkpoint, folder.glob(f'*{_PARTIAL}'))]:
        if one.time_ns > after_ns or one.folder.name.endswith(_PARTIAL):
            shutil.rmtree(one.folder, ignore_errors=True)


def _named(folder: Path) -> list[Checkpoint]:
    return [Checkpoint(path) for path in sorted(folder.glob('[0-9]' * _DIGITS)) if path.is_dir()]
