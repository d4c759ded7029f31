"""A running graph or a recording in a browser: a page, and a websocket for viewers, at one port.

Messages go out as they are on the wire (CDR), with the definitions of their types, so that no ROS
is needed where they are looked at. The websocket speaks the protocol of Foxglove, which Lichtblick
speaks too. `live_page` says who may connect.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
import contextlib
import importlib.util
import json
import logging
import os
from pathlib import Path
import socket
import struct
import subprocess
import sys
import threading
import time
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import ConfigError, with_extra
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.run.child_process import dies_with_parent, end_group, signal_name
from lunar_rover_sim.run.live_page import Access, Extra, HOST, TOKEN_VARIABLE
from lunar_rover_sim.run.ros_domain import ros_environment

TWIST = 'geometry_msgs/msg/Twist'
_PROTOCOLS = ('foxglove.sdk.v1', 'foxglove.websocket.v1')
_BACKLOG = 32           # messages kept for a slow client
_MOST_BYTES = 1 << 16   # of a message of a client
_MOST_CHANNELS = 100    # that a client may offer, and that it may watch
_MOST_TOLD = 10         # reasons to refuse clients
_END_S = 5.0
_TELL_S = 0.02          # times are told no more often than this, in wall time
_MESSAGE, _TIME, _PLAYBACK = struct.Struct('<BIQ'), struct.Struct('<BQ'), struct.Struct('<BBQfBI')
_CLIENT_MESSAGE, _CONTROL = struct.Struct('<BI'), struct.Struct('<BBfBQI')


class Control(NamedTuple):
    """What a client wants of a recording.

    Attributes:
        playing: Whether it goes on.
        speed: Simulated seconds per second.
        seek_ns: Where it goes on from [ns]; None: from where it is.
        request: Name of the request, which the answer bears.
    """

    playing: bool
    speed: float
    seek_ns: int | None = None
    request: bytes = b''


class _Client:
    """One connection. What it is sent waits in a queue; the oldest messages of one are dropped."""

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.topics: dict[int, str] = {}        # of subscriptions by their numbers
        self.driven: dict[int, str] = {}        # topics of Twists by the client's channels
        self._said: deque[str | bytes] = deque()
        self._messages: deque[bytes] = deque(maxlen=_BACKLOG)
        self._changed = threading.Condition()
        self._ended = False

    def say(self, text: str | bytes) -> None:
        """Send what must not be lost."""
        with self._changed:
            self._said.append(text)
            self._changed.notify()

    def send(self, data: bytes) -> None:
        """Send what may be dropped."""
        with self._changed:
            self._messages.append(data)
            self._changed.notify()

    def forget(self) -> None:
        """Send nothing of what may be dropped and still waits."""
        with self._changed:
            self._messages.clear()

    def write(self) -> None:
        """Write what waits, until `end`; runs in a thread."""
        from websockets.exceptions import ConnectionClosed
        with contextlib.suppress(OSError, ConnectionClosed):
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._ended or self._said or self._messages)
                    if self._ended:
                        return
                    data = (self._said or self._messages).popleft()
                self.connection.send(data)

    def end(self) -> None:
        """Let `write` end."""
        with self._changed:
            self._ended = True
            self._changed.notify()


class LiveView(Closing):
    """Serves topics to any number of clients. Context manager; methods may be called at any time.

    Args:
        port: Of the page and of the websocket.
        on_watch: Called in a thread of the server with a topic that a client has begun to watch.
        on_drive: Called there with a topic and a geometry_msgs/msg/Twist in CDR that a client
            publishes; other types are not taken. None: there is nothing to drive.
        pages: What is served beside the page.
        origins: Of other pages that may connect.
        recording: First and last time [ns] of a recording; None: what is shown happens now.
        on_control: Called in a thread of the server with what a client wants of the recording.

    Attributes:
        access: The address, and who may connect.

    Raises:
        ConfigError: The port is taken, or websockets is missing.
    """

    def __init__(self, port: int, on_watch: Callable[[str], None] = lambda topic: None,
                 on_drive: Callable[[str, bytes], None] | None = None,
                 pages: Extra | None = None, origins: Sequence[str] = (),
                 recording: tuple[int, int] | None = None,
                 on_control: Callable[[Control], None] = lambda control: None) -> None:
        check_view(port)
        from websockets.sync.server import serve  # an optional dependency
        from websockets.typing import Subprotocol
        self.access = Access(port, origins)
        self._on_watch, self._on_drive, self._on_control = on_watch, on_drive, on_control
        self._pages, self._recording = pages or {}, recording
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._channels: dict[str, str] = {}     # topic → how it is advertised, as JSON
        self._topics: dict[int, str] = {}       # by the numbers of channels
        self._clients: set[_Client] = set()
        self._changing = threading.Lock()       # of channels and clients
        self._playback = b''
        self._refused: set[str] = set()         # why clients were, as it was told
        self._told_s = -_TELL_S
        self._log = logging.getLogger('lunar_rover_sim.live_view')
        quiet = logging.getLogger('lunar_rover_sim.live_view.websockets')
        quiet.setLevel(logging.CRITICAL)        # a client that breaks off is no event
        try:
            self._server = serve(
                self._attend, HOST, port, process_request=self._answer, logger=quiet,
                subprotocols=[Subprotocol(name) for name in _PROTOCOLS], compression=None,
                open_timeout=2.0, close_timeout=1.0, max_size=_MOST_BYTES)
        except OSError as error:
            raise ConfigError(f'port: {port} cannot be served: {error.strerror}') from None
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _answer(self, connection: Any, request: Any) -> Any:
        """Refuse a request, or answer one for a page; None lets a websocket begin."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response
        headers = request.headers
        if problem := self.access.problem(request.path, headers.get_all('Host'),
                                          headers.get_all('Origin')):
            if problem not in self._refused and len(self._refused) < _MOST_TOLD:
                self._refused.add(problem)
                self._log.warning('live view: a client was refused: %s', problem[:200])
            return connection.respond(403, f'lunar_rover_sim: {problem}\n')
        if headers.get_all('Upgrade'):
            return None
        status, kind, body = self.access.page(urlsplit(request.path).path, self._pages)
        return Response(status.value, status.phrase, Headers({
            'Content-Type': kind, 'Content-Length': str(len(body)), 'Connection': 'close',
            'Cache-Control': 'no-store', 'Referrer-Policy': 'no-referrer'}), body)

    def _attend(self, connection: Any) -> None:
        """Talk to one client until it goes."""
        client = _Client(connection)
        with self._changing:
            client.say(json.dumps(self._information()))
            if self._channels:
                client.say(_advertised(self._channels.values()))
            if self._playback:
                client.say(self._playback)
            self._clients.add(client)
        writer = threading.Thread(target=client.write, daemon=True)
        writer.start()
        try:
            for data in connection:
                try:
                    self._hear(client, data)
                except (ValueError, LookupError, TypeError, AttributeError, struct.error):
                    client.say(json.dumps({'op': 'status', 'level': 2,
                                           'message': 'this message cannot be understood'}))
        finally:
            with self._changing:
                self._clients.discard(client)
            client.end()

    def _information(self) -> dict[str, Any]:
        offered = ['time', *(['clientPublish'] if self._on_drive else ()),
                   *(['playbackControl'] if self._recording else ())]
        told = {'op': 'serverInfo', 'name': 'lunar_rover_sim', 'capabilities': offered,
                'supportedEncodings': ['cdr'], 'metadata': {}, 'sessionId': str(os.getpid())}
        for name, time_ns in zip(('dataStartTime', 'dataEndTime'), self._recording or ()):
            told[name] = dict(zip(('sec', 'nsec'), divmod(time_ns, NS_PER_S)))
        return told

    def _hear(self, client: _Client, data: str | bytes) -> None:
        """Do what a client says; raise what parsing raises."""
        if isinstance(data, str):
            told = json.loads(data)
            if told['op'] == 'subscribe':
                for one in told['subscriptions'][:_MOST_CHANNELS]:
                    self._watch(client, int(one['id']), self._topics[one['channelId']])
            elif told['op'] == 'unsubscribe':
                for number in told['subscriptionIds']:
                    client.topics.pop(number, None)
            elif told['op'] == 'advertise':
                for one in told['channels']:
                    if one['schemaName'] == TWIST and one['encoding'] == 'cdr' \
                            and len(client.driven) < _MOST_CHANNELS:
                        client.driven[int(one['id'])] = str(one['topic'])
            elif told['op'] == 'unadvertise':
                for number in told['channelIds']:
                    client.driven.pop(number, None)
        elif data[0] == 1 and self._on_drive:
            _, channel = _CLIENT_MESSAGE.unpack_from(data)
            if channel in client.driven:
                self._on_drive(client.driven[channel], data[_CLIENT_MESSAGE.size:])
        elif data[0] == 3 and self._recording:
            _, pauses, speed, seeks, seek_ns, length = _CONTROL.unpack_from(data)
            if not 0.0 < speed <= 100.0:
                raise ValueError(speed)
            first_ns, last_ns = self._recording
            self._on_control(Control(
                not pauses, speed, min(max(seek_ns, first_ns), last_ns) if seeks else None,
                data[_CONTROL.size:_CONTROL.size + length]))

    def _watch(self, client: _Client, number: int, topic: str) -> None:
        if not 0 <= number < 1 << 32:
            raise ValueError(number)
        if len(client.topics) < _MOST_CHANNELS or number in client.topics:
            client.topics = {**client.topics, number: topic}    # `send` goes through the old one
            self._on_watch(topic)

    def offer(self, topic: str, msgtype: str) -> bool:
        """Let clients watch a topic; return whether its type is one of ROS 2 Jazzy."""
        if topic in self._channels:
            return True
        if msgtype not in self._store.fielddefs:
            return False
        definition, _ = self._store.generate_msgdef(msgtype, ros_version=2)
        with self._changing:
            number = len(self._channels) + 1
            self._channels[topic] = json.dumps({
                'id': number, 'topic': topic, 'encoding': 'cdr', 'schemaName': msgtype,
                'schema': definition, 'schemaEncoding': 'ros2msg'})
            self._topics[number] = topic
            for client in self._clients:
                client.say(_advertised([self._channels[topic]]))
        return True

    def _all(self) -> list[_Client]:
        with self._changing:
            return list(self._clients)

    def watched(self) -> set[str]:
        """Return the topics that any client watches."""
        return {topic for client in self._all() for topic in list(client.topics.values())}

    def send(self, topic: str, stamp_ns: int, raw: bytes) -> None:
        """Send a serialised message of an offered topic to those who watch it."""
        for client in self._all():
            for number, wanted in list(client.topics.items()):
                if wanted == topic:
                    client.send(_MESSAGE.pack(1, number, stamp_ns) + raw)

    def tell_time(self, time_ns: int) -> None:
        """Tell all clients what time it is [ns] in the stamps of the messages.

        A viewer that is not told takes its own clock, in which simulated stamps lie decades back.
        """
        now_s = time.monotonic()
        if now_s - self._told_s >= _TELL_S:
            self._told_s = now_s
            for client in self._all():
                client.send(_TIME.pack(2, time_ns))

    def tell_playback(self, control: Control, now_ns: int, sought: bool) -> None:
        """Tell all clients how the recording is played, and where it stands [ns]."""
        answer = _PLAYBACK.pack(5, not control.playing, now_ns, control.speed, sought,
                                len(control.request)) + control.request
        with self._changing:
            self._playback = _PLAYBACK.pack(5, not control.playing, now_ns, control.speed, False,
                                            0)
            for client in self._clients:
                if sought:
                    client.forget()
                client.say(answer)

    def close(self) -> None:
        """Stop to serve."""
        for client in self._all():      # one that does not read would wait for ever
            with contextlib.suppress(OSError):
                client.connection.socket.shutdown(socket.SHUT_RDWR)
        self._server.shutdown()


def _advertised(channels: Iterable[str]) -> str:
    return f'{{"op": "advertise", "channels": [{", ".join(channels)}]}}'


def check_view(port: int, name: str = 'port') -> None:
    """Raise ConfigError where websockets is missing or a port is taken; name: of the port."""
    if importlib.util.find_spec('websockets') is None:
        raise ConfigError('the live view needs websockets; install it with: '
                          + with_extra('view'))
    if not 1024 <= port <= 65535:
        raise ConfigError(f'{name}: {port} is not valid; valid is 1024 to 65535')
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise ConfigError(f'{name}: {port} cannot be served: {error.strerror}') from None


class ViewProcess:
    """view_node as a process beside a run. The run goes on if it ends.

    Attributes:
        access: Its address.
    """

    def __init__(self, port: int, origins: Sequence[str] = ()) -> None:
        check_view(port, '--view')
        self.access = Access(port, origins)
        self._port, self._origins = port, tuple(origins)
        self._process: subprocess.Popen[bytes] | None = None
        self._told_end = False

    def start(self, domain: int, world: Path) -> None:
        """Start it in the graph of a ROS domain; world: folder of the world on the map."""
        command = [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', 'view_node',
                   '--ros-args', '--log-level', 'warn', '-p', f'port:={self._port}',
                   '-p', f'world:={world}']
        if self._origins:
            command += ['-p', f'allow_origin:={json.dumps(self._origins)}']
        # Not as an argument: other users of the machine read those.
        environment = {**ros_environment(domain), TOKEN_VARIABLE: self.access.token}
        self._process = subprocess.Popen(dies_with_parent(command), env=environment,
                                         stdin=subprocess.DEVNULL, start_new_session=True)

    def early_end(self) -> str:
        """Return in a line, once, how it has ended by itself; else ''."""
        status = None if self._process is None else self._process.poll()
        if status is None or self._told_end:
            return ''
        self._told_end = True
        how = f'with status {status}' if status >= 0 else f'with {signal_name(-status)}'
        return f'view_node: ended {how}; the run goes on without the live view'

    def stop(self) -> None:
        """End it."""
        if self._process is not None:
            end_group(self._process, _END_S)
