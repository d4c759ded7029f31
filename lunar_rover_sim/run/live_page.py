"""The page of the live view, and who may open it.

Any page that a browser has open can send requests to this machine. So a request is answered only
where its Host is the address that was printed, its Origin, if a browser names one, is that address
or one that the user allows, and it bears the token of the address.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import hmac
from http import HTTPStatus
from importlib import resources
import json
import os
import secrets
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.files.images import png_bytes
from lunar_rover_sim.ground.world.model import World

HOST = '127.0.0.1'
TOKEN_VARIABLE = 'LUNAR_ROVER_SIM_VIEW_TOKEN'
_LEAST_TOKEN = 16
_TYPES = {'html': 'text/html; charset=utf-8', 'js': 'text/javascript; charset=utf-8',
          'json': 'application/json', 'png': 'image/png'}
_FILES = {'/': 'live.html', '/live.js': 'live.js', '/cdr.js': 'cdr.js'}

# Path → what is served there: called in threads of the server; None: there is none.
Extra = dict[str, Callable[[], bytes | None]]


class Access:
    """The address of a live view with its token, and what a request must say to be answered.

    The token is that of the environment variable LUNAR_ROVER_SIM_VIEW_TOKEN, or a new one.

    Args:
        port: Of page and websocket.
        origins: Of pages elsewhere that may connect too, such as `https://app.foxglove.dev`.

    Attributes:
        url: Of the page.
        websocket_url: For viewers.

    Raises:
        ConfigError: An origin is none, or the token of the environment is short.
    """

    def __init__(self, port: int, origins: Sequence[str] = ()) -> None:
        self.token = os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(24)
        if len(self.token) < _LEAST_TOKEN or self.token.strip(_TOKEN_CHARACTERS):
            raise ConfigError(f'{TOKEN_VARIABLE}: valid are {_LEAST_TOKEN} or more letters, '
                              'digits, - and _')
        for origin in origins:
            parts = urlsplit(origin)
            if not parts.scheme or origin != f'{parts.scheme}://{parts.netloc}':
                raise ConfigError(f'allow_origin: {origin!r} is not valid; valid is an origin '
                                  'such as https://app.foxglove.dev')
        self._hosts = f'localhost:{port}', f'{HOST}:{port}'
        self._origins = frozenset(origins)
        self.url = f'http://localhost:{port}/?token={self.token}'
        self.websocket_url = f'ws://localhost:{port}/?token={self.token}'

    def problem(self, target: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """Return in a line why a request must not be answered; '' where it may.

        Args:
            target: Path and query of the request.
            hosts: All its Host headers.
            origins: All its Origin headers; none without a browser.
        """
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return f'Host {", ".join(hosts)!r} is not {" or ".join(self._hosts)}'
        if len(origins) > 1 or not all(
                origin == f'http://{hosts[0]}' or origin in self._origins for origin in origins):
            return f'Origin {", ".join(origins)!r} is another page; allow it with --allow-origin'
        given = parse_qs(urlsplit(target).query).get('token', [''])[0]
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            return 'the token is missing or wrong; open the address that was printed'
        return ''

    def page(self, path: str, extra: Extra) -> tuple[HTTPStatus, str, bytes]:
        """Return status, type and content of what is served at a path."""
        if path in _FILES:
            folder = resources.files('lunar_rover_sim.run') / 'templates'
            body = (folder / _FILES[path]).read_bytes()
            kind = _FILES[path].rpartition('.')[2]
            return HTTPStatus.OK, _TYPES[kind], body.replace(b'TOKEN', self.token.encode()) \
                if kind == 'html' else body
        if path in extra and (found := extra[path]()) is not None:
            return HTTPStatus.OK, _TYPES[path.rpartition('.')[2]], found
        return HTTPStatus.NOT_FOUND, 'text/plain', b''


_TOKEN_CHARACTERS = 'ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_'
_MAP_PX = 1000
_ROCKS = 2000       # the largest ones are on the map


class MapPages:
    """What the page asks for its map of a window, which may change.

    Attributes:
        extra: The paths.
    """

    def __init__(self, world: World | None,
                 drivers: Callable[[], Sequence[str]] = lambda: ()) -> None:
        """Show a window.

        Args:
            world: Of the map; None: there is none.
            drivers: Returns who drives, so that the page must not.
        """
        self._facts: dict[str, Any] = {}
        self._world: World | None = None
        self._picture: bytes | None = None
        self.extra: Extra = {
            '/live.json': lambda: json.dumps({**self._facts, 'drivers': list(drivers())}).encode(),
            '/map.png': lambda: self._picture}
        if world is not None:
            self.show(world)

    def show(self, world: World) -> None:
        """Show another window of the site from now on."""
        if world is self._world:
            return
        self._world = world
        self._picture = png_bytes(world.relief_picture(_MAP_PX))
        self._facts = _facts_of(world)


def _facts_of(world: World) -> dict[str, Any]:
    """Return middle and half of the width of the map, and (x, y, radius) of rocks [m]."""
    rocks = world.rocks
    radius_m = 0.5 * rocks.size_classes_m[rocks.size]
    largest = np.argsort(-radius_m, kind='stable')[:_ROCKS]
    shown = np.column_stack([rocks.position_m[largest, :2], radius_m[largest]])
    return {'half_extent_m': world.ground.half_extent_m, 'middle_m': world.ground.middle_m,
            'rocks': shown.round(3).tolist()}
