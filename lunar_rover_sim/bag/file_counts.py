"""What metadata.yaml says of a bag and of each of its files; rosbags shows less of it."""

from __future__ import annotations

from pathlib import Path, PurePath
from typing import Any

import yaml

from lunar_rover_sim.arguments import brief
from lunar_rover_sim.bag import marker
from lunar_rover_sim.errors import BagError, one_line

# The parser in C, where PyYAML has it, takes a tenth of the time.
_Loader: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def is_count(value: object) -> bool:
    """Return whether a value is a whole number >= 0 of 64 bits."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 63


def information(bag: Path) -> Any:
    """Return what metadata.yaml of a bag folder says; raises what reading and YAML raise."""
    with (bag / marker.METADATA_NAME).open('rb') as file:
        return yaml.load(file, _Loader)['rosbag2_bagfile_information']  # noqa: S506


def file_counts(bag: Path) -> dict[str, int | None]:
    """Return file → number of its messages by metadata.yaml, in the order of time.

    Metadata before version 5 has no numbers: they are None. Raises BagError where a file is
    listed only in one of the two lists, or twice, and where its number is none.
    """
    where = bag / marker.METADATA_NAME
    try:
        told = information(bag)
        names = [PurePath(path).name for path in told['relative_file_paths']]
        listed = told.get('files') or []
        entries = [(PurePath(entry['path']).name, entry['message_count']) for entry in listed]
    # Whatever is in the file instead of them; its reader has let it pass.
    except (OSError, yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError,
            AttributeError) as error:
        reason = one_line(error)
        raise BagError(f'{where}: the list of files cannot be read: {reason[:200]}') from None
    for name, count in entries:
        if not is_count(count):
            raise BagError(f'{where}: message_count of {brief(name)}: {brief(count)} is not '
                           'valid; valid is a whole number >= 0 of 64 bits')
    if len(set(names)) < len(names):
        raise BagError(f'{where}: relative_file_paths: a file is named twice')
    if entries and sorted(name for name, _ in entries) != sorted(names):
        raise BagError(f'{where}: files: {brief([name for name, _ in entries])} is not valid; '
                       f'valid are the files of relative_file_paths, {brief(names)}')
    return dict(entries) if entries else dict.fromkeys(names)
