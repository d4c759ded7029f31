"""recorder_node: topics to rosbag2, as serialised, with message stamps as bag time."""

from __future__ import annotations

import os
from pathlib import Path
import time
from typing import Any

from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Header, String

from lunar_rover_sim.bag import stamps
from lunar_rover_sim.bag.marker import why_short
from lunar_rover_sim.bag.recorded_scenario import scenario_of_text
from lunar_rover_sim.bag.totals import is_at_wall_time, RecordingPace
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.base.files.state_file import attributes
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.checkpoints import PHYSICS, saved_state
from lunar_rover_sim.nodes.diagnostics import Diagnostics, Drops, Rate, SubjectStatus
from lunar_rover_sim.nodes.message_types import definition_of, message_class
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare
from lunar_rover_sim.nodes.reader_discovery import UNKNOWN_NAME
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.lockstep import WrittenStamps
from lunar_rover_sim.run.node_config import ALL, RecorderNodeConfig
from lunar_rover_sim.run.publication import is_recorded

_GRAPH_NAMES = {topic.name: topic.graph_name for topic in topics.CONTRACT}
# A timer: rclpy has no event for a new topic. Listing the topics takes some milliseconds, so it is
# done often while topics appear, and seldom when none has appeared for a while.
_DISCOVERY_S, _SETTLED_S, _SETTLED_DISCOVERY_S = 0.05, 5.0, 0.5
_VELOCITIES = ('geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped')
# Stamps after simulated time by more than this are of another clock, as in the check of bags.
_LATEST_NS = 5 * NS_PER_S
# A bag that ends so long before its run is incomplete; without the clock, an image is the newest.
_CLOCK_S, _FRAMES_S = 1.1, 2.0
_FLOOD_LOOK_S, _MOST_HZ = 1.0, 2000     # lockstep at its fastest has 1000 states a second
_STANDSTILL_S = 3.0     # wall time without the clock, after which a recorder without a run says so


class RecorderNode(node_main.GraphNode):
    """Subscribes to the listed topics, or to all, as they appear; writes serialised messages.

    In a namespace `all` means its topics and /clock: those of other rovers stay out.
    """

    def __init__(self) -> None:
        super().__init__('recorder_node')
        self._config = config = declare(self, RecorderNodeConfig)
        if not config.output:
            raise ConfigError("output: '' is not valid; valid is a folder that does not exist")
        self._contract = {self._full(t.name): t for t in topics.CONTRACT}
        self._own = self.get_namespace().rstrip('/') + '/'
        self._all = ALL in config.topics
        self._listed = {self._full(name) for name in config.topics if name != ALL}
        self._excluded = set(map(self._full, config.exclude))
        self._written = WrittenStamps({self._full(name): ns for name, ns in
                                       config.period_ns_by_topic().items()})
        self._clock_name = self._full(topics.CLOCK.name)
        self._navigated_name = self._full(topics.NAVIGATED.name)
        self._jump = TimeJump(self)
        self._subscribed: set[str] = set()
        self._rate, self._drops, self._newest_told_ns = Rate(0.0), Drops(), -1
        self._newest_ns, self._pace = 0, RecordingPace()
        self._clock_ns = 0     # the latest, also of the time before a restart
        self._clock_s = time.monotonic()    # when it came
        self._stands_still = self._clock_left = False
        self._lately: dict[str, int] = {}   # topic → messages since the last look at them
        self._counted_s = time.monotonic()
        self._warned: set[str] = set()
        self._velocities: dict[str, str] = {}   # topic → type

        saved = saved_state(config, self.get_name())
        self._writer = BagWriter(
            Path(config.output), config.compression, os.environ.get('ROS_DISTRO') or 'jazzy',
            config.max_bag_size_mb * 1_000_000, bool(config.checkpoints),
            None if saved is None else {**saved[1]['bag'], 'time_ns': saved[0]})
        # Of a run that goes on: since when, and latched messages that nodes send once more.
        self._resumed_ns, self._repeated = 0, dict[str, int]()
        self._known = {name for name, count in self._writer.counts.items() if count}
        self._duration_s = 0.0      # of the run, if there is one; and its process
        self._runner: int | None = None
        if config.scenario_file:
            self._runner = os.getppid()
            self._listed.add(self._navigated_name)      # in any case: the run may end early then
            text = _read(config.scenario_file)
            scenario = scenario_of_text(text)
            self._duration_s = scenario.number('physics_node', 'duration_s', 0.0)
            self._scenario_publisher = qos.publisher(self, topics.SCENARIO)
            self._scenario_publisher.publish(String(data=text))
        # Others take this publisher for a sign that the recorder is there. So it is made when all
        # that is to be acknowledged, and what the participants publish, has been subscribed.
        self._publisher: Publisher | None = None
        self._sent_ns = 0
        self._needed = {name for name in map(self._full,
                                             (*config.acknowledge, *config.participants))
                        if self._is_wanted(name)}
        self._last_discovery_s = self._last_new_topic_s = time.monotonic()
        self.create_timer(_DISCOVERY_S, self._discover)
        Diagnostics(self, {'Message rate': self._rate_status, 'Drops': self._drops.status})
        self.report_ready(config, waits=config.topics)

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`: all others have written, and their readers have what they sent."""
        return begun.part(PHYSICS).exists()

    def state(self) -> dict[str, Any]:
        """See `GraphNode`; the present file of the bag ends here."""
        self._writer.split()
        return {'bag': self._writer.state(), **attributes(self, '_velocities', '_duration_s')}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._resumed_ns = self._newest_ns = self._clock_ns = self._sent_ns = time_ns
        self._written.restart(time_ns)
        self._jump.resume(time_ns)
        self._velocities, self._duration_s = state['_velocities'], state['_duration_s']

    def _is_repeated(self, name: str, type_name: str, raw: bytes) -> bool:
        """Return whether the bag holds a latched message already, from before it went on."""
        if not self._resumed_ns or name not in self._known:
            return False
        stamp = stamps.stamp_ns(type_name, raw)
        if stamp:
            return stamp <= self._resumed_ns
        # Each of its publishers sends one when it starts.
        left = self._repeated.setdefault(name, self.count_publishers(name))
        self._repeated[name] = left - 1
        return left > 0

    def close(self) -> None:
        """Finish the bag, which holds every message received.

        It stays marked where a run ended before its time, by Ctrl-C or since it was killed, and
        where a clock without a run stood still at the end, whose publisher has not left in order.
        """
        end_ns = max(self._clock_ns, self._newest_ns)
        incomplete = why_short(end_ns, self._duration_s,
                               _CLOCK_S if self._clock_ns else _FRAMES_S)
        if self._runner is not None and os.getppid() != self._runner:
            incomplete = 'the run was killed'
        if self._stands_still and not self._clock_left:
            incomplete = (f'the clock stopped at {self._clock_ns / NS_PER_S:.3f} s, '
                          f'{time.monotonic() - self._clock_s:.0f} s before the recording ended')
        self._writer.close(incomplete, self._pace.real_time_factor)

    def _discover(self) -> None:
        self._publish_written()
        self._name_other_types()
        self._watch_clock()
        self._name_floods()
        now_s = time.monotonic()
        if (now_s - self._last_new_topic_s > _SETTLED_S
                and now_s - self._last_discovery_s < _SETTLED_DISCOVERY_S):
            return
        self._last_discovery_s = now_s
        for name, _ in self.get_topic_names_and_types():
            if name in self._subscribed or not self._is_wanted(name):
                continue
            infos = self.get_publishers_info_by_topic(name)
            # Of several types the one that others read, too.
            read = {info.topic_type for info in self.get_subscriptions_info_by_topic(name)}
            infos.sort(key=lambda info: info.topic_type not in read)
            if infos:
                self._subscribe(name, infos[0].topic_type, infos)
        if self._publisher is None and self._needed <= self._subscribed:
            self._publisher = qos.publisher(self, topics.RECORDED)

    def _name_other_types(self) -> None:
        """Warn of velocities of another type than the recorded one as soon as they are offered.

        A controller of the legs refuses them, so the rover does not move by what the bag lacks. A
        publisher may live for a second only.
        """
        for name, recorded in self._velocities.items():
            for info in self.get_publishers_info_by_topic(name):
                key = f'{name} {info.topic_type}'
                if info.topic_type != recorded and key not in self._warned:
                    self._warned.add(key)
                    self.type_watch.ignore(name, info.topic_type)
                    who = 'a node' if info.node_name == UNKNOWN_NAME else info.node_name
                    self.get_logger().warning(
                        f'{name}: {info.topic_type} of {who} is neither recorded nor '
                        f'driven: the bag has {recorded} on this topic; publish one type only')

    def _name_floods(self) -> None:
        """Warn of topics with more messages than a recorder keeps up with."""
        since_s = time.monotonic() - self._counted_s
        if since_s < _FLOOD_LOOK_S:
            return
        for name, count in self._lately.items():
            if count > _MOST_HZ * since_s and f'{name} flood' not in self._warned:
                self._warned.add(f'{name} flood')
                self.get_logger().warning(
                    f'{name}: {count / since_s:.0f} messages a second: more than {_MOST_HZ} may '
                    'be lost, and the bag does not say which')
        self._lately, self._counted_s = {}, time.monotonic()

    def _watch_clock(self) -> None:
        """Say that a clock stands still: in a run, physics and the supervisor do."""
        silent_s = time.monotonic() - self._clock_s
        if self._runner is not None or not self._clock_ns or silent_s < 0.5:
            self._stands_still = self._clock_left = False
        elif not self._stands_still:
            # Who leaves in order is gone at once, who is killed only when its lease ends.
            self._clock_left = not self.count_publishers(self._clock_name)
            if silent_s >= _STANDSTILL_S:
                self._stands_still = True
                self.get_logger().warning(
                    f'{self._clock_name} stands still at {self._clock_ns / NS_PER_S:.3f} s: '
                    + ('its publisher has left' if self._clock_left else 'time is paused, or '
                       'physics_node is dead; the bag is marked if it ends like this'))

    def _full(self, name: str) -> str:
        """Return the full name of a topic, which may be one of the contract."""
        return self.resolve_topic_name(_GRAPH_NAMES.get(name, name))

    def _topic(self, name: str) -> topics.Topic | None:
        """Return the topic of the contract that a full name is."""
        return self._contract.get(name) or topics.topic_of(name.removeprefix(self._own))

    def _is_wanted(self, name: str) -> bool:
        if name in self._listed or not self._all:
            return name in self._listed
        # In a namespace `all` means the topics of this rover.
        topic = self._topic(name)
        if not name.startswith(self._own) and topic is None:
            return False
        # With topics at wall time no two runs would give the same bag.
        return (name not in self._excluded and not is_at_wall_time(name)
                and (topic is None or is_recorded(topic, (ALL,))))

    def _subscribe(self, name: str, type_name: str, infos: list[TopicEndpointInfo]) -> None:
        self._subscribed.add(name)
        self._last_new_topic_s = time.monotonic()
        topic = self._topic(name)
        profile = qos.adapted(infos, qos.depth(topic))
        try:
            cls = message_class(type_name)
        except GraphError as error:
            self.get_logger().warning(f'{name} is not recorded: {error}')
            return
        if type_name in _VELOCITIES:
            self._velocities[name] = type_name
        self._writer.add_topic(name, type_name, qos=infos[0].qos_profile,
                               definition=definition_of(type_name))
        is_clock = name == self._clock_name
        latched = topic is not None and topic.rate == topics.LATCHED
        at_wall_time = is_at_wall_time(name)

        def callback(raw: bytes) -> None:
            # A message without a stamp gets the newest time, a latched one the start.
            if latched and self._is_repeated(name, type_name, raw):
                return
            self._rate.tick()
            self._lately[name] = self._lately.get(name, 0) + 1
            has_time = self._clock_ns or self._clock_name in self._needed
            latest_ns = self._clock_ns + _LATEST_NS if has_time and not is_clock else None
            if at_wall_time:    # its messages get the time of their arrival in the bag
                latest_ns = 0
            stamp_ns = self._writer.write(name, type_name, raw, 0 if latched else self._newest_ns,
                                          latest_ns)
            if is_clock:
                self._clock_ns = max(self._clock_ns, stamp_ns)
                self._clock_s = time.monotonic()
            elif (name in self._writer.of_another_clock and name not in self._warned
                    and not at_wall_time):
                self._warned.add(name)
                self.get_logger().warning(
                    f'{name}: is stamped more than {_LATEST_NS // NS_PER_S} s after /clock (with '
                    'wall time?); its messages get the time of their arrival in the bag')
            if name == self._navigated_name:
                # From here on a run is complete that ends at this stamp.
                self._duration_s = min(self._duration_s, stamp_ns / 1e9)
            if is_clock and self._jump.has_occurred(stamp_ns):
                self._newest_ns = self._sent_ns = 0
                self._written.restart()
            self._acknowledge(name, stamp_ns)

        def on_loss(event: Any) -> None:
            self._drops.add(name, event.total_count_change)
            self.get_logger().warning(f'{name}: {event.total_count} messages are lost',
                                      throttle_duration_sec=1.0)

        events = qos.loss_events(topic, on_loss)
        self.create_subscription(cls, name, callback, profile, raw=True, event_callbacks=events)

    def _rate_status(self) -> SubjectStatus:
        stands_still = self._newest_ns == self._newest_told_ns
        self._newest_told_ns = self._newest_ns
        return self._rate.status('Nothing new is published' if stands_still else '')

    def _acknowledge(self, name: str, stamp_ns: int) -> None:
        """Note up to which stamp all acknowledged topics are written, and publish it."""
        self._newest_ns = max(self._newest_ns, stamp_ns)
        self._pace.note(self._newest_ns)
        if self._written.write(name, stamp_ns):
            self._publish_written()

    def _publish_written(self) -> None:
        """Publish up to which stamp everything is written, if that is new and has a reader."""
        if (self._publisher is not None and self._written.up_to_ns > self._sent_ns
                and self._publisher.get_subscription_count()):
            self._sent_ns = self._written.up_to_ns
            self._publisher.publish(Header(stamp=conversions.time_msg(self._sent_ns)))


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding='utf-8')
    except OSError as error:
        raise ConfigError(f'scenario_file: {path}: {error.strerror}') from None
