"""MCAP storage that survives a kill: data reaches the file at every flush, and is found again.

rosbags' MCAP writer holds up to a chunk (1 MiB) in memory and writes its index at the end. The
writer here adds `flush`, after which everything written so far is in the file, and `resume`,
which finishes a file that was cut off. The reader here opens such a file without its end.
Record layouts are those of the MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Generator
from io import BytesIO
import os
from pathlib import Path
import struct
import sys
from typing import Any, cast

from rosbags.interfaces import (Connection, ConnectionExtRosbag2, MessageDefinition,
                                MessageDefinitionFormat)
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import (Channel, ChunkInfo, decompress, get_qos, McapReader,
                                          McapWriter, PendingChunk, read_bytes, read_string,
                                          Schema, Statistics)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x03, 0x04, 0x05, 0x06, 0x07
_RECORD = struct.Struct('<BQ')
_CHUNK_HEAD = struct.Struct('<QQQI')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_FOREVER = 2**63 - 1


class DurableMcapWriter(McapWriter):
    """MCAP writer whose file can be brought up to date, and resumed after a cut."""

    def flush(self) -> None:
        """Close the pending chunk and hand it to the operating system."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()

    def close(self, version: int, metadata: str) -> None:
        """Write index and footer, and force the file to the disk."""
        if self.chunk.msgs:
            self.close_chunk()
        self.chunk = PendingChunk(_FOREVER, 0, BytesIO(), defaultdict(list))
        super().close(version, metadata)
        descriptor = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    @classmethod
    def resume(cls, path: Path) -> DurableMcapWriter:
        """Open the cut-off file `path` behind its last complete chunk."""
        reader = PartialMcapReader(path)
        reader.open()
        try:
            self = cls.__new__(cls)
            self.path = path
            self.schemas = list(reader.schemas.values())
            self.channels = list(reader.channels.values())
            indexed = reader.chunks if reader.unindexed is None else reader.chunks[:-1]
            self.chunks = [_chunk_index(chunk) for chunk in indexed]
            self.chunk = PendingChunk(_FOREVER, 0, BytesIO(), defaultdict(list))
            self.compression = ''
            self.compressor = lambda data: data
            assert reader.statistics is not None
            self.channel_stats = {c.id: 0 for c in self.channels}
            self.channel_stats.update(reader.statistics.channel_message_counts)
            self.message_start_time = reader.statistics.start_time
            self.message_end_time = reader.statistics.end_time
            unindexed, end = reader.unindexed, reader.good_end
        finally:
            reader.close()
        self.bio = cast(Any, path.open('r+b'))
        self.bio.truncate(end)
        self.bio.seek(end)
        if unindexed is not None:
            self.chunk = unindexed
            self.close_chunk()
        return self


class PartialMcapReader(McapReader):
    """Reader of an MCAP file without its end; the file is scanned up to where it breaks off."""

    good_end = 0
    unindexed: PendingChunk | None = None

    def _open(self) -> None:
        bio = self.bio
        assert bio is not None
        size = os.fstat(bio.fileno()).st_size
        if bio.read(8) != b'\x89MCAP0\r\n' or size < 17:
            raise ReaderError('File magic is invalid.')
        bio.seek(8 + 9 + _RECORD.unpack(bio.read(9))[1])
        self.data_start = self.good_end = bio.tell()
        counts: dict[int, int] = defaultdict(int)
        while (record := self._next_record(size)) is not None:
            op, start, length = record
            if op == _CHUNK:
                if not self._scan_chunk(start, length, counts):
                    break
                bio.seek(start + 9 + length)
            elif op == _MESSAGE_INDEX:
                if not self.chunks:
                    break
                chunk = self.chunks[-1]
                (channel,) = struct.unpack('<H', bio.read(2))
                chunk.message_index_offsets[channel] = start
                length_so_far = start + 9 + length - chunk.chunk_start_offset - chunk.chunk_length
                self.chunks[-1] = chunk._replace(message_index_length=length_so_far)
                bio.seek(start + 9 + length)
            else:
                break
        self._settle(counts)

    def _next_record(self, size: int) -> tuple[int, int, int] | None:
        """Return (opcode, start, body length) of the next complete top-level record."""
        assert self.bio is not None
        start = self.bio.tell()
        head = self.bio.read(9)
        if len(head) < 9:
            return None
        op, length = _RECORD.unpack(head)
        return (op, start, length) if start + 9 + length <= size else None

    def _scan_chunk(self, start: int, length: int, counts: dict[int, int]) -> bool:
        assert self.bio is not None
        body = self.bio.read(length)
        head = BytesIO(body)
        start_ns, end_ns, raw_size, crc = _CHUNK_HEAD.unpack(head.read(_CHUNK_HEAD.size))
        compression = read_string(head)
        (compressed_size,) = struct.unpack('<Q', head.read(8))
        try:
            raw = decompress(head.read(compressed_size), compression, raw_size, crc)
            messages = self._scan_records(raw)
        except (ReaderError, zstd.ZstdError, struct.error):
            return False
        for channel, entries in messages.items():
            counts[channel] += len(entries)
        self.chunks.append(ChunkInfo(
            start_ns, end_ns, start, 9 + length, {}, 0, compression, compressed_size, raw_size,
            {channel: len(entries) for channel, entries in messages.items()}))
        pending = PendingChunk(start_ns, end_ns, BytesIO(), defaultdict(list, messages))
        pending.bio.write(raw)
        self.unindexed = pending
        return True

    def _scan_records(self, raw: bytes) -> dict[int, list[tuple[int, int]]]:
        """Take note of schemas and channels; return channel → (time, offset) of its messages."""
        messages: dict[int, list[tuple[int, int]]] = defaultdict(list)
        offset = 0
        while offset < len(raw):
            op, length = _RECORD.unpack_from(raw, offset)
            if op == _MESSAGE:
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(raw, offset + 9)
                messages[channel].append((time_ns, offset))
            elif op in (_SCHEMA, _CHANNEL):
                record = BytesIO(raw[offset + 9:offset + 9 + length])
                (key,) = struct.unpack('<H', record.read(2))
                if op == _SCHEMA:
                    self.schemas[key] = Schema(key, read_string(record), read_string(record),
                                               read_string(record))
                else:
                    (schema,) = struct.unpack('<H', record.read(2))
                    self.channels[key] = Channel(
                        key, self.schemas[schema].name, read_string(record), read_string(record),
                        read_bytes(record))
            offset += 9 + length
        return messages

    def _settle(self, counts: dict[int, int]) -> None:
        """Turn what the scan found into connections, statistics and metadata."""
        self.good_end = self.data_start
        if self.chunks:
            last = self.chunks[-1]
            if len(last.message_index_offsets) == len(last.channel_count):
                self.unindexed = None
                self.good_end = (last.chunk_start_offset + last.chunk_length
                                 + last.message_index_length)
            else:
                self.good_end = last.chunk_start_offset
        self.data_end = self.good_end
        by_name = {schema.name: schema for schema in self.schemas.values()}
        self.connections = [_connection(channel, by_name[channel.schema], counts, self)
                            for channel in self.channels.values()]
        total = sum(counts.values())
        start_ns = min((c.message_start_time for c in self.chunks), default=_FOREVER)
        end_ns = max((c.message_end_time for c in self.chunks), default=0)
        self.statistics = Statistics(total, len(self.schemas), len(self.channels), 0, 0,
                                     len(self.chunks), start_ns, end_ns, dict(counts))
        self.metadata = self.metadata._replace(
            duration=end_ns - start_ns + 1 if total else 0, start_time=start_ns,
            end_time=end_ns + 1 if total else 0, message_count=total)

    def messages(self, connections: Collection[Connection], start: int | None = None,
                 stop: int | None = None) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield (connection, time [ns], data) in the order of time."""
        if self.chunks:
            yield from super().messages(connections, start, stop)


def _chunk_index(chunk: ChunkInfo) -> BytesIO:
    """Return the body of the chunk index record, as the MCAP specification lays it out."""
    offsets = b''.join(struct.pack('<HQ', channel, offset)
                       for channel, offset in chunk.message_index_offsets.items())
    name = chunk.compression.encode()
    record = BytesIO()
    record.write(struct.pack('<QQQQI', chunk.message_start_time, chunk.message_end_time,
                             chunk.chunk_start_offset, chunk.chunk_length, len(offsets)))
    record.write(offsets)
    record.write(struct.pack('<QI', chunk.message_index_length, len(name)) + name)
    record.write(struct.pack('<QQ', chunk.compressed_size, chunk.uncompressed_size))
    return record


def _connection(channel: Channel, schema: Schema, counts: dict[int, int],
                owner: PartialMcapReader) -> Connection:
    kind = (MessageDefinitionFormat.MSG if schema.encoding == 'ros2msg'
            else MessageDefinitionFormat.IDL)
    return Connection(channel.id, channel.topic, channel.schema,
                      MessageDefinition(kind, schema.data), '', counts.get(channel.id, 0),
                      ConnectionExtRosbag2(channel.message_encoding, get_qos(channel.metadata)),
                      owner)
