"""A bag in the live view, at the pace of its stamps: no ROS is needed to look at it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import threading
import time

from rosbags.interfaces import QosDurability

from lunar_rover_sim.bag.reader import Bag, open_bag, RawMessage
from lunar_rover_sim.bag.totals import simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError
from lunar_rover_sim.run.live_page import Access, MapPages
from lunar_rover_sim.run.live_view import Control, LiveView
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.transforms import tf_of_odometry, transforms_of

_TOLD_S = 0.2               # of wall time between two calls of on_time
_BEFORE_NS = 1_000_000_000  # what is older than this is not shown after a jump, unless latched


def replay(path: Path, port: int, speed: float = 1.0, world: Path | None = None,
           on_time: Callable[[float], None] = lambda now_s: None,
           on_start: Callable[[Access], None] = lambda access: None,
           origins: Sequence[str] = ()) -> None:
    """Serve a bag over and over; it begins when a client watches, who may pause it and seek.

    Args:
        path: Folder of the bag.
        port: Of the page and the websocket.
        speed: Simulated seconds per second.
        world: Folder of its world, where that is not beside the bag or in the cache.
        on_time: Called with the simulated time [s] as it goes on.
        on_start: Called with the address as soon as it can be opened.
        origins: Of other pages that may connect.

    Raises:
        BagError: The bag cannot be read, or holds nothing.
        ConfigError: The port is taken, or websockets is missing.
        WorldError: `world` is given and is not the one of the bag.
    """
    with open_bag(path) as bag, open_bag(path) as looked_up:
        if not bag.message_count:
            raise BagError(f'{path}: holds no message')
        driven = RecordedRun(bag).driven(world)
        pages = MapPages(None if driven is None else driven.at(bag.start_ns))

        def show(time_s: float) -> None:
            if driven is not None:
                pages.show(driven.at(round(1e9 * time_s)))
            on_time(time_s)

        player = _Player(bag, looked_up, speed, show)
        with LiveView(port, player.note_watched, pages=pages.extra, origins=origins,
                      recording=(bag.start_ns, player.end_ns), on_control=player.ask) as view:
            on_start(view.access)
            player.play(view)


class _Player:
    """Plays a bag. Threads of the server say what clients want; `play` does it.

    Args:
        bag: What is played.
        looked_up: The same bag, opened once more to look for single messages.
        speed: Simulated seconds per second.
        on_time: As in `replay`.
    """

    def __init__(self, bag: Bag, looked_up: Bag, speed: float,
                 on_time: Callable[[float], None]) -> None:
        self.end_ns = simulated_end_ns(bag) or bag.end_ns
        self._bag, self._looked_up, self._on_time = bag, looked_up, on_time
        self._latched = {c.topic for c in bag.connections if any(
            qos.durability == QosDurability.TRANSIENT_LOCAL
            for qos in getattr(c.ext, 'offered_qos_profiles', ()))}
        self._made: dict[str, str] = {}     # tf topics by the topics of odometry they are made of
        self._control = Control(True, speed)
        self._now_ns = bag.start_ns
        self._from = 0.0, bag.start_ns      # wall time [s] and time of the bag [ns]
        self._told_s = 0.0
        self._changed = threading.Condition()
        self._asked: list[Control] = []
        self._watched: set[str] = set()     # since the last look

    def ask(self, control: Control) -> None:
        """Do what a client wants, soon."""
        with self._changed:
            self._asked.append(control)
            self._changed.notify()

    def note_watched(self, topic: str) -> None:
        """Note that a client has begun to watch a topic."""
        with self._changed:
            self._watched.add(topic)
            self._changed.notify()

    def play(self, view: LiveView) -> None:
        """Play over and over."""
        for topic, msgtype in self._bag.types.items():
            view.offer(topic, msgtype)
        self._made = {topic: name for topic in self._bag.types if (name := transforms_of(topic))
                      and name not in self._bag.types and view.offer(name, topics.TF.type)}
        view.tell_playback(self._control, self._now_ns, False)
        while True:
            with self._changed:
                self._changed.wait_for(view.watched)
            self._from = time.monotonic(), self._now_ns
            if self._to_end(view):
                self._now_ns = self._bag.start_ns
                view.tell_playback(self._control, self._now_ns, True)

    def _to_end(self, view: LiveView) -> bool:
        """Play from here; return False where a client has gone elsewhere."""
        for message in self._bag.raw(start_ns=self._now_ns, stop_ns=self.end_ns + 1):
            if not self._wait(view, message.time_ns):
                return False
            self._now_ns = message.time_ns
            view.tell_time(message.time_ns)
            self._send(view, message)
            if time.monotonic() - self._told_s > _TOLD_S:
                self._told_s = time.monotonic()
                self._on_time(1e-9 * message.time_ns)
        return True

    def _wait(self, view: LiveView, time_ns: int) -> bool:
        """Wait until a message is due, and do what clients want; return False after a jump."""
        while True:
            with self._changed:
                left_s = None
                if self._control.playing:
                    left_s = self._from[0] - time.monotonic() + \
                        1e-9 * (time_ns - self._from[1]) / self._control.speed
                if not self._asked and not self._watched and (left_s is None or left_s > 0.0):
                    self._changed.wait(left_s)
                asked, self._asked = self._asked, []
                watched, self._watched = self._watched, set()
            for control in asked:
                self._control = control
                if control.seek_ns is not None:
                    self._now_ns = control.seek_ns
                self._from = time.monotonic(), self._now_ns
                view.tell_playback(control, self._now_ns, control.seek_ns is not None)
            if any(control.seek_ns is not None for control in asked):
                self._show(view, view.watched())
                return False
            if watched:
                self._show(view, watched)
            if not asked and left_s is not None and left_s <= 0.0:
                return True

    def _show(self, view: LiveView, watched: set[str]) -> None:
        """Send what is known of topics at the present time."""
        sources = {next((topic for topic, made in self._made.items() if made == name), name)
                   for name in watched}
        newest: dict[str, RawMessage] = {}
        for names, begin_ns in ((sources & self._latched, None),
                                (sources - self._latched, self._now_ns - _BEFORE_NS)):
            if names:
                for message in self._looked_up.raw(names, begin_ns, self._now_ns + 1):
                    newest[message.topic] = message
        for message in sorted(newest.values(), key=lambda message: message.time_ns):
            self._send(view, message)

    def _send(self, view: LiveView, message: RawMessage) -> None:
        view.send(message.topic, message.time_ns, message.data)
        if message.topic in self._made:
            view.send(self._made[message.topic], message.time_ns,
                      tf_of_odometry(message.data))
