"""The page of the live view: one port for browsers, of which websockets go on to another server.

A browser that opens `http://localhost:PORT` gets a page; a viewer that opens `ws://localhost:PORT`
speaks to the server of `live_view` behind it. Bytes are passed on as they come, one thread a
direction, so that a slow client holds up nobody but itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from http import HTTPStatus
from importlib import resources
import json
import socket
import socketserver
import threading
from typing import Any

import numpy as np

from lunar_rover_sim.base.closing import Closing
from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.ground.world.model import World

_MAX_HEAD = 1 << 14
_HEAD_S = 10.0      # for the request of a client
_PIECE = 1 << 16
_TYPES = {'html': 'text/html; charset=utf-8', 'js': 'text/javascript; charset=utf-8',
          'json': 'application/json', 'png': 'image/png'}
_FILES = {'/': 'live.html', '/live.js': 'live.js', '/cdr.js': 'cdr.js'}

# Path → what is served there: called in threads of the server; None: there is none.
Extra = dict[str, Callable[[], bytes | None]]


class PageServer(Closing):
    """Serves the page, and extra paths, in threads. Context manager."""

    def __init__(self, host: str, port: int, websocket_port: int, extra: Extra) -> None:
        """Begin to serve; raise OSError where the port is taken."""
        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):      # the client has gone
                    _answer(self.request, (host, websocket_port), extra)

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address, daemon_threads, block_on_close = True, True, False

        self._server = Server((host, port), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def close(self) -> None:
        """Stop to serve; connections to the server behind end with it."""
        self._server.shutdown()
        self._server.server_close()


def _answer(client: socket.socket, behind: tuple[str, int], extra: Extra) -> None:
    client.settimeout(_HEAD_S)
    head = b''
    while b'\r\n\r\n' not in head:
        piece = client.recv(_PIECE)
        if not piece or len(head) > _MAX_HEAD:
            return
        head += piece
    first, *lines = head.partition(b'\r\n\r\n')[0].decode('latin-1').split('\r\n')
    fields = {name.strip().lower(): value.strip().lower()
              for name, _, value in (line.partition(':') for line in lines)}
    if fields.get('upgrade') == 'websocket':
        client.settimeout(None)
        with socket.create_connection(behind) as server:
            server.sendall(head)
            _join(client, server)
        return
    method, _, rest = first.partition(' ')
    client.sendall(_response(method, rest.partition(' ')[0].partition('?')[0], extra))


def _response(method: str, path: str, extra: Extra) -> bytes:
    status, kind, body = HTTPStatus.OK, 'html', b''
    if method not in ('GET', 'HEAD'):
        status = HTTPStatus.METHOD_NOT_ALLOWED
    elif path in _FILES:
        kind = _FILES[path].rpartition('.')[2]
        folder = resources.files('lunar_rover_sim.run') / 'templates'
        body = (folder / _FILES[path]).read_bytes()
    elif path in extra and (found := extra[path]()) is not None:
        kind, body = path.rpartition('.')[2], found
    else:
        status = HTTPStatus.NOT_FOUND
    head = (f'HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: {_TYPES[kind]}\r\n'
            f'Content-Length: {len(body)}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n')
    return head.encode() + (b'' if method == 'HEAD' else body)


def _join(one: socket.socket, other: socket.socket) -> None:
    """Pass bytes on in both directions until either side ends."""
    for end in (one, other):
        end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    back = threading.Thread(target=_pass_on, args=(other, one), daemon=True)
    back.start()
    _pass_on(one, other)
    back.join()


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while piece := source.recv(_PIECE):
            sink.sendall(piece)
    for end in (source, sink):      # wakes the thread of the other direction
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


_MAP_PX = 1000
_ROCKS = 2000       # the largest ones are on the map


def map_pages(world: World | None, drivers: Callable[[], Sequence[str]]) -> Extra:
    """Return the paths that the page asks for.

    Args:
        world: Of the map; None: there is none.
        drivers: Returns who drives, so that the page must not.
    """
    facts = {} if world is None else _facts_of(world)
    picture = None if world is None else png_bytes(world.relief_picture(_MAP_PX))
    return {'/live.json': lambda: json.dumps({**facts, 'drivers': list(drivers())}).encode(),
            '/map.png': lambda: picture}


def _facts_of(world: World) -> dict[str, Any]:
    """Return the width of the map and (x, y, radius) of rocks [m]."""
    rocks = world.rocks
    radius_m = 0.5 * rocks.size_classes_m[rocks.size]
    largest = np.argsort(-radius_m, kind='stable')[:_ROCKS]
    shown = np.column_stack([rocks.position_m[largest, :2], radius_m[largest]])
    return {'half_extent_m': world.ground.half_extent_m, 'rocks': shown.round(3).tolist()}
