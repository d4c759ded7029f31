"""Checksums of MCAP files, verified by `bag check`; 0 means: none.

An MCAP file (https://mcap.dev/spec) has three kinds, all CRC-32: of the uncompressed records of
each chunk, of the data section (record Data End) and of the summary section (in the Footer).
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import struct
import sys
from typing import BinaryIO
from zlib import crc32

from lunar_rover_sim.base.errors import BagError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b'\x89MCAP0\r\n'

_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
_RECORD = struct.Struct('<BQ')      # opcode, length of the content
_CRC = struct.Struct('<I')
_TIMES_AND_SIZE = 3 * 8             # a chunk begins with start, end, uncompressed size; then CRC
_MOST_BYTES = 1 << 31               # of a record: a greater length is damage


def has_end(path: Path) -> bool:
    """Return whether an MCAP file ends as a finished one does; False if it cannot be read."""
    with suppress(OSError), path.open('rb') as file:
        size = file.seek(0, 2)
        file.seek(max(size - len(MAGIC), 0))
        return size >= 2 * len(MAGIC) and file.read() == MAGIC
    return False


def has_beginning(path: Path) -> bool:
    """Return whether a file begins as an MCAP file does; False if it cannot be read."""
    with suppress(OSError), path.open('rb') as file:
        return file.read(len(MAGIC)) == MAGIC
    return False


def damage(path: Path) -> str | None:
    """Return what does not fit its checksum, or None; checksums that are 0 are not verified.

    Raises:
        BagError: If the file is not a finished MCAP file.
    """
    with path.open('rb') as file:
        return _damage(path, file)


def _damage(path: Path, file: BinaryIO) -> str | None:
    if not has_end(path) or file.read(len(MAGIC)) != MAGIC:
        raise BagError(f'{path}: is not a finished MCAP file')
    section = crc32(MAGIC)          # of the bytes of the section so far
    while True:
        at = file.tell()
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            raise BagError(f'{path}: is damaged: it ends without a footer')
        opcode, length = _RECORD.unpack(head)
        if length > _MOST_BYTES:
            raise BagError(f'{path}: is damaged: a record of {length} bytes at byte {at}')
        content = file.read(length)
        if len(content) < length:
            raise BagError(f'{path}: is damaged: the record at byte {at} is cut short')
        if opcode in _NAMES:
            if opcode == _CHUNK:
                place, value = _TIMES_AND_SIZE, crc32(_uncompressed(path, at, content))
            elif opcode == _DATA_END:
                place, value = 0, section
            else:           # start of the summary and of its offsets, then the checksum
                place, value = 16, crc32(head + content[:16], section)
            stored, = _CRC.unpack_from(content, place)
            if stored not in (0, value):
                return f'{_NAMES[opcode]} at byte {at} does not fit its checksum'
        if opcode == _FOOTER:
            return None
        # The summary section begins after the record Data End.
        section = 0 if opcode == _DATA_END else crc32(content, crc32(head, section))


_NAMES = {_CHUNK: 'the chunk', _DATA_END: 'the data section that ends', _FOOTER: 'the summary '
          'section that ends'}


def _uncompressed(path: Path, at: int, content: bytes) -> bytes:
    """Return the records of a chunk, given the content of its record."""
    try:
        length, = struct.unpack_from('<I', content, _TIMES_AND_SIZE + 4)
        compression = content[_TIMES_AND_SIZE + 8:][:length]
        records = content[_TIMES_AND_SIZE + 8 + length + 8:]
        if compression == b'zstd':
            records = zstd.decompress(records)
        elif compression:
            raise BagError(f'{path}: chunk at byte {at}: compression {compression!r} is not '
                           'known; valid are zstd and none')
    except (struct.error, zstd.ZstdError) as error:
        raise BagError(f'{path}: chunk at byte {at} is damaged: {error}') from None
    return records
