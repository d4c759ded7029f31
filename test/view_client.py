"""A client of the websocket that `run --view` serves: the protocol of Foxglove, by hand."""

from collections import deque
from collections.abc import Iterator
import contextlib
import json
import os
import socket
import struct
import time
from typing import Any

from waiting import LIMIT_S
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from lunar_rover_sim.run.live_page import TOKEN_VARIABLE

_MESSAGE, _TIME, _PLAYBACK = 1, 2, 5
TOKEN = 'token-of-the-tests'


def free_port() -> int:
    """Return a port that nobody uses, for a view here or in a process of the test."""
    os.environ[TOKEN_VARIABLE] = TOKEN
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return int(probe.getsockname()[1])


class Client:
    """One connection; channels by their topics, as the server has advertised them."""

    def __init__(self, connection: ClientConnection, port: int) -> None:
        self._connection, self.port = connection, port
        self.channels: dict[str, dict[str, Any]] = {}
        self._kept: deque[bytes] = deque()      # what came while nobody read

    def find(self, topic: str) -> dict[str, Any]:
        """Return the channel of a topic, as soon as it is advertised."""
        end_s = time.monotonic() + LIMIT_S
        while topic not in self.channels:
            self._receive(end_s)
        return self.channels[topic]

    def _receive(self, end_s: float) -> str | bytes:
        """Return what comes next; remember the channels that it advertises."""
        data = self._connection.recv(timeout=max(0.0, end_s - time.monotonic()))
        if isinstance(data, str):
            for channel in json.loads(data).get('channels', ()):
                self.channels[channel['topic']] = channel
        return data

    def attend(self) -> None:
        """Answer what the server has advertised; messages that have come wait to be read."""
        with contextlib.suppress(TimeoutError):
            while True:
                data = self._receive(0.0)
                if isinstance(data, bytes):
                    self._kept.append(data)

    def _next(self, kind: int) -> bytes:
        """Return the next binary message of a kind."""
        end_s = time.monotonic() + LIMIT_S
        while True:
            data = self._kept.popleft() if self._kept else self._receive(end_s)
            if isinstance(data, bytes) and data[0] == kind:
                return data

    def subscribe(self, topic: str, number: int = 7) -> None:
        """Ask for a topic; number: of the subscription."""
        self.send(json.dumps({'op': 'subscribe', 'subscriptions': [
            {'id': number, 'channelId': self.find(topic)['id']}]}))

    def send(self, data: str | bytes) -> None:
        """Send anything."""
        self._connection.send(data)

    def drive(self, topic: str, twist: bytes, kind: str = 'geometry_msgs/msg/Twist') -> None:
        """Publish bytes of a type on a topic, as the stick of the page does."""
        self.send(json.dumps({'op': 'advertise', 'channels': [
            {'id': 1, 'topic': topic, 'encoding': 'cdr', 'schemaName': kind}]}))
        self.send(struct.pack('<BI', 1, 1) + twist)

    def told(self, op: str) -> dict[str, Any]:
        """Return the next text of a kind that the server sends."""
        end_s = time.monotonic() + LIMIT_S
        while True:
            data = self._receive(end_s)
            if isinstance(data, str) and json.loads(data)['op'] == op:
                return dict(json.loads(data))

    def control(self, playing: bool, seek_ns: int | None = None, speed: float = 1.0) -> None:
        """Pause a recording, let it go on, or go elsewhere in it."""
        self.send(struct.pack('<BBfBQI', 3, not playing, speed, seek_ns is not None,
                              seek_ns or 0, 0))

    def playback(self) -> tuple[bool, int, bool]:
        """Return what comes next of a recording: whether it plays, its time [ns], and a jump."""
        paused, now_ns, _, sought = struct.unpack_from('<BQfB', self._next(_PLAYBACK), 1)
        return not paused, now_ns, bool(sought)

    def silent(self, seconds: float) -> None:
        """Raise AssertionError if a message comes within a time."""
        end_s = time.monotonic() + seconds
        with contextlib.suppress(TimeoutError):
            while True:
                data = self._receive(end_s)
                assert not isinstance(data, bytes) or data[0] != _MESSAGE

    def time_ns(self) -> int:
        """Return the next time that the server tells [ns]."""
        return int(struct.unpack_from('<Q', self._next(_TIME), 1)[0])

    def message(self) -> tuple[int, int, bytes]:
        """Return number, time [ns] and content of the next message."""
        data = self._next(_MESSAGE)
        number, time_ns = struct.unpack_from('<IQ', data, 1)
        return number, time_ns, data[13:]


@contextlib.contextmanager
def client(port: int, host: str = '127.0.0.1', **options: Any) -> Iterator[Client]:
    """Connect, as soon as there is a server; options: of `connect`."""
    end_s = time.monotonic() + LIMIT_S
    while True:
        try:
            connection = connect(f'ws://{host}:{port}/?token={TOKEN}',
                                 subprotocols=[Subprotocol('foxglove.sdk.v1')], max_size=None,
                                 close_timeout=1.0, open_timeout=LIMIT_S, proxy=None, **options)
            break
        except ConnectionError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)
    with connection:
        yield Client(connection, port)
