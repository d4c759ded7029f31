"""Making a bag readable whose recording was cut off: by a kill, a full disk, a power cut.

The complete chunks of a cut MCAP file are written to a new file with an index; mcap's stream
reader needs none. Whole files of a bag that is split stay as they are. Where messages are
compressed one by one, chunks are in their place, in all files: metadata.yaml says it of the bag.
Bags in SQLite, which this package does not record, are left to `ros2 bag reindex`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
import logging
from pathlib import Path
import shutil
from typing import Any, BinaryIO

from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk, StreamReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.metadata import (bag_information, check_files, qos_of_text, storage_files,
                                          StorageFile, topic_metadata, write_metadata)
from lunar_rover_sim.bag.reader import is_compressed, open_bag, typestore_of, uncompressed
from lunar_rover_sim.bag.writer import BagWriter, in_words
from lunar_rover_sim.base.errors import BagError

logger = logging.getLogger(__name__)

_PARTIAL = '.recovered.partial'
_MOST_BYTES = 1 << 30     # of a record; more is no record of a bag


def recover(path: Path | str, output: Path | str | None = None) -> int:
    """Make a cut-off bag readable and return its number of messages.

    What lies behind the last complete chunk is dropped. The bag stays marked incomplete, since its
    recording was not finished or its end is lost.

    Args:
        path: The bag folder. Its files that are cut off are replaced when new ones are complete.
        output: New folder for the readable bag, on another disk for instance; `path` stays as it
            is but for its mark.

    Raises:
        BagError: There is nothing to read or to recover, the bag is still being recorded or is in
            SQLite, or the disk has no space for the new file.
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
    if files[0].suffix != '.mcap':
        raise BagError(f'{files[0]}: only MCAP files are recovered; `ros2 bag reindex` makes the '
                       'metadata of others')
    try:
        marker.mark(path, reason)
        with marker.lock(path):
            if (path / marker.METADATA_NAME).is_file() and output is None and not cut:
                return _count(path)     # its index was written before the recording failed
            return _recover_mcap(files, None if output is None else Path(output), reason)
    except BlockingIOError:
        raise BagError(f'{path}: is still being recorded') from None
    except OSError as error:
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
    cut = [file for file in files if not _stays(file)]
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


def _stays(file: Path) -> bool:
    """Return whether an MCAP file has its end and its index, and no compressed messages."""
    with contextlib.suppress(Exception):    # whatever the parsers make of damaged bytes
        if marker.has_end(file):
            with Reader(file):
                return not _has_compressed_messages(file)
    return False


def _has_compressed_messages(file: Path) -> bool:
    with file.open('rb') as stream:
        return next((is_compressed(record.data) for record, _ in _complete_records(stream)
                     if isinstance(record, Message)), False)


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
                profiles = dump_qos_v9(getattr(c.ext, 'offered_qos_profiles', []))
                topics[c.topic] = topic_metadata(
                    c.topic, c.msgtype, profiles,
                    typestore.hash_rihs01(c.msgtype)), before + c.msgcount
    information = bag_information(found, {'incomplete': reason}, 'jazzy', list(topics.values()))
    return information, sum(file.count for file in found)


def _need_space(folder: Path, needed: int) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise BagError(f'{folder}: {needed / 1e6:.0f} MB are needed, {free / 1e6:.0f} MB are '
                       'free; make space, or name a folder on another disk with --output')


def _rewrite(files: Sequence[Path], bag: Path, reason: str) -> int:
    """Write what can be read of MCAP files to a new bag; return the number of messages."""
    left_out, damaged = set(), 0
    writer = None
    folder = files[0].parent
    by_message = _has_compressed_messages(files[0])
    try:
        for file in files:
            schemas: dict[int, Schema] = {}
            topics: dict[int, str] = {}
            with file.open('rb') as stream:
                for record, compressed in _complete_records(stream):
                    if writer is None:
                        writer = BagWriter(bag, 'zstd' if compressed or by_message else 'none')
                    if isinstance(record, Message) and record.channel_id in topics:
                        try:
                            data = uncompressed(record.data)
                        except BagError:
                            damaged += 1
                            continue
                        writer.write_at(topics[record.channel_id], record.log_time, data)
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
        if damaged:
            logger.warning('%s: compressed messages that are damaged and left out: %d', folder,
                           damaged)
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
