"""A running graph in a browser: a page, and a websocket that Foxglove and Lichtblick read.

Both are at one port (`live_page`). Messages go out as they are on the wire (CDR), with the
definitions of their types, so that the layouts for ROS work and no ROS is needed where they are
looked at. foxglove-sdk (MIT) speaks the protocol. It buffers for each client and drops the oldest
messages of one that is slow.
"""

from __future__ import annotations

from collections.abc import Callable
import importlib.util
import logging
from pathlib import Path
import queue
import re
import socket
import subprocess
import sys
import time
from typing import Any

from rosbags.typesys import get_typestore, Stores

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.errors import ConfigError, with_extra
from lunar_rover_sim.run.child_process import dies_with_parent, end_group, signal_name
from lunar_rover_sim.run.live_page import Extra, PageServer
from lunar_rover_sim.run.ros_domain import ros_environment

HOST = '127.0.0.1'
TWIST = 'geometry_msgs/msg/Twist'
_BACKLOG = 32       # messages kept for a slow client
_END_S = 5.0
_TELL_S = 0.02      # times are told no more often than this, in wall time
_REFUSED = re.compile(r'subscribe to unknown channel: (\d+)')


class _SdkLog(logging.StreamHandler):       # type: ignore[type-arg]
    """What the SDK logs, to standard error, without the requests that it has refused."""

    def __init__(self) -> None:
        super().__init__()
        self.refused: queue.SimpleQueue[int] = queue.SimpleQueue()      # numbers of channels

    def emit(self, record: logging.LogRecord) -> None:
        refused = _REFUSED.search(record.getMessage())
        if refused:
            self.refused.put(int(refused[1]))
        else:
            super().emit(record)


class LiveView(Closing):
    """Serves topics to any number of clients. Context manager; methods may be called at any time.

    Args:
        port: Of the page and of the websocket.
        on_watch: Called in a thread of the server with a topic that a client has begun to watch.
        on_drive: Called there with a topic and a geometry_msgs/msg/Twist in CDR that a client
            publishes; other types are not taken.
        pages: What is served beside the page.

    Raises:
        ConfigError: The port is taken, or foxglove-sdk is missing.
    """

    def __init__(self, port: int, on_watch: Callable[[str], None] = lambda topic: None,
                 on_drive: Callable[[str, bytes], None] = lambda topic, data: None,
                 pages: Extra | None = None) -> None:
        check_view(port)
        import foxglove  # an optional dependency
        driven: dict[tuple[int, int], str] = {}     # topics by client and channel

        class Listener(foxglove.websocket.ServerListener):
            def on_subscribe(self, client: Any, channel: Any) -> None:
                on_watch(channel.topic)

            def on_client_advertise(self, client: Any, channel: Any) -> None:
                if channel.schema_name == TWIST and channel.encoding == 'cdr':
                    driven[client.id, channel.id] = channel.topic

            def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
                driven.pop((client.id, client_channel_id), None)

            def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
                if topic := driven.get((client.id, client_channel_id)):
                    on_drive(topic, data)

        self._foxglove, self._context = foxglove, foxglove.Context()
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._channels: dict[str, Any] = {}
        self._told_s = -_TELL_S
        self._log = _SdkLog()
        logging.getLogger('foxglove').addHandler(self._log)
        try:
            self._server = foxglove.start_server(
                name='lunar_rover_sim', host=HOST, port=0, context=self._context,
                capabilities=[foxglove.websocket.Capability.Time,
                              foxglove.websocket.Capability.ClientPublish],
                supported_encodings=['cdr'], server_listener=Listener(),
                message_backlog_size=_BACKLOG)
        except RuntimeError as error:
            self._end_log()
            raise ConfigError(f'port: {port} cannot be served: {error}') from None
        try:
            self._page = PageServer(HOST, port, self._server.port, pages or {})
        except OSError as error:
            self._server.stop()
            self._end_log()
            raise ConfigError(f'port: {port} cannot be served: {error.strerror}') from None

    def offer(self, topic: str, msgtype: str) -> bool:
        """Let clients watch a topic; return whether its type is one of ROS 2 Jazzy."""
        if topic in self._channels:
            return True
        if msgtype not in self._store.fielddefs:
            return False
        definition, _ = self._store.generate_msgdef(msgtype, ros_version=2)
        self._open(topic, self._foxglove.Schema(name=msgtype, encoding='ros2msg',
                                                data=definition.encode()))
        return True

    def _open(self, topic: str, schema: Any) -> None:
        self._channels[topic] = self._foxglove.Channel(
            topic, schema=schema, message_encoding='cdr', context=self._context)

    def offer_again(self) -> None:
        """Offer topics again for which a client's request was refused; call it regularly.

        foxglove-sdk 0.30.3 advertises a channel before it takes requests for it: a client that
        answers at once may be refused, and would wait for ever. It asks again for a new channel.
        """
        refused = set()
        while not self._log.refused.empty():
            refused.add(self._log.refused.get())
        for topic, channel in list(self._channels.items()):
            if channel.id() in refused:
                schema = channel.schema()
                channel.close()
                self._open(topic, schema)

    def watched(self) -> set[str]:
        """Return the topics that any client watches."""
        return {topic for topic, channel in self._channels.items() if channel.has_sinks()}

    def send(self, topic: str, stamp_ns: int, raw: bytes) -> None:
        """Send a serialised message of an offered topic to those who watch it."""
        self._channels[topic].log(raw, log_time=stamp_ns)

    def tell_time(self, time_ns: int) -> None:
        """Tell all clients what time it is [ns] in the stamps of the messages.

        A viewer that is not told takes its own clock, in which simulated stamps lie decades back.
        """
        now_s = time.monotonic()
        if now_s - self._told_s >= _TELL_S:
            self._told_s = now_s
            self._server.broadcast_time(time_ns)

    def close(self) -> None:
        """Stop to serve."""
        self._page.close()
        self._server.stop()
        self._end_log()

    def _end_log(self) -> None:
        logging.getLogger('foxglove').removeHandler(self._log)


def check_view(port: int, name: str = 'port') -> None:
    """Raise ConfigError where foxglove-sdk is missing or a port is taken; name: of the port."""
    if importlib.util.find_spec('foxglove') is None:
        raise ConfigError('the live view needs foxglove-sdk; install it with: '
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
    """view_node as a process beside a run. The run goes on if it ends."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._told_end = False

    def start(self, domain: int, port: int, world: Path) -> None:
        """Start it in the graph of a ROS domain; world: folder of the world on the map."""
        command = [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', 'view_node',
                   '--ros-args', '--log-level', 'warn', '-p', f'port:={port}',
                   '-p', f'world:={world}']
        self._process = subprocess.Popen(dies_with_parent(command), env=ros_environment(domain),
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
