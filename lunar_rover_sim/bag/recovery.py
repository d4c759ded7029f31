"""Making a bag readable whose recording was cut off: by a kill, a full disk, a power cut.

MCAP: the complete chunks of a cut file are written to a new file with an index; mcap's stream
reader needs none. Whole files of a bag that is split stay as they are. SQLite: the database rolls
back what was not committed, and the `metadata.yaml` that is missing is made from its tables, as
`ros2 bag reindex` does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
import logging
from pathlib import Path
import shutil
import sqlite3
from typing import Any, BinaryIO

from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk, StreamReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9
import yaml

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.qos import qos_of_text
from lunar_rover_sim.bag.reader import check_files, open_bag, storage_files, typestore_of
from lunar_rover_sim.bag.writer import (bag_information, BagWriter, in_words, StorageFile, VERSION,
                                        write_metadata)
from lunar_rover_sim.base.errors import BagError

DISK_ERRORS = (OSError, sqlite3.Error)

logger = logging.getLogger(__name__)

_PARTIAL = '.recovered.partial'
_MOST_BYTES = 1 << 30     # of a record; more is no record of a bag
_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'     # RFC 8878, 3.1.1; CDR begins with a zero byte


def recover(path: Path | str, output: Path | str | None = None) -> int:
    """Make a cut-off bag readable and return its number of messages.

    What lies behind the last complete chunk (MCAP) or the last commit (SQLite) is dropped. The
    bag stays marked incomplete, since its recording was not finished or its end is lost.

    Args:
        path: The bag folder. Its storage file is replaced when the new one is complete.
        output: New folder for the readable bag, on another disk for instance; `path` stays as it
            is but for its mark.

    Raises:
        BagError: There is nothing to read or nothing to recover, the bag is still being recorded,
            or the disk has no space for the new file.
    """
    path = Path(path)
    if not path.is_dir():
        raise BagError(f'{path}: is not a bag folder')
    check_files(path)
    cut = [file for file in sorted(path.glob('*.mcap')) if not marker.has_end(file)]
    reason = marker.why_incomplete(path) or (f'{cut[0].name} has no end' if cut else None)
    if reason is None:
        raise BagError(f'{path}: is complete; there is nothing to recover')
    if output is not None and Path(output).exists():
        raise BagError(f'{output}: exists already and is not overwritten; name another bag')
    files = storage_files(path)
    try:
        marker.mark(path, reason)
        with marker.lock(path):
            if (path / marker.METADATA_NAME).is_file() and output is None and not cut:
                return _count(path)     # its index was written before the recording failed
            if files[0].suffix == '.mcap':
                return _recover_mcap(files, None if output is None else Path(output), reason)
            file = files[0]
            if output is not None:
                _need_space(Path(output).parent, file.stat().st_size)
                shutil.copytree(path, output)
            return _recover_sqlite(Path(output or path) / file.name, reason)
    except BlockingIOError:
        raise BagError(f'{path}: is still being recorded') from None
    except DISK_ERRORS as error:
        raise BagError(f'{path}: cannot be recovered: {in_words(error)}') from None


def _count(path: Path) -> int:
    with open_bag(path) as bag:
        return bag.message_count


def _recover_mcap(files: list[Path], output: Path | None, reason: str) -> int:
    """Write a new bag from files, or put new files in the place of those that are cut off."""
    if output is not None:
        try:
            output.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BagError(f'{output}: cannot be made: {error.strerror}') from None
        _need_space(output.parent, sum(file.stat().st_size for file in files))
        return _rewrite(files, output, reason)
    folder = files[0].parent
    cut = [file for file in files if not _is_whole(file)]
    _need_space(folder, sum(file.stat().st_size for file in cut))
    partial = folder / _PARTIAL
    shutil.rmtree(partial, ignore_errors=True)
    try:
        for file in cut:
            try:
                _rewrite([file], partial / file.stem, reason)
            except BagError:
                if len(files) == 1:
                    raise
                file.unlink()       # the next one had just begun
                files.remove(file)
                continue
            (partial / file.stem / file.name).replace(file)
        information, count = _information_of(files, reason)
        write_metadata(folder, information)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return count


def _is_whole(file: Path) -> bool:
    """Return whether an MCAP file has its end and its index."""
    with contextlib.suppress(Exception):    # whatever the parsers make of damaged bytes
        if marker.has_end(file):
            with Reader(file):
                return True
    return False


def _information_of(files: Sequence[Path], reason: str) -> tuple[dict[str, Any], int]:
    """Return what metadata.yaml says of whole MCAP files, and the number of their messages."""
    found: list[StorageFile] = []
    topics: dict[str, tuple[dict[str, Any], int]] = {}
    for file in files:
        with Reader(file) as reader:
            found.append(StorageFile(file.name, reader.start_time, max(0, reader.end_time - 1),
                                     reader.message_count))
            typestore = typestore_of(reader.connections)
            for c in reader.connections:
                before = topics[c.topic][1] if c.topic in topics else 0
                topics[c.topic] = ({
                    'name': c.topic, 'type': c.msgtype, 'serialization_format': 'cdr',
                    'offered_qos_profiles': dump_qos_v9(
                        getattr(c.ext, 'offered_qos_profiles', [])),
                    'type_description_hash': typestore.hash_rihs01(c.msgtype),
                }, before + c.msgcount)
    information = bag_information(found, 'mcap', {'incomplete': reason}, 'jazzy',
                                  list(topics.values()))
    return information, sum(file.count for file in found)


def _need_space(folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise BagError(f'{folder}: {needed / 1e6:.0f} MB are needed, {free / 1e6:.0f} MB are '
                       'free; make space, or name a folder on another disk with --output')


def _rewrite(files: Sequence[Path], bag: Path, reason: str) -> int:
    """Write what can be read of MCAP files to a new bag; return the number of messages."""
    left_out = set()
    writer = None
    folder = files[0].parent
    try:
        for file in files:
            schemas: dict[int, Schema] = {}
            topics: dict[int, str] = {}
            with file.open('rb') as stream:
                for record, compressed in _complete_records(stream):
                    if writer is None:
                        writer = BagWriter(bag, 'zstd' if compressed else 'none')
                    if isinstance(record, Message) and record.channel_id in topics:
                        writer.write_at(topics[record.channel_id], record.log_time, record.data)
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel):
                        try:
                            _add_topic(writer, record, schemas)
                            topics[record.id] = record.topic
                        except (BagError, KeyError, UnicodeDecodeError):
                            left_out.add(record.topic)
        if writer is None or not any(writer.counts.values()):
            raise BagError(f'{folder}: holds no complete chunk; there is nothing to recover')
        for topic in sorted(left_out):
            logger.warning('%s: %s is left out: the description of its type is damaged', folder,
                           topic)
    finally:
        if writer is not None:
            writer.close(incomplete=reason)
    return sum(writer.counts.values())


def _add_topic(writer: BagWriter, channel: Channel, schemas: Mapping[int, Schema]) -> None:
    """Add the topic of a channel; raises what a damaged record of it raises."""
    schema = schemas[channel.schema_id]
    profiles = qos_of_text(channel.metadata.get('offered_qos_profiles', ''))
    writer.add_topic(channel.topic, schema.name, profiles[0] if profiles else None,
                     schema.data.decode())


def _complete_records(stream: BinaryIO) -> Iterator[tuple[McapRecord, bool]]:
    """Yield (record, whether it was compressed) up to where the file breaks off.

    mcap's reader returns what is left of a record that is cut off, so that the size of a chunk is
    compared with the one in its head. A message outside of chunks is complete where another
    record follows.
    """
    pending: Message | None = None
    try:
        for record in StreamReader(stream, emit_chunks=True,
                                   record_size_limit=_MOST_BYTES).records:
            if pending is not None:
                yield pending, False
                pending = None
            if isinstance(record, Chunk):
                if not record.compression and len(record.data) != record.uncompressed_size:
                    return
                for inner in breakup_chunk(record):
                    yield inner, bool(record.compression)
            elif isinstance(record, Message):
                pending = record
            elif isinstance(record, (Schema, Channel)):
                yield record, False
    except Exception:  # whatever mcap and its decompressors make of the broken end
        return


def _recover_sqlite(file: Path, reason: str) -> int:
    """Roll back what was not committed and write metadata.yaml; return the number of messages."""
    with contextlib.closing(sqlite3.connect(f'{file.absolute().as_uri()}?mode=rw',
                                            uri=True)) as database:
        information, count = _information(database, file.name, reason)
        with database:
            database.execute('INSERT INTO metadata(metadata_version, metadata) VALUES(?, ?)',
                             (VERSION, yaml.safe_dump(information)))
    write_metadata(file.parent, information)
    return count


def _profiles(text: object) -> Any:
    """Return the offered QoS as metadata.yaml has it; none if it cannot be read."""
    try:
        return yaml.safe_load(str(text)) or []
    except (yaml.YAMLError, RecursionError, ValueError):
        return []


def _information(database: sqlite3.Connection, name: str,
                 reason: str) -> tuple[dict[str, Any], int]:
    """Return what metadata.yaml says of the storage file `name`, and its number of messages."""
    sample = database.execute('SELECT data FROM messages LIMIT 1').fetchone()
    if sample is None:
        raise BagError(f'{name}: holds no message; there is nothing to recover')
    compressed = isinstance(sample[0], bytes) and sample[0][:4] == _ZSTD_MAGIC
    counts = dict(database.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id'))
    start_ns, end_ns = database.execute(
        'SELECT min(timestamp), max(timestamp) FROM messages').fetchone()
    if not isinstance(start_ns, int) or not isinstance(end_ns, int):     # SQLite stores any type
        raise BagError(f'{name}: is damaged: the time of a message is not a whole number')
    topics = [({'name': topic, 'type': msgtype, 'serialization_format': encoding,
                'offered_qos_profiles': _profiles(qos), 'type_description_hash': type_hash},
               counts.get(key, 0))
              for key, topic, msgtype, encoding, qos, type_hash in database.execute(
                  'SELECT id, name, type, serialization_format, offered_qos_profiles, '
                  'type_description_hash FROM topics ORDER BY id')]
    file = StorageFile(name, start_ns, end_ns, sum(counts.values()))
    information = bag_information([file], 'sqlite3', {'incomplete': reason}, 'jazzy', topics,
                                  'zstd' if compressed else '')
    return information, file.count
