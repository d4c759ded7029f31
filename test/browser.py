"""A page in headless Chromium, over its DevTools protocol."""

import base64
from collections.abc import Iterator
import contextlib
import itertools
import json
from pathlib import Path
import re
import shutil
import subprocess
from typing import Any
import urllib.request

from waiting import LIMIT_S
from websockets.sync.client import ClientConnection, connect

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which(
    'google-chrome')
# Nothing but the page: no look-ups of its own, and software alone draws.
_FLAGS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
          '--disable-background-networking', '--disable-component-update', '--disable-sync',
          '--disable-dev-shm-usage', '--remote-debugging-port=0', '--window-size=1000,1000')


class Page:
    """The only tab of a browser."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection, self._numbers = connection, itertools.count(1)
        self.errors: list[str] = []     # what the page's scripts threw
        self._ask('Runtime.enable')

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._connection.send(json.dumps({'id': number, 'method': method, 'params': parameters}))
        while True:
            answer = json.loads(self._connection.recv(timeout=LIMIT_S))
            if answer.get('method') == 'Runtime.exceptionThrown':
                self.errors.append(json.dumps(answer['params']['exceptionDetails']))
            if answer.get('id') == number:
                assert 'error' not in answer, answer
                return dict(answer['result'])

    def open(self, url: str) -> None:
        """Go to a page."""
        self._ask('Page.navigate', url=url)

    def value(self, expression: str) -> Any:
        """Return the value of an expression of JavaScript; None where it cannot be evaluated."""
        found = self._ask('Runtime.evaluate', expression=expression, returnByValue=True,
                          awaitPromise=True)
        return None if 'exceptionDetails' in found else found['result'].get('value')

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Press ('mousePressed'), release or move ('mouseMoved') the left button."""
        self._ask('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', buttons=1,
                  clickCount=1)

    def picture(self, path: Path) -> None:
        """Write what is seen as PNG."""
        path.write_bytes(base64.b64decode(self._ask('Page.captureScreenshot')['data']))


@contextlib.contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """Start Chromium with a new profile in a folder."""
    assert CHROMIUM is not None
    with subprocess.Popen([CHROMIUM, *_FLAGS, f'--user-data-dir={folder}', 'about:blank'],
                          stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
                          text=True) as process:
        try:
            assert process.stderr is not None
            address = next(found for line in process.stderr
                           if (found := re.search(r'listening on ws://(\S+?)/', line)))[1]
            with urllib.request.urlopen(f'http://{address}/json', timeout=LIMIT_S) as answer:
                tab = next(one for one in json.load(answer) if one['type'] == 'page')
            with connect(tab['webSocketDebuggerUrl'], max_size=None) as connection:
                yield Page(connection)
        finally:
            process.terminate()
            process.stderr.close()
