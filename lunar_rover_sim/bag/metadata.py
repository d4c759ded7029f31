"""metadata.yaml of a bag: what it says of its files and of QoS, checked and written.

Offered QoS is recorded, so that `ros2 bag play` publishes as the graph did.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
import dataclasses
from pathlib import Path, PurePath
import re
import sqlite3
from typing import Any, BinaryIO

from mcap.reader import make_reader
from mcap.records import Channel
from mcap.stream_reader import StreamReader
from rosbags.interfaces import (Qos, QosDurability, QosHistory, QosLiveliness, QosReliability,
                                QosTime)
from rosbags.rosbag2.metadata import parse_qos
import yaml

from lunar_rover_sim.bag import marker
from lunar_rover_sim.base.errors import BagError, brief, one_line
from lunar_rover_sim.base.files.atomic import atomic_write
from lunar_rover_sim.base.files.paths import check_regular
from lunar_rover_sim.base.files.yaml_text import FAST_LOADER, yaml_of
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.base.topics import CONTRACT, LATCHED

COMPRESSED = '.zstd'    # behind the suffix of a file that is compressed as a whole
_STORAGES = '.mcap', '.db3'
_VERSION = 9             # of the metadata, as ROS 2 Jazzy writes it
_MOST_BYTES = 1 << 24    # of metadata.yaml
_NEVER_NS = 2**63 - 1   # start of a bag without messages, and a time of QoS that has no end


def check_files(path: Path) -> None:
    """Raise BagError if a bag, or a file in its folder, is a pipe or a device: they never end."""
    try:
        if not path.is_dir():
            check_regular(path, BagError)
            return
        for file in path.iterdir():
            if file.exists() and not file.is_dir():
                check_regular(file, BagError)
        metadata = path / marker.METADATA_NAME
        if metadata.is_file() and metadata.stat().st_size > _MOST_BYTES:
            raise BagError(f'{metadata}: larger than {_MOST_BYTES} bytes')
    except OSError as error:
        raise BagError(f'{path}: cannot be read: {error.strerror}') from None


def storage_files(path: Path) -> list[Path]:
    """Return the storage files of a bag folder, by their numbers; BagError where there is none.

    rosbag2 compresses whole files into others with one more suffix.
    """
    for suffix in (*_STORAGES, *(f'{storage}{COMPRESSED}' for storage in _STORAGES)):
        files = sorted(path.glob(f'*{suffix}'), key=lambda file: (
            [int(part) for part in re.findall(r'\d+', file.name.removesuffix(suffix))[-1:]],
            file.name))
        if files:
            return files
    raise BagError(f'{path}: is no bag: it holds neither .mcap nor .db3 files')


def information(bag: Path) -> Any:
    """Return what metadata.yaml of a bag folder says; BagError if it cannot be read."""
    where = bag / marker.METADATA_NAME
    try:
        with where.open('rb') as file:
            return yaml.load(file, FAST_LOADER)['rosbag2_bagfile_information']  # noqa: S506
    except (OSError, yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError) as error:
        raise BagError(f'{where}: cannot be read: {one_line(error)[:200]}') from None


def file_counts(bag: Path, told: Any) -> dict[str, int | None]:
    """Return file → number of its messages by metadata.yaml, in the order of time.

    Metadata before version 5 has no numbers: they are None.

    Args:
        told: `information` of the bag.

    Raises:
        BagError: a file is listed only in one of the two lists, or twice, or its number is none.
    """
    where = bag / marker.METADATA_NAME
    try:
        names = [PurePath(path).name for path in told['relative_file_paths']]
        listed = told.get('files') or []
        # Of files that it has compressed, rosbag2 lists the names before that.
        plain = {name.removesuffix(COMPRESSED): name for name in names}
        entries = [(plain.get(name, name), entry['message_count']) for entry in listed
                   for name in [PurePath(entry['path']).name.removesuffix(COMPRESSED)]]
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise BagError(f'{where}: the list of files cannot be read: '
                       f'{one_line(error)[:200]}') from None
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


def is_count(value: object) -> bool:
    """Return whether a value is a whole number >= 0 of 64 bits."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 63


# rosbags reads YAML by a parser that crashes where it is nested too deeply; PyYAML refuses that.
def check_told_profiles(bag: Path, told: Any) -> None:
    """Raise BagError for QoS in metadata.yaml, as text, that is no YAML."""
    with suppress(LookupError, TypeError, AttributeError):      # rosbags names what is missing
        for entry in told['topics_with_message_count']:
            _check_profile(bag, entry['topic_metadata'].get('offered_qos_profiles'))


def check_stored_profiles(file: Path) -> None:
    """Raise BagError for QoS in a storage file that is no YAML.

    Those of a compressed file are taken from metadata.yaml alone.
    """
    texts: list[object] = []
    if file.suffix == COMPRESSED:
        return
    if file.suffix == '.mcap':
        # Whatever is damaged here, rosbags finds too.
        with suppress(Exception), file.open('rb') as stream:
            for channel in _channels(stream):
                texts.append(channel.metadata.get('offered_qos_profiles'))
    else:
        with suppress(sqlite3.Error), closing(sqlite3.connect(
                f'{file.absolute().as_uri()}?mode=ro', uri=True)) as database:
            texts = [row[0] for row in database.execute('SELECT offered_qos_profiles FROM topics')]
    for text in texts:
        _check_profile(file, text)


def _channels(stream: BinaryIO) -> Iterator[Channel]:
    """Yield the channels of an MCAP file; where it has no summary, those among its messages."""
    summary = make_reader(stream).get_summary()
    if summary is not None and summary.channels:
        yield from summary.channels.values()
        return
    stream.seek(0)
    for record in StreamReader(stream).records:
        if isinstance(record, Channel):
            yield record


def _check_profile(where: Path, text: object) -> None:
    if isinstance(text, str):
        try:
            qos_of_text(text)
        except BagError as error:
            raise BagError(f'{where}: {error}') from None


@dataclasses.dataclass
class StorageFile:
    """One storage file of a bag.

    Attributes:
        name: Of the file.
        start_ns, end_ns: Bag times of its first and last message [ns].
        count: Its messages.
    """

    name: str
    start_ns: int = _NEVER_NS
    end_ns: int = 0
    count: int = 0

    def add(self, bag_ns: int) -> None:
        """Note a message at a bag time [ns]."""
        self.start_ns, self.end_ns = min(self.start_ns, bag_ns), max(self.end_ns, bag_ns)
        self.count += 1


def topic_metadata(topic: str, msgtype: str, profiles: object, hash_rihs01: str) -> dict[str, Any]:
    """Return what metadata.yaml says of a topic; profiles as `dump_qos_v9` gives them."""
    return {'name': topic, 'type': msgtype, 'serialization_format': 'cdr',
            'offered_qos_profiles': profiles, 'type_description_hash': hash_rihs01}


def bag_information(files: Sequence[StorageFile], custom: dict[str, str], distribution: str,
                    topics: list[tuple[dict[str, Any], int]]) -> dict[str, Any]:
    """Return what metadata.yaml says of a bag in MCAP.

    Args:
        files: Its storage files, in the order of time.
        custom: Custom data.
        distribution: Of ROS 2.
        topics: Metadata of each topic, and the number of its messages.
    """
    whole = StorageFile('', min(file.start_ns for file in files),
                        max(file.end_ns for file in files), sum(file.count for file in files))

    def span(file: StorageFile) -> dict[str, Any]:
        return {'starting_time': {'nanoseconds_since_epoch': file.start_ns},
                'duration': {'nanoseconds': max(0, file.end_ns - file.start_ns)},
                'message_count': file.count}

    return {'version': _VERSION, 'storage_identifier': 'mcap',
            'relative_file_paths': [file.name for file in files],
            **span(whole), 'topics_with_message_count': [
                {'topic_metadata': metadata, 'message_count': number}
                for metadata, number in topics],
            'compression_format': '', 'compression_mode': '',
            'files': [{'path': file.name, **span(file)} for file in files],
            'custom_data': custom or None, 'ros_distro': distribution}


def write_metadata(bag: Path, information: dict[str, Any]) -> None:
    """Write metadata.yaml of a bag; raise OSError where the disk is full."""
    atomic_write(bag / marker.METADATA_NAME, yaml_of({'rosbag2_bagfile_information': information}))


def reliable_qos(depth: int = 10, latched: bool = False) -> Qos:
    """Return a RELIABLE, KEEP_LAST profile; `latched` makes it TRANSIENT_LOCAL."""
    forever = _time(_NEVER_NS)
    return Qos(QosHistory.KEEP_LAST, depth, QosReliability.RELIABLE,
               QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
               forever, forever, QosLiveliness.AUTOMATIC, forever, False)


def contract_qos(topic: str) -> Qos:
    """Return the profile of a topic of the contract, under any namespace; else 10 deep."""
    for known in CONTRACT:
        if known.rate == LATCHED and ('/' + topic).endswith('/' + known.name):
            return reliable_qos(1, latched=True)
    return reliable_qos()


def as_recorded(profile: Any, topic: str) -> Qos:
    """Return rosbags' profile for one of rclpy's (or one of rosbags' own, unchanged).

    Discovery does not transmit history and depth. Where they are unknown, those of the contract
    are written.
    """
    if isinstance(profile, Qos):
        return profile
    known = contract_qos(topic)
    history = _member(QosHistory, profile.history, QosHistory.UNKNOWN)
    depth = int(profile.depth)
    if history not in (QosHistory.KEEP_LAST, QosHistory.KEEP_ALL) or depth == 0:
        history, depth = known.history, known.depth
    return Qos(history, depth,
               _member(QosReliability, profile.reliability, known.reliability),
               _member(QosDurability, profile.durability, known.durability),
               _time(profile.deadline.nanoseconds), _time(profile.lifespan.nanoseconds),
               _member(QosLiveliness, profile.liveliness, known.liveliness),
               _time(profile.liveliness_lease_duration.nanoseconds),
               bool(profile.avoid_ros_namespace_conventions))


def qos_of_text(text: str) -> list[Qos]:
    """Return the profiles in the YAML text that a storage file holds for a topic.

    Both layouts are read: names, as bags of version 9 have them, and the numbers of older
    versions.

    Raises:
        BagError: Where they cannot be read.
    """
    try:
        return parse_qos(yaml.load(text, FAST_LOADER) or [])  # noqa: S506
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError, OverflowError,
            RecursionError) as error:
        raise BagError('offered QoS profiles cannot be read: '
                       + one_line(error)) from None


def _member(kind: Any, value: Any, otherwise: Any) -> Any:
    """Return the member of an enumeration by its number."""
    try:
        return kind(int(value))
    except ValueError:
        return otherwise


def _time(nanoseconds: int) -> QosTime:
    return QosTime(int(nanoseconds) // NS_PER_S, int(nanoseconds) % NS_PER_S)
