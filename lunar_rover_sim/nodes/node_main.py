"""Start, spinning and end of every node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import functools
import math
import os
from pathlib import Path
import re
import signal
import sys
from tempfile import TemporaryDirectory
import time
from types import FrameType
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from lunar_rover_sim import __version__
from lunar_rover_sim.bag.stamps import message_of
from lunar_rover_sim.base.compilation import COMPILATION
from lunar_rover_sim.base.errors import ConfigError, LunarRoverSimError
from lunar_rover_sim.nodes import qos
from lunar_rover_sim.nodes.checkpoints import saved_state, StateWriter
from lunar_rover_sim.nodes.message_types import name_of
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_state import COMPILED, COMPILING, fail, NodeState, READY, tell
from lunar_rover_sim.run.params_files import arguments_of_program
from lunar_rover_sim.run.shared_config import NodeConfig

_SOURCE_LINES = re.compile(r', at /\S+:\d+')      # in messages of rcl
_SPIN_S = 0.1   # the longest time until an idle node notices a signal


class GraphNode(Node):
    """A node that can end by itself: finished, or because of an error in a callback.

    Attributes:
        finished: Set to end the node successfully after the current callback.
        warnings: What is refused or goes wrong often, with its count.
        failure: The error of this package that a callback raised. `run` prints it as one line; the
            executor would log a traceback.
        received: Messages so far.
        writes_state: Whether it writes its state at checkpoints by itself.
    """

    writes_state = True

    def __init__(self, name: str) -> None:
        self.finished = False
        self.received = 0
        self.failure: LunarRoverSimError | None = None
        self._woken = Future()
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._has_parameters = False
        # `parameters.declare` checks all overrides, also those with unknown names.
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        self._has_parameters = True
        self.type_watch = TypeWatch(self)
        self.warnings = CountedWarnings(self.get_logger())

    @property
    def ending(self) -> bool:
        """Whether the node is finished or has failed: no further callback is run."""
        return self.finished or self.failure is not None

    def report_ready(self, config: NodeConfig, world: str = '', waits: Sequence[str] = (),
                     doubts: Sequence[str] = ()) -> None:
        """Log the one line that says what has been started, what it waits for, and doubts."""
        parts = [f'lunar_rover_sim {__version__}', *([world] if world else []),
                 f'seed {config.seed}', config.time_mode,
                 f'waits for {", ".join(waits)}' if waits else 'waits for nobody']
        self.get_logger().info('ready: ' + ', '.join(parts))
        saved = saved_state(config, self.get_name())
        if saved is not None:
            self.resume(*saved)
            self.get_logger().info(f'goes on at {saved[0] / 1e9:.3f} s')
        if config.checkpoints and self.writes_state:
            StateWriter(self, Path(config.checkpoints))
        tell(NodeState(READY))
        for doubt in doubts:
            self.get_logger().warning(doubt)

    def spin(self) -> None:
        """Run callbacks until `wake` is called, for at most 0.1 s. Only `run` calls this."""
        # One call of the executor runs many callbacks: spin_once for each message would take as
        # long as the messages themselves. A signal handler cannot wake the executor: hence the
        # time limit.
        if not self._woken.done() and self.executor is not None:
            self.executor.spin_until_future_complete(self._woken, timeout_sec=_SPIN_S)
        self._woken = Future()

    def wake(self) -> None:
        """Request a call of `work` after the current callback, or after the current `work`."""
        if not self._woken.done():
            self._woken.set_result(None)

    def wake_later(self) -> None:
        """Request a call of `work` after the callbacks that are due now; from any thread."""
        if self.executor is not None:
            self.executor.create_task(self.wake)

    def close(self) -> None:
        """Finish and release what is the node's own; only the graph is left. Called once."""

    def work(self) -> None:
        """Do what takes too long for a callback. Called after `wake`, and every 0.1 s or so."""

    # Checkpoints

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """Return whether it has done all that messages up to a checkpoint ask for."""
        return True

    def state(self) -> dict[str, Any]:
        """Return all that the node goes on from, as `base.files.state_file` writes it."""
        return {}

    def resume(self, time_ns: int, state: Any) -> None:
        """Go on at a simulated time [ns] from what `state` has returned; nothing is sent yet."""

    def create_publisher(self, *args: Any, **kwargs: Any) -> Any:
        """Create a publisher whose QoS the parameters `qos_overrides` may change."""
        if self._has_parameters:    # rclpy's own publishers are made before
            kwargs.setdefault('qos_overriding_options', qos.OPTIONS)
        return super().create_publisher(*args, **kwargs)

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[..., None],
                            *args: Any, light: bool = False, **kwargs: Any) -> Any:
        """Create a subscription whose callback may raise errors of this package.

        The parameters `qos_overrides` may change its QoS.

        Args:
            light: Whether the callback gets messages of rosbags, see `message_of`: for those that
                come with every state.
        """
        if self._has_parameters:
            kwargs.setdefault('qos_overriding_options', qos.OPTIONS)
        if light:
            type_name, with_message, kwargs['raw'] = name_of(msg_type), callback, True
            callback = functools.wraps(with_message)(
                lambda raw: with_message(message_of(type_name, raw)))

        @functools.wraps(callback)
        def counted(*received: Any) -> None:
            self.received += 1
            callback(*received)

        return super().create_subscription(msg_type, topic, self.guarded(counted), *args,
                                           **kwargs)

    def create_timer(self, timer_period_sec: float, callback: Callable[..., None],
                     *args: Any, **kwargs: Any) -> Any:
        """Create a timer on the steady clock whose callback may raise errors of this package.

        With use_sim_time a timer of the node's own clock would wait for /clock, which physics
        makes by its timers, and which stands still while others wait for somebody.
        """
        kwargs.setdefault('clock', self._steady_clock)
        return super().create_timer(timer_period_sec, self.guarded(callback), *args, **kwargs)

    def guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a callback for the executor whose errors of this package end the node."""
        @functools.wraps(callback)
        def guarded(*args: Any) -> None:
            if not self.ending:
                try:
                    callback(*args)
                except LunarRoverSimError as error:
                    self.failure = error
            if self.ending:
                self.wake()

        return guarded


def executor() -> Executor:
    """Return the events executor (a third of the CPU time), or rclpy's own where it is missing."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def _init(arguments: Sequence[str]) -> None:
    """Start rclpy; raise ConfigError for arguments and parameter files that ROS 2 cannot read.

    The first argument names the program, as `sys.argv` does.
    """
    program = Path(arguments[0]).stem if arguments else ''
    with TemporaryDirectory() as folder:
        words = arguments_of_program(arguments, program, Path(folder))
        try:
            rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:   # the root of rclpy's own errors
            raise ConfigError(f'--ros-args: {_SOURCE_LINES.sub("", str(error))}') from None


def run(factory: Callable[[], GraphNode], args: list[str] | None = None) -> int:
    """Run one node until it is finished, fails, or receives SIGINT or SIGTERM.

    Returns the exit status: 0, or 1 after an error of this package, which is printed as one line.
    Any other exception is a defect and is raised. A process that cannot leave the graph is ended
    by SIGALRM, with all work done.
    """
    node: GraphNode | None = None
    failure: LunarRoverSimError | None = None
    stopped = False

    # rclpy's own handlers shut the context down while callbacks publish, which then fail with
    # errors of many kinds. These let the current callback return first.
    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        if node is None:
            # Nothing is lost yet, and libraries under way would turn SystemExit into errors.
            os._exit(0)
        node.finished = True

    # A node that SIGALRM ends has done its work. Other than SIG_IGN, a handler is not inherited.
    signal.signal(signal.SIGALRM, lambda *_: None)
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    COMPILATION.on_change = lambda runs: tell(NodeState(COMPILING if runs else COMPILED))
    try:
        _init(sys.argv if args is None else args)
        spinner = executor()
        node = factory()
        qos.check_topics(node)
        spinner.add_node(node)
        while not stopped and not node.ending:
            node.spin()
            if not node.ending:
                node.work()
        failure = node.failure
        node.warnings.tell_rest()
    except LunarRoverSimError as error:
        failure = error
    if failure is not None:
        # Before the clean-up, which may take long.
        fail(failure)
    if node is not None:
        try:
            node.close()
        except LunarRoverSimError as error:
            if failure is None:
                failure = error
                fail(failure)
        bound_leaving()
        node.destroy_node()
    rclpy.try_shutdown()
    # Ctrl-C comes from the terminal and from `ros2 launch`. Python's own end gives signals back
    # their default effect, unless they are ignored.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    return 0 if failure is None else 1


_WARNINGS_S = 1.0


class CountedWarnings:
    """Counts warnings by kind and logs the count with the newest one.

    The first warning of a kind is logged at once, later ones at most once a second [wall time].
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._counts: dict[str, int] = {}
        self._told_s: dict[str, float] = {}
        self._untold: dict[str, str] = {}

    def add(self, kind: str, what: str, rest: str = '') -> None:
        """Count a warning; it reads `WHAT (N so far)REST`."""
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        self._untold[kind] = f'{what} ({count} so far){rest}'
        if time.monotonic() - self._told_s.get(kind, -math.inf) >= _WARNINGS_S:
            self._tell(kind)

    def tell_rest(self) -> None:
        """Log the last warning of each kind with its count, where it was held back."""
        for kind in list(self._untold):
            self._tell(kind)

    def _tell(self, kind: str) -> None:
        self._told_s[kind] = time.monotonic()
        self._logger.warning(self._untold.pop(kind))


_TYPES_S = 2.0


class TypeWatch:
    """Compares the types of a node's topics with those of others every 2 s; warns once of each.

    It warns of what it sees twice in a row: another node may still be about to subscribe.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._told: set[tuple[str, str, str]] = set()
        self._seen: set[tuple[str, str, str]] = set()
        self._ignored: set[tuple[str, str]] = set()
        node.create_timer(_TYPES_S, self._look)

    def ignore(self, topic: str, type_name: str) -> None:
        """Let others use a type on a topic, given by its full name."""
        self._ignored.add((topic, type_name))

    def _look(self) -> None:
        several = {name for name, types in self._node.get_topic_names_and_types()
                   if len(types) > 1}
        own = [(p.topic_name, name_of(p.msg_type), 'publishes', 'read')
               for p in self._node.publishers if p.topic_name in several]
        own += [(s.topic_name, name_of(s.msg_type), 'reads', 'published')
                for s in self._node.subscriptions if s.topic_name in several]
        before, self._seen = self._seen, set()
        for topic, type_name, does, is_done in own:
            infos = self._node.get_subscriptions_info_by_topic(topic) if does == 'publishes' \
                else self._node.get_publishers_info_by_topic(topic)
            served = [info.node_name for info in infos if info.topic_type == type_name]
            for info in infos:
                key = topic, info.node_name, info.topic_type
                if (info.topic_type == type_name or key in self._told
                        or (topic, info.topic_type) in self._ignored
                        or _belongs_to(info.node_name, served)):
                    continue
                self._seen.add(key)
                if key not in before:
                    continue
                self._told.add(key)
                self._node.get_logger().warning(
                    f'{topic}: {self._node.get_name()} {does} {type_name}, but {info.topic_type} '
                    f'is {is_done} by {info.node_name}: no message gets through')


def _belongs_to(name: str, served: list[str]) -> bool:
    """Return whether a node, or a hidden part `_NAME_…` of it, is among those of the right type.

    A hidden node itself is part of another, which may read two types.
    """
    return name.startswith('_') or any(other == name or other.startswith(f'_{name}_')
                                       for other in served)


_LIMIT_S = 10


def bound_leaving() -> None:
    """End this process by SIGALRM if it has not ended in 10 s.

    Call it before the last participant leaves, when nothing else is left to do. Fast DDS 2.14 may
    lock up where the others of a graph leave at the same time (one of 186 killed runs):
    `DomainParticipant::set_listener` waits, at full load, for a callback that waits for its lock.
    No Python code runs meanwhile.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(_LIMIT_S)


# Messages of two topics may arrive a little out of order.
_TOLERANCE_NS = 50_000_000


class TimeJump:
    """Notices by stamps that simulated time has gone back, and logs one line each time.

    rclpy's own jump callbacks need use_sim_time; the stamps tell it to every node.
    """

    def __init__(self, node: Node) -> None:
        self._logger = node.get_logger()
        self._newest_ns = 0

    def resume(self, time_ns: int) -> None:
        """Go on at a time [ns]."""
        self._newest_ns = time_ns

    def has_occurred(self, stamp_ns: int) -> bool:
        """Return whether `stamp_ns` [ns] lies before the newest stamp of earlier calls."""
        newest_ns = self._newest_ns
        if newest_ns - stamp_ns <= _TOLERANCE_NS:
            self._newest_ns = max(newest_ns, stamp_ns)
            return False
        self._newest_ns = stamp_ns
        self._logger.warning(f'time has gone back from {newest_ns / 1e9:.3f} s to '
                             f'{stamp_ns / 1e9:.3f} s: starting anew')
        return True
