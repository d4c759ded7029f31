"""Recording one run: the nodes of a scenario as processes, and the bag that they leave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import logging
import numbers
from pathlib import Path
import time

from lunar_rover_sim.bag import marker
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.totals import simulated_end_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import (brief, check_argument, check_path, ConfigError,
                                         did_you_mean, GraphError)
from lunar_rover_sim.base.files.paths import BAG_FOLDER, check_new_folder
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.gait.calibration import differences, GaitCalibration, ground_conditions
from lunar_rover_sim.run.checkpoint import Checkpoint, CHECKPOINT_FOLDER, clear, newest
from lunar_rover_sim.run.dated_sun import dated_sun
from lunar_rover_sim.run.lockstep import machine_slowness, STARTED_NS
from lunar_rover_sim.run.node_config import ALL
from lunar_rover_sim.run.node_processes import Looks, NodeLogs, NodeProcesses
from lunar_rover_sim.run.plan import (prepare, resolve, ROVER_FILE, SCENARIO_FILE,
                                      why_no_checkpoints, WORLD_LINK)
from lunar_rover_sim.run.publication import misspelt_exclusions, silent_topics, unrecorded_cameras
from lunar_rover_sim.run.ros_domain import (check_domain, ClockReader, OwnDomain, require_ros,
                                            shell_domain)
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.run.scenario_checks import check_scenario
from lunar_rover_sim.run.waits import awaits_others

_POLL_S = 0.1
# physics_node names the participant that it waits for before the supervisor names physics_node. It
# begins to wait once it has started itself, which takes seconds.
_SILENCE_MARGIN_S, _START_MARGIN_S = 1.0, 30.0
# A node that loads makes progress by so much processor time, however long it waits for a core. One
# that hangs wakes up now and then, and uses less within any limit of a start.
_LOADED_S = 1.0
# Limit where time stands still and no node works: they wait for each other. A node that draws
# for a minute, or that gets a tenth of a core, works.
_IDLE_S = 6.5
# Time that physics has to leave after its last state.
_LEAVE_S = 15.0


@dataclasses.dataclass(frozen=True)
class Limits:
    """Wall times without progress of the clock after which physics counts as hung [s].

    Attributes:
        silence_s: During the run; None where time may stand still (paused, real time).
        start_s: In its first simulated second, where time waits for the slowest node to start,
            and no node that still loads makes progress. Both on an idle machine, times
            `machine_slowness` on a busy one.
        idle_s: During the run, where no node works or one is suspended.
        others: Whether programs take part that the run has not started, whose work cannot be seen.
        end_ns: Simulated time at which physics finishes [ns]; 0 for never.
        timeout_s: Wall time after which the run is stopped as failed; None for never.
    """

    silence_s: float | None
    start_s: float | None
    end_ns: int
    timeout_s: float | None = None
    idle_s: float = _IDLE_S
    others: bool = False

    @classmethod
    def of(cls, scenario: Scenario, timeout_s: float | None = None) -> Limits:
        """Return the limits of a resolved scenario."""
        wait, end_ns = scenario.physics_node.wait, round(scenario.run.duration_s * 1e9)
        if not scenario.shared.lockstep:
            return cls(None, None, end_ns, timeout_s)
        idle_s = _IDLE_S if wait.silence_s > _IDLE_S else wait.silence_s + _SILENCE_MARGIN_S
        return cls(wait.silence_s + _SILENCE_MARGIN_S, wait.start_s + _START_MARGIN_S, end_ns,
                   timeout_s, idle_s, awaits_others(scenario))

    def silence_limit_s(self, now_ns: int, suspended: bool, idle: bool) -> float | None:
        """Return how long the clock may stand still at `now_ns`; None for ever."""
        limit_s = self.silence_s
        if limit_s is not None:
            if suspended or (idle and not self.others and now_ns > STARTED_NS):
                limit_s = self.idle_s
            else:
                limit_s = self.start_s if now_ns <= STARTED_NS else limit_s
                if limit_s is not None and not idle:    # they load, compile, or wait for a core
                    limit_s *= machine_slowness()
        if limit_s is not None and 0 < self.end_ns <= now_ns:
            limit_s += _LEAVE_S
        return limit_s


def supervise(nodes: NodeProcesses, clock: ClockReader, limits: Limits,
              on_progress: Callable[[int], None], should_stop: Callable[[], bool],
              on_warning: Callable[[str], None] = lambda _text: None) -> bool:
    """Return True when physics has finished, False when `should_stop` says so.

    Args:
        nodes: The processes of the run.
        clock: Time of the graph.
        limits: When it counts as hung.
        on_progress: Called about ten times a second with the simulated time [ns].
        should_stop: Whether the user has asked to stop.
        on_warning: Called with a line where a node is suspended, which says when the run ends.

    Raises:
        GraphError: When a node dies, time stands still, or the run takes too long.
    """
    start = last_progress = time.monotonic()
    last_ns, suspended, loaded_s = 0, list[str](), 0.0
    looks = Looks()     # since time stands still
    while True:
        if nodes.has_finished():
            on_progress(max(clock.now_ns(), limits.end_ns))
            return True
        if should_stop():
            return False
        clock.check()
        now_ns, now_suspended = clock.now_ns(), nodes.suspended()
        # A node that is suspended gets the same time as one that is silent.
        new = [name for name in now_suspended if name not in suspended]
        if new and limits.silence_s is not None:
            on_warning(f'{new[0]} is stopped (SIGSTOP): the run ends in {limits.idle_s:g} s '
                       'unless it goes on')
        loading_s = nodes.loading_cpu_s()
        if (now_ns != last_ns or now_suspended != suspended or nodes.compiling()
                or abs(loading_s - loaded_s) >= _LOADED_S):
            last_ns, suspended, last_progress = now_ns, now_suspended, time.monotonic()
            loaded_s = loading_s
            looks = Looks()
        else:
            looks.add(nodes.at_work())
        limit_s = limits.silence_limit_s(now_ns, bool(suspended), looks.idle)
        if limit_s is not None and time.monotonic() - last_progress > limit_s:
            raise GraphError(_describe_silence(nodes, suspended, limit_s, now_ns))
        if limits.timeout_s is not None and time.monotonic() - start > limits.timeout_s:
            raise GraphError(f'the run was not done within {limits.timeout_s:g} s')
        nodes.measure()
        on_progress(now_ns)
        time.sleep(_POLL_S)


def _describe_silence(nodes: NodeProcesses, suspended: list[str], limit_s: float,
                      now_ns: int) -> str:
    """Return why time stands still: a node has failed, or is stopped, late or silent."""
    fatal = nodes.fatal_error()
    if fatal is not None:
        return fatal
    at = f'at {now_ns / 1e9:.3f} s of simulated time'
    if suspended:
        return f'{suspended[0]} is stopped (SIGSTOP) {at} (log: {nodes.log(suspended[0])})'
    late = nodes.unstarted()
    if late:
        return f'not started within {limit_s:g} s: {late}'
    silent = nodes.silent_participant(now_ns)
    return f'{silent}, {limit_s:.3g} s so far' if silent else (
        f'physics_node has been silent for {limit_s:g} s {at} '
        f'(log: {nodes.log("physics_node")})')


logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Recording:
    """What a run has left.

    Attributes:
        folder: Of the run, with `scenario.yaml`, `rover.yaml`, `logs/` and the link `world`.
        bag: The rosbag2 folder; None for a run without recorder_node.
        scenario: With everything spelled out that depends on the nodes.
        counts: Topic → messages in the bag.
        simulated_s: Simulated time [s].
        wall_s: Wall time with start and stop of the nodes [s].
        cpu_s: Node → processor time [s].
        interrupted: Whether the run was stopped before its end.
        warnings: One line per kind of warning that nodes logged, and one if images are missing.
    """

    folder: Path
    bag: Path | None
    scenario: Scenario
    counts: dict[str, int] = dataclasses.field(repr=False)
    simulated_s: float
    wall_s: float
    cpu_s: dict[str, float] = dataclasses.field(repr=False)
    interrupted: bool
    warnings: tuple[str, ...] = ()

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time, start and stop of the nodes included."""
        return self.simulated_s / self.wall_s


def record(scenario: Scenario, folder: str | Path, *, world: str | Path | None = None,
           domain: int | None = None, join: bool = False, timeout_s: float | None = None,
           resume: bool = False,
           should_stop: Callable[[], bool] = lambda: False,
           on_start: Callable[[Scenario, int], None] = lambda _scenario, _domain: None,
           on_progress: Callable[[int], None] = lambda _now_ns: None,
           on_warning: Callable[[str], None] = lambda _text: None,
           on_way: Callable[[float, float], None] = lambda _driven_m, _left_m: None,
           on_wait: Callable[[str], None] = lambda _text: None) -> Recording:
    """Run the nodes of a scenario as processes until its end; return what they recorded.

    ROS runs in the node processes only. KeyboardInterrupt stops the nodes in order, so that the
    bag is complete up to there, before it is raised.

    Args:
        folder: Must not exist; takes the bag, the resolved scenario and the logs.
        world: Folder of a world that is used instead of the scenario's own.
        domain: ROS_DOMAIN_ID; by default a free one of this machine.
        join: Takes part in a graph that runs there, whose nodes may publish tf and tf_static. By
            default it is that of the shell.
        timeout_s: Wall time, > 0, after which the run counts as failed [s].
        resume: Go on with the run in `folder`, whose `unfinished_run` is this scenario, at its
            newest checkpoint; on the world that it began on.
        should_stop: Asked ten times a second; once it returns True, the run ends early.
        on_start: Called with the resolved scenario and the ROS_DOMAIN_ID before the nodes start.
        on_progress: Called ten times a second with the simulated time [ns].
        on_warning: Called with every line of level WARN or worse that a node logs.
        on_way: Called, in a run with a navigator, with the way driven and that to the goal [m].
        on_wait: Called where time begins to stand still for something else, a node that loads or
            compiles or does not answer, with what that is; with '' when it goes on.

    Raises:
        ConfigError: If an argument is not valid, or `folder` exists or cannot be written.
        GraphError: If rclpy is missing, a node fails or nothing was recorded.
        WorldError: For a damaged world.
    """
    check_argument('scenario', scenario, Scenario, 'a Scenario (Scenario.load(...))')
    check_path('folder', folder)
    if world is not None:
        check_path('world', world)
    if timeout_s is not None and not (isinstance(timeout_s, numbers.Real) and timeout_s > 0):
        raise ConfigError(f'timeout_s: {brief(timeout_s)} is not valid; valid is > 0 [s]')
    resumed = None
    if resume:
        resumed = _last_checkpoint(Path(folder))
    else:
        check_new_folder(Path(folder), 'folder')
    require_ros()
    check_scenario(scenario)     # before a world is built
    if resume:
        world_folder = (Path(folder) / WORLD_LINK).resolve()
        used = load_world(world_folder)
        scenario.check_world(used)
    elif world is not None:
        world_folder = Path(world).resolve()
        used = load_world(world_folder)
        scenario.check_world(used)
        # The scenario may have been loaded without this world.
        dated_sun(scenario.render_node.sun, scenario.world, used)
        scenario = dataclasses.replace(scenario, world=used.config)
    else:
        world_folder = scenario.world_folder()
        used = load_world(world_folder, verify=False)
    # The recorded scenario states the recipe of the world that is used, and its hash.
    named = dataclasses.replace(scenario.run, world_hash=used.hash)
    given = scenario.physics_node.checkpoint_period_s
    scenario = resolve(dataclasses.replace(scenario, run=named))
    if given and not scenario.physics_node.checkpoint_period_s:
        logger.warning('physics_node.checkpoint_period_s: %g s, but there are no checkpoints %s',
                       given, why_no_checkpoints(scenario))
    if resume and scenario.to_yaml() != (Path(folder) / SCENARIO_FILE).read_text('utf-8'):
        raise ConfigError(f'{folder}: {SCENARIO_FILE} is not what this version makes of it; valid '
                          'is the version that began the run')
    if 'gait_controller_node' in scenario.run.nodes:
        # The gait node compares the rover; it does not know the ground.
        calibration = GaitCalibration.of(scenario.gait_controller_node, rover=scenario.rover.name)
        for difference in differences(calibration.conditions,
                                      ground_conditions(scenario.physics_node)):
            logger.warning('gait calibration: measured with %s', difference)
    for line in silent_topics(scenario):
        logger.warning('recorder_node.topics: %s', line)
    for line in misspelt_exclusions(scenario):
        logger.warning('recorder_node.exclude: %s', line)
    for line in unrecorded_cameras(scenario):
        logger.warning('render_node.hazard.%s', line)
    folder = Path(folder).resolve()
    now_ns, waits = 0, ''
    told: set[str] = set()

    def progress(time_ns: int) -> None:
        nonlocal now_ns, waits
        now_ns = time_ns
        report(logs)
        if (text := nodes.waits_for(now_ns)) != waits:
            waits = text
            on_wait(text)
        if (way := nodes.way_m()) is not None:
            on_way(*way)
        on_progress(time_ns)

    def report(logs: NodeLogs) -> None:
        for warning in logs.new_warnings():
            on_warning(str(warning))
        for name, end in nodes.lost.items():
            if name not in told:
                told.add(name)
                on_warning(end)

    if join and domain is None:
        domain = shell_domain()
    with OwnDomain(domain) as own:
        if domain is not None:
            # Other programs of the graph may publish diagnostics too.
            check_domain(domain, [f'/{topic.name}' for topic in topics.of_legs(
                topics.CONTRACT, scenario.rover.legs.names) if topic.node in scenario.run.nodes
                                  and topic is not topics.DIAGNOSTICS], join)
        plans = prepare(scenario, folder, world_folder, resumed)
        on_start(scenario, own.id)
        start = time.monotonic()
        with ClockReader(own.id) as clock, NodeProcesses(
                plans, folder, own.id, scenario.run.may_fail) as nodes:
            logs = NodeLogs(nodes.logs())
            try:
                finished = supervise(nodes, clock, Limits.of(scenario, timeout_s), progress,
                                     should_stop, on_warning)
            finally:
                report(logs)
        wall_s = time.monotonic() - start
        report(logs)
    bag, counts, simulated_s = None, {}, now_ns / 1e9
    if 'recorder_node' in scenario.run.nodes:
        bag = folder / BAG_FOLDER
        with open_bag(bag) as recorded:
            counts, simulated_s = dict(recorded.counts), simulated_end_ns(recorded) / 1e9
        _check_topics(scenario.recorder_node.topics, counts)
    return Recording(folder, bag, scenario, counts, simulated_s, wall_s, nodes.cpu_s,
                     interrupted=not finished,
                     warnings=(*logs.summary(), *nodes.lost.values(),
                               *missing_frames(scenario, counts, simulated_s)))


def unfinished_run(folder: Path) -> Scenario:
    """Return the scenario of a run that ended early, and can go on at a checkpoint.

    Raises:
        ConfigError: If there is no run in the folder, it is finished, it goes on at this moment,
            it has no whole checkpoint, it is of another version, or its rover was changed.
    """
    path, bag = folder / SCENARIO_FILE, folder / BAG_FOLDER
    if not path.is_file():
        raise ConfigError(f'{folder}: holds no run; valid is the folder of a run that ended early')
    if bag.is_dir():
        if marker.why_incomplete(bag) is None:
            raise ConfigError(f'{folder}: the run is finished')
        try:
            if (bag / marker.MARKER_NAME).is_file():
                marker.lock(bag).close()
        except BlockingIOError:
            raise ConfigError(f'{folder}: the run goes on at this moment') from None
    _last_checkpoint(folder)
    scenario = Scenario.load(path)
    if load_rover(folder / ROVER_FILE) != scenario.rover:
        raise ConfigError(f'{folder}: {ROVER_FILE} is another rover than that of {SCENARIO_FILE}; '
                          'valid are both as the run has left them')
    return scenario


def _last_checkpoint(folder: Path) -> Checkpoint:
    found = newest(folder / CHECKPOINT_FOLDER)
    if found is None:
        raise ConfigError(f'{folder}: holds no whole checkpoint; valid is a run with '
                          'physics_node.checkpoint_period_s that has reached the first one')
    clear(folder / CHECKPOINT_FOLDER, found.time_ns)
    return found


def missing_frames(scenario: Scenario, counts: Mapping[str, int],
                   simulated_s: float) -> list[str]:
    """Return one line if images are missing in a recording in real time, else none.

    Where images are not recorded, the CameraInfo of each counts. The last one may have been under
    way when the run ended.
    """
    recorded = next((counts[f'/{topic.name}'] for topic in topics.OF_PAIRS
                     if f'/{topic.name}' in counts), None)
    meant = round(simulated_s * 1e9) // scenario.render_node.frame_period_ns
    if scenario.render_node.lockstep or recorded is None or recorded >= meant - 1:
        return []
    return [f'render_node: {recorded} of {meant} stereo pairs were drawn and recorded, '
            f'{recorded / simulated_s:.1f} of {scenario.render_node.frame_rate_hz:g} a second: '
            'this machine is too slow for them in real time']


def _check_topics(listed: tuple[str, ...], counts: dict[str, int]) -> None:
    """Warn of listed topics without a message; raise GraphError if nothing was recorded."""
    silent = [name for name in listed
              if name != ALL and not counts.get('/' + name.lstrip('/'))]
    if not silent:
        return
    known = [topic.name for topic in topics.CONTRACT]
    hints = ['' if topics.topic_of(name.lstrip('/')) is not None else did_you_mean(name, known)
             for name in silent]
    line = '; '.join(f'{name}: nobody published' + (f', {hint}' if hint else '')
                     for name, hint in zip(silent, hints))
    if not any(counts.values()):
        raise GraphError(f'recorder_node.topics: {line}: the bag is empty')
    logger.warning('recorder_node.topics: %s', line)
