"""A client of the websocket that `run --view` serves: the protocol of Foxglove, by hand."""

from collections import deque
from collections.abc import Iterator
import contextlib
import json
import socket
import struct
import time
from typing import Any

from waiting import LIMIT_S
from websockets.sync.client import ClientConnection, connect

_MESSAGE, _TIME = 1, 2


def free_port() -> int:
    """Return a port that nobody uses."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return int(probe.getsockname()[1])


class Client:
    """One connection; channels by their topics, as the server has advertised them."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self._wanted: dict[str, int] = {}       # subscriptions by their topics
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
                if channel['topic'] in self._wanted:        # offered anew, as viewers ask anew
                    self.subscribe(channel['topic'], self._wanted[channel['topic']])
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
        channel = self.find(topic)['id']
        self._wanted[topic] = number
        self.subscribe_channel(channel, number)

    def subscribe_channel(self, channel: int, number: int = 7) -> None:
        """Ask for a channel by its number, advertised or not."""
        self._connection.send(json.dumps({'op': 'subscribe', 'subscriptions': [
            {'id': number, 'channelId': channel}]}))

    def refusal(self) -> str:
        """Return the text of the next status that the server sends."""
        end_s = time.monotonic() + LIMIT_S
        while True:
            data = self._receive(end_s)
            if isinstance(data, str) and json.loads(data)['op'] == 'status':
                return str(json.loads(data)['message'])

    def time_ns(self) -> int:
        """Return the next time that the server tells [ns]."""
        return int(struct.unpack_from('<Q', self._next(_TIME), 1)[0])

    def message(self) -> tuple[int, int, bytes]:
        """Return number, time [ns] and content of the next message."""
        data = self._next(_MESSAGE)
        number, time_ns = struct.unpack_from('<IQ', data, 1)
        return number, time_ns, data[13:]


@contextlib.contextmanager
def client(port: int) -> Iterator[Client]:
    """Connect, as soon as there is a server."""
    end_s = time.monotonic() + LIMIT_S
    while True:
        try:
            connection = connect(f'ws://127.0.0.1:{port}', subprotocols=['foxglove.sdk.v1'],
                                 max_size=None, close_timeout=1.0, open_timeout=LIMIT_S)
            break
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)
    with connection:
        yield Client(connection)
