"""A bag played to a client of the live view."""

import contextlib
from pathlib import Path
import threading

import pytest
import synthetic_bag

pytest.importorskip('foxglove')
from rosbags.typesys import get_typestore, Stores  # noqa: E402
from view_client import client, free_port  # noqa: E402  (needs the extra)

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.products.inspection.replay import replay  # noqa: E402


def test_a_bag_is_played_with_transforms(tmp_path: Path) -> None:
    """A client gets each odometry with its stamp, and the tf that the bag lacks."""
    items = synthetic_bag.drive(0.5, only=[topics.ODOM, topics.WORLD_HASH])
    path = synthetic_bag.write(tmp_path / 'bag', items)
    port, times, seen = free_port(), list[float](), threading.Event()

    def on_time(now_s: float) -> None:
        times.append(now_s)
        if seen.is_set():
            raise StopIteration     # it would go on over and over

    def play() -> None:
        with contextlib.suppress(StopIteration):
            replay(path, port, on_time=on_time)
    player = threading.Thread(target=play, daemon=True)
    player.start()
    with client(port) as one:
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
        seen.set()
        player.join(30)
    assert times and not player.is_alive()
