"""A bag in the live view, at the pace of its stamps: no ROS is needed to look at it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import time

from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.totals import simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.run.live_page import map_pages
from lunar_rover_sim.run.live_view import LiveView
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.transforms import OdometryTransforms, transforms_of

_POLL_S = 0.1
_STEP_S = 0.2       # topics that were refused are offered again so often


def replay(path: Path, port: int, speed: float = 1.0, world: Path | None = None,
           on_time: Callable[[float], None] = lambda now_s: None) -> None:
    """Serve a bag over and over; it begins when a client watches.

    Args:
        path: Folder of the bag.
        port: Of the page and the websocket.
        speed: Simulated seconds per second.
        world: Folder of its world, where that is not beside the bag or in the cache.
        on_time: Called with the simulated time [s] as it goes on.

    Raises:
        BagError: The bag cannot be read, or holds nothing.
        ConfigError: The port is taken, or foxglove-sdk is missing.
        WorldError: `world` is given and is not the one of the bag.
    """
    with open_bag(path) as bag:
        end_ns = simulated_end_ns(bag) or bag.end_ns
        if not bag.message_count:
            raise BagError(f'{path}: holds no message')
        pages = map_pages(RecordedRun(bag).world(world), lambda: [f'the bag {path.name}'])
        with LiveView(port, pages=pages) as view:
            for topic, msgtype in bag.types.items():
                view.offer(topic, msgtype)
            while True:
                _once(bag, view, speed, end_ns, on_time)


def _once(bag: Bag, view: LiveView, speed: float, end_ns: int,
          on_time: Callable[[float], None]) -> None:
    transforms = OdometryTransforms()
    made = {topic: name for topic in bag.types if (name := transforms_of(topic))
            and name not in bag.types and view.offer(name, topics.TF.type)}
    while not view.watched():
        view.offer_again()
        time.sleep(_POLL_S)
    begun_s, offered_s = time.monotonic(), 0.0
    for message in bag.raw():
        if message.time_ns > end_ns:
            break
        due_s = begun_s + 1e-9 * (message.time_ns - bag.start_ns) / speed
        now_s = time.monotonic()
        if due_s > now_s:
            time.sleep(due_s - now_s)
        if now_s - offered_s > _STEP_S:
            offered_s = now_s
            view.offer_again()
            on_time(1e-9 * message.time_ns)
        view.tell_time(message.time_ns)
        view.send(message.topic, message.time_ns, message.data)
        if message.topic in made:
            view.send(made[message.topic], message.time_ns, transforms.of(message.data))
