"""SQLite storage that survives a kill: it commits at every flush, and rolls back what was cut off.

rosbags' SQLite writer holds one transaction until the end; its reader opens the file as
immutable, and so would read pages of a transaction that was never committed.
"""

from __future__ import annotations

from collections.abc import Collection, Generator
from pathlib import Path
import sqlite3
import sys

from rosbags.interfaces import Connection
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader, Sqlite3Writer

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'


class DurableSqlite3Writer(Sqlite3Writer):
    """SQLite writer that commits at every flush."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self.conn.commit()

    def flush(self) -> None:
        """Commit the open transaction."""
        self.conn.commit()

    def abort(self) -> None:
        """Close, keeping what can be kept."""
        try:
            self.conn.commit()
        except sqlite3.Error:
            self.conn.rollback()
        finally:
            self.conn.close()

    @classmethod
    def resume(cls, path: Path) -> DurableSqlite3Writer:
        """Open the cut-off database `path`; SQLite rolls back what was not committed."""
        self = cls.__new__(cls)
        self.path = path
        self.conn = sqlite3.connect(f'file:{path}?mode=rw', uri=True)
        self.cursor = self.conn.cursor()
        self.conn.execute('SELECT count(*) FROM topics').fetchone()
        return self

    def holds_compressed(self) -> bool:
        """Return whether the messages are compressed one by one."""
        row = self.conn.execute('SELECT data FROM messages LIMIT 1').fetchone()
        return row is not None and is_compressed(row[0])


class PartialSqlite3Reader(Sqlite3Reader):
    """Reader of a database that was cut off: an open transaction is rolled back first."""

    def open(self) -> None:
        """Open storage."""
        try:
            connection = sqlite3.connect(f'file:{self.path}?mode=rw', uri=True, timeout=10.0)
            try:
                connection.execute('SELECT count(*) FROM topics').fetchone()
            finally:
                connection.close()
        except sqlite3.Error as error:
            raise ReaderError(f'Cannot open database {self.path}: {error}') from None
        super().open()

    def messages(self, connections: Collection[Connection], start: int | None = None,
                 stop: int | None = None) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield (connection, time [ns], data), data decompressed where it was compressed."""
        for connection, time_ns, data in super().messages(connections, start, stop):
            yield connection, time_ns, zstd.decompress(data) if is_compressed(data) else data


def is_compressed(data: bytes) -> bool:
    """Return whether a message is compressed; CDR begins with a zero byte, zstd never does."""
    return data[:4] == _ZSTD_MAGIC
