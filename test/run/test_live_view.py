"""The live view: real bytes over a real socket."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import socket
import time

import pytest
from waiting import wait_until

pytest.importorskip('foxglove')
from view_client import client, free_port  # noqa: E402  (needs the extra)

from lunar_rover_sim.cli.main import main  # noqa: E402
from lunar_rover_sim.errors import ConfigError, GraphError  # noqa: E402
from lunar_rover_sim.run.live_view import check_view, LiveView, ViewProcess  # noqa: E402
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


def test_a_refused_request_is_not_the_end() -> None:
    """The SDK refuses a client that asks too early; its topic is offered again, to be asked."""
    port = free_port()
    with LiveView(port) as view:
        view.offer('/odom', ODOM)
        with client(port) as one:
            early = one.find('/odom')['id'] + 1
            one.subscribe_channel(early)
            assert one.refusal() == f'Unknown channel ID: {early}'
            view.offer('/left', IMAGE)
            assert one.find('/left')['id'] == early
            del one.channels['/left']
            view.offer_again()
            assert one.find('/left')['id'] != early
            one.subscribe('/left', 8)
            wait_until(lambda: view.watched() == {'/left'})
            view.send('/left', 5, b'an image')
            assert one.message() == (8, 5, b'an image')
            view.offer_again()      # only once
            view.send('/left', 6, b'the next')
            assert one.message() == (8, 6, b'the next')


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
    found = re.search('Lichtblick .*, layout (.*lunar_rover.json)', written.out)
    assert found and Path(found[1]).is_absolute() and Path(found[1]).is_file()
