"""The live view: real bytes over a real socket, and its page in a browser."""

from collections.abc import Callable, Iterator
import contextlib
import http.client
import json
from pathlib import Path
import re
import socket
import struct
import time
from typing import Any

import numpy as np
import pytest
from waiting import LIMIT_S, wait_until

pytest.importorskip('websockets')
import browser  # noqa: E402  (needs the extra)
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from view_client import client, free_port, TOKEN  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402

from lunar_rover_sim.base.errors import ConfigError, GraphError  # noqa: E402
from lunar_rover_sim.cli.main import main  # noqa: E402
from lunar_rover_sim.image.camera.encoding import ENCODINGS  # noqa: E402
from lunar_rover_sim.run.live_page import Access, TOKEN_VARIABLE  # noqa: E402
from lunar_rover_sim.run.live_view import check_view, LiveView, TWIST, ViewProcess  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

IMAGE, ODOM = 'sensor_msgs/msg/Image', 'nav_msgs/msg/Odometry'


def test_bytes_arrive() -> None:
    """Topics are offered with their definitions; what is watched arrives, with its time."""
    begun: list[str] = []
    port = free_port()
    with LiveView(port, begun.append) as view:
        assert view.offer('/odom', ODOM) and view.offer('/left', IMAGE)
        assert not view.offer('/other', 'my_msgs/msg/Unknown')
        assert view.watched() == set()
        with client(port) as one:
            channel = one.find('/odom')
            assert (channel['encoding'], channel['schemaEncoding']) == ('cdr', 'ros2msg')
            assert channel['schemaName'] == ODOM
            assert 'geometry_msgs/PoseWithCovariance pose' in channel['schema']
            one.subscribe('/odom')
            wait_until(lambda: view.watched() == {'/odom'})
            assert begun == ['/odom']
            view.send('/left', 5, b'nobody wants it')
            view.send('/odom', 123456789, b'\x00\x01\x00\x00 and so on')
            assert one.message() == (7, 123456789, b'\x00\x01\x00\x00 and so on')
        wait_until(lambda: not view.watched())


def test_slow_client() -> None:
    """A client that does not read holds nobody up: what it misses is dropped."""
    port = free_port()
    with LiveView(port) as view:
        view.offer('/left', IMAGE)
        with client(port) as lazy, client(port) as busy:
            lazy.subscribe('/left')
            busy.subscribe('/left')
            wait_until(lambda: view.watched() == {'/left'})
            time.sleep(0.2)
            image = bytes(1_000_000)
            start_s = time.process_time()
            for k in range(300):
                view.send('/left', k, image)
            # 300 MB do not fit into the buffers of a socket: it must have dropped some.
            assert time.process_time() - start_s < 5.0
            newest = -1
            while newest < 299:
                newest = busy.message()[1]


def test_clients_are_told_the_time() -> None:
    """Simulated time, and not each of many times: viewers draw anew at each."""
    port = free_port()
    with LiveView(port) as view:
        view.offer('/odom', ODOM)
        with client(port) as one:
            one.subscribe('/odom')
            wait_until(lambda: view.watched() == {'/odom'})
            for k in range(50):
                view.tell_time(1_000_000_000 + k)
            time.sleep(0.1)
            view.tell_time(2_000_000_000)
            told = [one.time_ns()]
            while told[-1] < 2_000_000_000:
                told.append(one.time_ns())
            assert told[0] == 1_000_000_000 and len(told) < 20


def test_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A port that is taken and a missing package are told in one line, before anything runs."""
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f'port: {port} cannot be served'):
            LiveView(port)
        with pytest.raises(ConfigError, match=f'^--view: {port} cannot be served'):
            check_view(port, '--view')
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install '.\[view\]' in a clone"):
        LiveView(free_port())


def test_run_names_the_layout_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
                                          capsys: pytest.CaptureFixture[str]) -> None:
    """Its full path, which also leads from another folder than a clone to the file."""
    def start(scenario: Scenario, *_: object, on_start: Callable[[Scenario, int], None],
              **__: object) -> None:
        on_start(scenario, 7)
        raise GraphError('far enough')

    for name, instead in (('require_ros', lambda: None), ('record', start)):
        monkeypatch.setattr(f'lunar_rover_sim.cli.run.{name}', instead)
    monkeypatch.setattr(ViewProcess, 'start', lambda *_: None)
    monkeypatch.chdir(tmp_path)
    assert main(['run', 'flat', '--world', 'any', '--view', str(free_port()), '-o', 'out']) == 1
    written = capsys.readouterr()
    assert 'far enough' in written.err
    found = re.search('layout: (.*lunar_rover.json)', written.out)
    assert found and Path(found[1]).is_absolute() and Path(found[1]).is_file()


STORE = get_typestore(Stores.ROS2_JAZZY)
FACTS = {'drivers': [], 'half_extent_m': 25.6, 'rocks': [[1.0, 0.5, 0.2]]}


def made(kind: str, **fields: Any) -> Any:
    """Return a message of a package and name, its other fields zero."""
    cls = STORE.types[kind]
    zeros: dict[str, Any] = {'string': '', 'uint32': 0, 'uint8': 0, 'int32': 0, 'float64': 0.0}
    for name, (node, value) in STORE.fielddefs[kind][1]:
        if name not in fields:
            base = value[0] if node == 1 else value
            fields[name] = np.zeros(36) if node == 3 else \
                zeros[base] if base in zeros else made(base)
    return cls(**fields)


def odometry(x_m: float) -> bytes:
    """Return odometry at a place, pitched by 0.1 rad."""
    message = made(ODOM, child_frame_id='base_link')
    message.pose.pose.position.x = x_m
    message.pose.pose.orientation.y, message.pose.pose.orientation.w = np.sin(0.05), np.cos(0.05)
    return bytes(STORE.serialize_cdr(message, ODOM))


def image() -> bytes:
    """Return an image of 4 x 2 px whose third pixel is bright."""
    return bytes(STORE.serialize_cdr(made(
        IMAGE, height=2, width=4, step=4, encoding='mono8',
        data=np.array([0, 0, 200, 0, 0, 0, 0, 0], np.uint8)), IMAGE))


class Served:
    """A view without a graph, and what its clients have driven."""

    def __init__(self) -> None:
        self.port, self.driven, self.facts = free_port(), [], dict(FACTS)

    def answer(self, path: str) -> http.client.HTTPResponse:
        """Ask for a path over HTTP."""
        connection = http.client.HTTPConnection('127.0.0.1', self.port, timeout=LIMIT_S)
        connection.request('GET', f'{path}?token={TOKEN}')
        return connection.getresponse()


@pytest.fixture(name='served')
def _served() -> Iterator[tuple[Served, LiveView]]:
    served = Served()
    pages = {'/live.json': lambda: json.dumps(served.facts).encode(), '/map.png': lambda: None}
    with LiveView(served.port, on_drive=lambda topic, data: served.driven.append((topic, data)),
                  pages=pages) as view:
        yield served, view


def test_the_port_of_the_websocket_serves_the_page(served: tuple[Served, LiveView]) -> None:
    """A page, its scripts, and facts; what there is not is a 404."""
    one, _ = served
    page = one.answer('/')
    assert page.status == 200 and page.headers['Content-Type'].startswith('text/html')
    text = page.read().decode()
    for script in ('cdr.js', 'live.js'):
        assert f'src="{script}?token={TOKEN}"' in text
        assert one.answer(f'/{script}').read()
    assert json.loads(one.answer('/live.json').read()) == FACTS
    for path in ('/map.png', '/nothing', '/../live_page.py', '/live.html/..'):
        assert one.answer(path).status == 404


def test_only_velocities_are_taken(served: tuple[Served, LiveView]) -> None:
    """A client publishes a Twist in CDR; other types that it offers go nowhere."""
    one, _ = served
    twist = b'\x00\x01\x00\x00' + struct.pack('<6d', 0.1, 0, 0, 0, 0, 0.2)
    with client(one.port) as sender:
        sender.drive('/goal', twist, 'geometry_msgs/msg/PoseStamped')
        sender.drive('/cmd_vel', twist)
        wait_until(lambda: one.driven)
    assert one.driven == [('/cmd_vel', twist)]


STRANGERS = {
    'another page': ('', {'Origin': 'https://evil.example'}),
    'another page that knows the token': (f'?token={TOKEN}', {'Origin': 'https://evil.example'}),
    'a page on another port of this machine': (f'?token={TOKEN}',
                                               {'Origin': 'http://localhost:1'}),
    'a page without an origin': (f'?token={TOKEN}', {'Origin': 'null'}),
    'a name that leads here': (f'?token={TOKEN}', {'Host': 'evil.example:{port}'}),
    'a name that leads here, of one origin': (f'?token={TOKEN}', {
        'Host': 'evil.example:{port}', 'Origin': 'http://evil.example:{port}'}),
    'a program without the token': ('', {}),
    'a program with a wrong token': (f'?token={TOKEN[:-1]}', {}),
    'a page of ours without the token': ('', {'Origin': 'http://localhost:{port}'}),
}


@pytest.mark.parametrize('stranger', STRANGERS)
def test_strangers_neither_see_nor_drive(served: tuple[Served, LiveView], stranger: str) -> None:
    """They get no file, no topic, no image, and their Twists go nowhere."""
    one, view = served
    view.offer('/stereo/left/image_raw', IMAGE)
    query, headers = STRANGERS[stranger]
    lines = {'Host': f'localhost:{one.port}', **{
        name: value.format(port=one.port) for name, value in headers.items()}}
    for upgrade in (False, True):
        for path in ('/', '/live.js', '/live.json', '/map.png'):
            extra = {'Connection': 'Upgrade', 'Upgrade': 'websocket', 'Sec-WebSocket-Version': 13,
                     'Sec-WebSocket-Key': 'MTIzNDU2Nzg5MDEyMzQ1Ng=='} if upgrade else {}
            with socket.create_connection(('127.0.0.1', one.port), LIMIT_S) as plain:
                plain.sendall('\r\n'.join([f'GET {path}{query} HTTP/1.1', *(
                    f'{name}: {value}' for name, value in {**lines, **extra}.items()),
                    '', '']).encode())
                plain.sendall(ADVERTISED + DRIVEN)
                answer = b''
                with contextlib.suppress(ConnectionError):
                    while piece := plain.recv(4096):
                        answer += piece
            assert answer.startswith(b'HTTP/1.1 403'), (path, upgrade)
            assert b'image_raw' not in answer and b'lunar_rover_sim' in answer
    assert not one.driven and not view.watched()


def frame(kind: int, data: bytes) -> bytes:
    """Return a message of a client as it is on the wire, masked with zeros."""
    return struct.pack('>BBH', 0x80 | kind, 0xFE, len(data)) + bytes(4) + data


ADVERTISED = frame(1, json.dumps({'op': 'advertise', 'channels': [
    {'id': 1, 'topic': '/cmd_vel', 'encoding': 'cdr', 'schemaName': TWIST}],
    'padding': ' ' * 126}).encode())
DRIVEN = frame(2, struct.pack('<BI', 1, 1) + bytes(4 + 48 + 100))


def test_friends_see_and_drive(served: tuple[Served, LiveView]) -> None:
    """The printed address, from its own page and from a program; another page that is named."""
    one, _ = served
    for name in ('localhost', '127.0.0.1'):
        for origin in (None, f'http://{name}:{one.port}'):
            with client(one.port, host=name, origin=origin) as friend:
                friend.drive('/cmd_vel', bytes(52))
                wait_until(lambda: one.driven)
            one.driven.clear()
    port = free_port()
    with LiveView(port, origins=['https://app.foxglove.dev']) as view:
        view.offer('/odom', ODOM)
        with client(port, origin='https://app.foxglove.dev') as viewer:
            assert viewer.find('/odom')
        with pytest.raises(InvalidStatus), client(port, origin='https://evil.example'):
            pass
    for wrong in ('https://app.foxglove.dev/', '*', 'localhost'):
        with pytest.raises(ConfigError, match='^allow_origin: '):
            LiveView(free_port(), origins=[wrong])


def test_tokens_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each view has a new one, unless the environment has one that cannot be guessed."""
    monkeypatch.delenv(TOKEN_VARIABLE)
    first, second = Access(8765), Access(8765)
    assert first.token != second.token and len(first.token) > 20 and first.token in first.url
    for short in ('secret', '<script>alert(1)</script>'):
        monkeypatch.setenv(TOKEN_VARIABLE, short)
        with pytest.raises(ConfigError, match=f'^{TOKEN_VARIABLE}: '):
            Access(8765)


@pytest.mark.parametrize('data', [
    '', '[' * 60_000, '{"op": 1}', '[]', b'', b'\x01', b'\x03', '{"op": "subscribe"}',
    '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
    '{"op": "subscribe", "subscriptions": [{"id": 4294967296, "channelId": 1}]}',
    '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": {}}]}',
    b'\x03\x00\x00\x00\x80\x7f' + bytes(13)])
def test_nonsense_harms_nobody(served: tuple[Served, LiveView], data: str | bytes) -> None:
    """A client that says it is told so or thrown out; others see what they saw."""
    one, view = served
    view.offer('/odom', ODOM)
    with client(one.port) as good, client(one.port) as bad:
        good.subscribe('/odom')
        bad.find('/odom')
        bad.send(data)
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            bad._connection.recv(timeout=0.3)
        wait_until(lambda: view.watched() == {'/odom'})
        view.send('/odom', 5, b'a pose')
        assert good.message() == (7, 5, b'a pose')


@pytest.mark.skipif(browser.CHROMIUM is None, reason='there is no Chromium')
def test_another_page_in_a_browser(served: tuple[Served, LiveView], tmp_path: Path) -> None:
    """A page of another origin neither opens the websocket nor reads a file, token or not."""
    one, _ = served
    with browser.browser(tmp_path / 'profile') as page:
        page.open('data:text/html,<title>evil</title>')
        for query in ('', f'?token={TOKEN}'):
            url = f'localhost:{one.port}/{query}'
            assert page.value(
                f"new Promise(done => {{ const s = new WebSocket('ws://{url}', "
                "['foxglove.sdk.v1']); s.onopen = () => done('open'); "
                "s.onerror = () => done('refused'); })") == 'refused'
            assert page.value(f"fetch('http://{url}').then(() => 'read', () => 'refused')"
                              ) == 'refused'


@pytest.mark.skipif(browser.CHROMIUM is None, reason='there is no Chromium')
def test_the_page_in_a_browser(served: tuple[Served, LiveView], tmp_path: Path) -> None:
    """It shows image, path and pitch; the stick drives while it is held, unless others drive."""
    one, view = served
    view.offer('/odom', ODOM)
    view.offer('/stereo/left/image_raw', IMAGE)
    with browser.browser(tmp_path / 'profile') as page:
        page.open(view.access.url)
        stamps = iter(range(0, 10**12, 50_000_000))

        def sends_until(expression: str) -> None:
            end_s = time.monotonic() + LIMIT_S
            while not page.value(expression):
                assert time.monotonic() < end_s, (expression, page.errors)
                stamp_ns = next(stamps)
                view.send('/odom', stamp_ns, odometry(1e-9 * stamp_ns))
                view.send('/stereo/left/image_raw', stamp_ns, image())

        sends_until('shown > 0 && path.length > 3 && pose.x > 0.1')
        assert page.value("[...element('camera').getContext('2d').getImageData(0, 0, 4, 1).data]"
                          ) == [0, 0, 0, 255, 0, 0, 0, 255, 200, 200, 200, 255, 0, 0, 0, 255]
        assert page.value("element('topics').value") == '/stereo/left/image_raw'
        pitch = page.value("series['pitch, roll [deg]'].pitch.at(-1)[1]")
        assert pitch == pytest.approx(np.degrees(0.1))
        sends_until("element('scale').textContent.includes('rocks brown')")
        left, top, size, _ = page.value(
            "(b => [b.left, b.top, b.width, b.height])(element('pad').getBoundingClientRect())")
        page.mouse('mousePressed', left + 0.5 * size, top + 0.05 * size)
        wait_until(lambda: len(one.driven) > 3)
        topic, data = one.driven[-1]
        ahead, *_, turn = struct.unpack('<6d', data[4:])
        assert topic == '/cmd_vel' and ahead == pytest.approx(0.18, abs=0.01)
        assert turn == pytest.approx(0.0, abs=0.01)
        page.mouse('mouseReleased', left + 0.5 * size, top + 0.05 * size)
        wait_until(lambda: not any(struct.unpack('<6d', one.driven[-1][1][4:])))    # it stops
        one.facts['drivers'] = ['drive_node']
        sends_until("element('drive').textContent.startsWith('drive_node publishes')")
        count = len(one.driven)
        page.mouse('mousePressed', left + 0.5 * size, top + 0.05 * size)
        time.sleep(0.5)
        assert len(one.driven) == count
        assert not page.errors


@pytest.mark.skipif(browser.CHROMIUM is None, reason='there is no Chromium')
def test_the_page_shows_images_of_each_encoding(served: tuple[Served, LiveView],
                                                tmp_path: Path) -> None:
    """A cell of a mosaic has red and green in its upper row, green and blue in its lower one."""
    _, view = served
    cells = np.array([[10, 20, 30, 40], [50, 60, 70, 80]], np.uint8)
    coloured = [[10, 20, 60, 255]] * 2 + [[30, 40, 80, 255]] * 2
    grey = [[value] * 3 + [255] for value in (10, 20, 30, 40)]
    with browser.browser(tmp_path / 'profile') as page:
        page.open(view.access.url)
        wait_until(lambda: page.value('typeof onImage') == 'function')
        for encoding in ENCODINGS:
            pixels = cells.astype('<u2') << 8 if encoding.endswith('16') else cells
            if encoding == 'rgb8':
                pixels = np.repeat(cells[..., None], 3, axis=-1)
            page.value(f"""onImage({{width: 4, height: 2, encoding: '{encoding}', is_bigendian: 0,
                step: {pixels.strides[0]}, data: new Uint8Array({list(pixels.tobytes())})}})""")
            row, below = (page.value("[...element('camera').getContext('2d')"
                                     f".getImageData(0, {y}, 4, 1).data]") for y in (0, 1))
            assert np.reshape(row, (4, 4)).tolist() == (
                coloured if encoding.startswith('bayer') else grey), encoding
            assert (below == row) == encoding.startswith('bayer')
        assert not page.errors
