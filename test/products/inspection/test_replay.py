"""A bag played to a client of the live view."""

from collections.abc import Iterator
import contextlib
from pathlib import Path
import threading
import time

import pytest
import synthetic_bag

pytest.importorskip('websockets')
import browser  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from view_client import Client, client, free_port, TOKEN  # noqa: E402  (needs the extra)
from waiting import wait_until  # noqa: E402

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.products.inspection.replay import replay  # noqa: E402


@contextlib.contextmanager
def played(path: Path) -> Iterator[Client]:
    """Play a bag in a thread until the end of the block; give a client, which has a port."""
    port, ended = free_port(), threading.Event()

    def on_time(now_s: float) -> None:
        if ended.is_set():
            raise StopIteration     # it would go on over and over

    def play() -> None:
        with contextlib.suppress(StopIteration):
            replay(path, port, on_time=on_time)
    player = threading.Thread(target=play, daemon=True)
    player.start()
    with client(port) as one:
        yield one
        ended.set()
        one.control(True)
        player.join(30)
    assert not player.is_alive()


def test_a_bag_is_played_with_transforms(tmp_path: Path) -> None:
    """A client gets each odometry with its stamp, and the tf that the bag lacks."""
    items = synthetic_bag.drive(0.5, only=[topics.ODOM, topics.WORLD_HASH])
    path = synthetic_bag.write(tmp_path / 'bag', items)
    with played(path) as one:
        assert one.told('serverInfo')['capabilities'] == ['time', 'playbackControl']
        one.subscribe('/tf', 8)
        one.subscribe('/odom', 7)
        with open_bag(path) as bag:
            poses = {message.time_ns: message.data for message in bag.raw(['/odom'])}
        store, last_ns = get_typestore(Stores.ROS2_JAZZY), -1
        for number, time_ns, data in (one.message() for _ in range(40)):
            assert time_ns >= last_ns
            last_ns = time_ns
            if number == 7:
                assert data == poses[time_ns]
            else:
                (transform,) = store.deserialize_cdr(data, topics.TF.type).transforms
                assert transform.child_frame_id == 'base_link'


def test_a_recording_pauses_and_seeks(tmp_path: Path) -> None:
    """Paused it stands still, elsewhere it shows what was there, and latched topics at once."""
    items = synthetic_bag.drive(4.0, only=[topics.ODOM, topics.WORLD_HASH])
    with played(synthetic_bag.write(tmp_path / 'bag', items)) as one:
        info = one.told('serverInfo')
        assert info['dataEndTime'] == {'sec': 4, 'nsec': 0}
        one.subscribe('/odom')
        one.message()
        one.control(False)
        while one.playback()[0]:
            pass
        one.silent(0.3)
        one.control(False, 3_000_000_000)
        assert one.playback() == (False, 3_000_000_000, True)
        assert one.message()[1] == 3_000_000_000
        one.silent(0.3)
        one.subscribe('/world_hash', 8)         # a topic that was sent once, at the beginning
        number, stamp_ns, _ = one.message()
        assert number == 8 and stamp_ns < 3_000_000_000
        for beyond_ns, reached_ns in ((99_000_000_000, 4_000_000_000), (0, 0)):
            one.control(False, beyond_ns)
            assert one.playback()[1] == reached_ns
        one.control(True, 2_000_000_000, speed=0.5)
        assert one.playback() == (True, 2_000_000_000, True)
        begun_s = time.monotonic()
        while one.message()[1] < 2_300_000_000:
            pass
        assert time.monotonic() - begun_s > 0.5     # half as fast


@pytest.mark.skipif(browser.CHROMIUM is None, reason='there is no Chromium')
def test_the_page_of_a_recording_has_a_time_line(tmp_path: Path) -> None:
    """No stick; it pauses, seeks, and begins anew without an error."""
    items = synthetic_bag.drive(1.0, only=[topics.ODOM, topics.WORLD_HASH])
    path = synthetic_bag.write(tmp_path / 'bag', items)
    with played(path) as one, browser.browser(tmp_path / 'profile') as page:
        page.open(f'http://localhost:{one.port}/?token={TOKEN}')
        wait_until(lambda: page.value('recording !== null && nowS > 0.5'))
        wait_until(lambda: page.value('nowS < 0.4'))        # it has begun anew
        wait_until(lambda: page.value("nowS > 0.1 && series['pitch, roll [deg]'] !== undefined"))
        assert page.value("[element('driving').hidden, element('player').hidden, drivable]"
                          ) == [True, False, False]
        page.value("element('play').click()")
        wait_until(lambda: page.value("element('play').textContent") == 'play')
        page.value("element('seek').value = 0.75; "
                   "element('seek').dispatchEvent(new Event('input'))")
        wait_until(lambda: page.value('pose !== null && pose.stampS') == 0.75)
        time.sleep(0.3)
        assert page.value("[nowS, pose.stampS, element('time').textContent]") == [
            0.75, 0.75, '0.75 s']
        assert not page.errors
