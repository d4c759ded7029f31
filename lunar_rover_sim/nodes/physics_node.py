"""physics_node: the rover in MuJoCo, its state, contacts and IMU as topics, and the clock."""

from __future__ import annotations

import collections
from collections.abc import Sequence
from pathlib import Path
import time
from typing import Any

from geometry_msgs.msg import PointStamped
import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger

from lunar_rover_sim.bag.messages import time_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, GraphError
from lunar_rover_sim.base.frames import Array
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.nodes import conversions, node_main, qos, simulation_services
from lunar_rover_sim.nodes.checkpoints import Barrier
from lunar_rover_sim.nodes.diagnostics import PhysicsDiagnostics
from lunar_rover_sim.nodes.ground_listener import load_own_world, log_window
from lunar_rover_sim.nodes.lockstep_listener import LockstepListener
from lunar_rover_sim.nodes.pacing import Stepping, WallPace
from lunar_rover_sim.nodes.parameters import declare, on_change
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.nodes.state_publisher import GroundPublisher, RequestedSensors, StatePublisher
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.run.publication import unpublished
from lunar_rover_sim.sensors.imu import Imu, ImuNoise
from lunar_rover_sim.sensors.registry import mounted
from lunar_rover_sim.sensors.sensor import Platform

_WINDOW_S = 5.0     # wall time that a reader may take to receive a message
# Services are called in between.
_MAX_STATES_PER_CALLBACK = 20


class PhysicsNode(node_main.GraphNode):
    """Steps the simulation, in lockstep with those it waits for or by the wall clock."""

    writes_state = False        # the barrier does

    def __init__(self) -> None:
        super().__init__('physics_node')
        self._config = config = declare(self, PhysicsNodeConfig)
        world = load_own_world(config.world)
        rover = load_rover(config.rover or None)
        self._simulation = Simulation(world, rover, config)
        self._steps = config.state_period_ns // config.step_ns
        self._end_ns = round(config.duration_s * 1e9)
        self._paused = config.start_paused

        self._publisher = StatePublisher(self, rover, self._imu_noise(), config)
        self._ground = (None if self._simulation.overlay is None else GroundPublisher(
            self, self._simulation.overlay, lambda: self._simulation.world.ground,
            config.ground_period_ns, topics.GROUND_CHANGES.frame(config.separate_truth)))
        changes = [] if self._ground is None else [self._ground.changes]
        self._platform = platform = Platform(
            self._simulation, sun_of_date(config.sun, reported_site(world.report)), config.seed,
            1e-9 * config.state_period_ns)
        self._unpublished = unpublished(config.separate_truth, config.publish_clock,
                                        config.ground.deforms)
        self._requested = RequestedSensors(self, mounted(config, platform), self._unpublished)
        self._matching = ReaderDiscovery(
            self, [*self._publisher.publishers, *self._requested.publishers, *changes],
            tuple(dict.fromkeys([*config.wait.topics, *config.participants])))
        self._latched_publishers = [self._latch(topics.WORLD_HASH, world.hash),
                                    self._latch(topics.ROBOT_DESCRIPTION, urdf(rover))]
        self._window = self._simulation.world
        self._window_publisher = qos.publisher(self, topics.WORLD_WINDOW)
        self._publish_window(0)

        # Where others wait for somebody too, the gait controller does, for cmd_vel.
        relays = ([topics.JOINT_COMMANDS.name]
                  if set(config.participants).difference(config.wait.topics) else [])
        self._listener = LockstepListener(self, config.wait, config.lockstep, lambda: self._now_ns,
                                          self._advance_while_open,
                                          {topics.JOINT_COMMANDS: self._command_callback}, relays)
        if topics.JOINT_COMMANDS.name not in config.wait.topics:
            qos.subscription(self, topics.JOINT_COMMANDS, self._command_callback, lockstep=False)
        if config.end_when_navigated:
            qos.subscription(self, topics.NAVIGATED, self._navigated_callback, config.lockstep)
        # Commands and their stamps [ns], which wait for the time when they act.
        self._commands: collections.deque[tuple[int, Array]] = collections.deque()
        lag_ns = config.wait.lag_ns_by_topic().get(topics.JOINT_COMMANDS.name, 0)
        self._acts_after_ns = max(0, lag_ns - config.state_period_ns) if config.lockstep else 0
        self._barrier = Barrier(
            self, Path(config.checkpoints), round(config.checkpoint_period_s * 1e9)
            if config.checkpoints and config.lockstep else 0, config.checkpoint_nodes,
            config.wait.silence_s, self._go_on)
        self._stepping = Stepping(self.wake_later)
        self._step_service = simulation_services.offer(self, self, rover, config.world)
        self.create_service(Trigger, '~/reset', self._reset_callback)
        self.create_service(Trigger, '~/restart', self._restart_callback)
        self.create_service(SetBool, '~/pause', self._pause_callback)
        self.create_service(Trigger, '~/step', self._step_callback)

        self._now_ns = 0
        self._diagnostics = PhysicsDiagnostics(
            self, config, self._listener.gate, self._listener.drops, lambda: self._now_ns,
            lambda: self._stands_still)
        self._pace = WallPace(config.real_time_factor, config.state_period_ns,
                              _MAX_STATES_PER_CALLBACK, self.get_logger())
        if config.lockstep:
            # The first state needs no answer. The answers trigger the later ones.
            self.wake()
        else:
            self.create_timer(config.state_period_ns / 1e9 / config.real_time_factor,
                              self._advance_by_wall_clock)
        self.create_timer(0.5, self._watch)
        self._check_publishers(rover.legs.names)
        on_change(self, config, self._configure)
        self.report_ready(config, f'world {world.hash[:12]}', config.wait.topics,
                          config.without_effect())

    def _check_publishers(self, legs: Sequence[str]) -> None:
        """Raise GraphError for a topic of the contract that would be silent."""
        silent = {topic.name for topic in self._unpublished}
        published = {publisher.topic_name for publisher in self.publishers}
        for topic in topics.of_legs(topics.CONTRACT, legs):
            if (topic.node == 'physics_node' and topic.name not in silent
                    and self.resolve_topic_name(topic.graph_name) not in published):
                raise GraphError(f'{topic.name}: a row of physics_node in CONTRACT of '
                                 'base/topics.py that nobody publishes; is its sensor in SENSORS '
                                 'of sensors/registry.py?')

    def _configure(self, config: PhysicsNodeConfig) -> None:
        """Use changed live parameters: the sun that sensors see."""
        if config.sun.date:
            raise ConfigError('sun.azimuth_deg, sun.elevation_deg: follow from sun.date '
                              f'({config.sun.date}); they can change where it is empty')
        self._platform.sun.follow(config.sun)

    def close(self) -> None:
        """Release the simulation."""
        self._stepping.cancel('physics_node ends')
        self._simulation.close()

    def destroy_node(self) -> None:
        """Leave the graph, as the server of its own participant too."""
        if self._step_service is not None:
            self._step_service.close()
        super().destroy_node()

    def work(self) -> None:
        """Publish the states that need no answer."""
        self._advance_while_open()

    def _imu_noise(self) -> ImuNoise:
        return ImuNoise(self._config.imu, self._config.state_rate_hz,
                        np.random.default_rng([self._config.seed, Imu.stream]))

    def _latch(self, topic: topics.Topic, text: str) -> object:
        publisher = qos.publisher(self, topic)
        publisher.publish(String(data=text))
        return publisher

    def _publish_window(self, stamp_ns: int) -> None:
        """Tell in which window of the site the rover is from a stamp on.

        In lockstep this waits until all readers have the message: they then enter the window
        before they use the state of that stamp.
        """
        x, y = self._window.ground.middle_m
        message = PointStamped()
        message.header.frame_id = topics.WORLD_WINDOW.frame(self._config.separate_truth)
        message.header.stamp = conversions.time_msg(stamp_ns)
        message.point.x, message.point.y = x, y
        self._window_publisher.publish(message)
        if stamp_ns and self._config.lockstep and not self._window_publisher.wait_for_all_acked(
                Duration(seconds=_WINDOW_S)):
            self.get_logger().warning(f'{topics.WORLD_WINDOW.name}: a reader has not received it '
                                      f'in {_WINDOW_S:g} s')

    # Time

    def _advance_while_open(self) -> None:
        if self._stands_still or not self._config.lockstep or not self._is_matched():
            return
        for _ in range(_MAX_STATES_PER_CALLBACK):
            if (self._stands_still or not self._listener.gate.is_open(self._now_ns)
                    or self._at_end() or self._barrier.holds(self._now_ns)):
                break
            self._advance()
        else:
            self.wake()
        if (self._barrier.holds(self._now_ns) and not self._at_end()
                and not self._listener.gate.behind(self._now_ns)):
            self._barrier.begin(self._now_ns)
        if self._at_end() and not self._listener.gate.behind(self._now_ns):
            self._finish()

    def _advance_by_wall_clock(self) -> None:
        if self._stands_still or not self._is_matched():
            self._pace.restart(self._now_ns)
            return
        for _ in range(self._pace.due_periods(self._now_ns)):
            if self._at_end():
                self._finish()
                break
            if self._stands_still:
                break
            self._advance()

    def _is_matched(self) -> bool:
        """Return whether all whom time waits for have been discovered, in both directions."""
        return self._listener.has_all_publishers and self._matching.is_complete

    def _advance(self) -> RoverState:
        begun_s = time.monotonic()
        # As late as the gate lets an answer be: when it comes in fact makes no difference.
        while self._commands and self._commands[0][0] <= self._now_ns - self._acts_after_ns:
            self._simulation.command(self._commands.popleft()[1])
        state = self._simulation.advance(self._steps)
        self._now_ns += self._config.state_period_ns
        if self._simulation.world is not self._window:
            self._window = self._simulation.world
            self._publish_window(self._now_ns)
            log_window(self, self._window, self._now_ns, time.monotonic() - begun_s)
        if self._ground is not None:
            self._ground.publish(self._now_ns)
        self._requested.publish(state, self._now_ns)
        self._publisher.publish(state, self._now_ns)
        self._listener.note_progress()
        self._diagnostics.tick(state)
        self._stepping.made()
        return state

    def _at_end(self) -> bool:
        return 0 < self._end_ns <= self._now_ns

    def _navigated_callback(self, msg: Header) -> None:
        end_ns = max(time_ns(msg.stamp), self._now_ns + 1)
        if not 0 < self._end_ns <= end_ns:
            self._end_ns = end_ns
            self.get_logger().info(f'ends at {end_ns / 1e9:.3f} s: the drive is done')

    def _finish(self) -> None:
        self.get_logger().info(f'finished at {self._now_ns / 1e9:.3f} s')
        self.finished = True

    @property
    def _stands_still(self) -> bool:
        return self._paused and not self._stepping.pending

    def _watch(self) -> None:
        if self._stands_still or self._barrier.is_under_way:
            self._listener.note_progress()
        elif not self._is_matched():
            self._listener.check_publishers()
        elif self._config.lockstep:
            self._listener.check_silence(self._now_ns)

    # Checkpoints

    def _go_on(self) -> None:
        self._listener.note_progress()
        self.wake()

    def state(self) -> dict[str, Any]:
        """See `GraphNode`."""
        return {'simulation': self._simulation.checkpoint(), 'imu': self._publisher.state(),
                'sensors': self._requested.state(), 'end_ns': self._end_ns,
                'commands': list(self._commands)}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._simulation.resume(state['simulation'])
        self._publisher.resume(state['imu'])
        self._requested.resume(state['sensors'])
        self._now_ns, self._end_ns = time_ns, state['end_ns']
        self._commands.extend(state['commands'])
        self._listener.resume(time_ns)
        self._barrier.resume(time_ns)
        self._pace.restart(time_ns)
        self._window = self._simulation.world
        self._publish_window(time_ns)
        if self._ground is not None:
            self._ground.restart(time_ns)

    # Commands

    def _command_callback(self, msg: JointState) -> None:
        try:
            velocity = conversions.legs_of(msg, self._simulation.rover.legs, 'velocity')
        except GraphError as error:
            self.warnings.add('velocity', f'joint_commands: {error}')
            return
        if self._acts_after_ns:
            self._commands.append((time_ns(msg.header.stamp), velocity))
        else:
            self._simulation.command(velocity)

    # What simulation_services asks for

    @property
    def is_paused(self) -> bool:
        """Whether time stands still unless steps are asked for."""
        return self._paused

    @property
    def is_lockstep(self) -> bool:
        """Whether time waits for participants."""
        return self._config.lockstep

    @property
    def now_ns(self) -> int:
        """The simulated time [ns]."""
        return self._now_ns

    @property
    def world_frame(self) -> str:
        """The frame of the true poses."""
        return self._config.truth.frame_id

    def rover_state(self) -> RoverState:
        """Return the present state."""
        return self._simulation.state

    def pause(self, paused: bool) -> None:
        """Stop or continue time."""
        self._paused = paused
        self._stepping.cancel('time was paused or continued meanwhile')
        self._pace.restart(self._now_ns)
        self._listener.note_progress()
        self.wake()

    def reset(self) -> None:
        """Put the rover back to its start; time goes on."""
        self._stepping.cancel('the simulation was reset meanwhile')
        self._commands.clear()
        self._simulation.reset()
        self._requested.restart()

    def restart(self) -> None:
        """Put the rover back to its start; time begins at 0."""
        self.reset()
        self._publisher.restart(self._imu_noise())
        self.get_logger().info(f'restarted at {self._now_ns / 1e9:.3f} s: time begins at 0')
        self._now_ns = 0
        if self._ground is not None:
            self._ground.restart()
        self._pace.restart(self._now_ns)
        self._listener.restart()
        self._barrier.restart()
        self.wake()

    def quit(self) -> None:
        """End the node after the current callback."""
        self.finished = True
        self.wake()

    def move(self, position_m: Array | None, orientation_wxyz: Array | None,
             linear_mps: Array | None, angular_radps: Array | None) -> None:
        """Put the rover elsewhere; raises PhysicsError."""
        self._simulation.move(position_m, orientation_wxyz, linear_mps, angular_radps)

    def step(self, count: int) -> str | None:
        """Advance so many states while paused, in the service's thread; return why it did not."""
        return self._stepping.run(count)

    # Services

    def _reset_callback(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.reset()
        response.success = True
        response.message = 'the rover is back at its start; time goes on'
        return response

    def _restart_callback(self, _: Trigger.Request,
                          response: Trigger.Response) -> Trigger.Response:
        self.restart()
        response.success = True
        response.message = 'the rover is back at its start; time begins at 0'
        return response

    def _pause_callback(self, request: SetBool.Request,
                        response: SetBool.Response) -> SetBool.Response:
        self.pause(request.data)
        response.success = True
        response.message = ('paused' if self._paused else 'running') + \
            f' at {self._now_ns / 1e9:.3f} s'
        return response

    def _step_callback(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = (self._paused and self._is_matched()
                            and not self._barrier.holds(self._now_ns)
                            and self._listener.gate.is_open(self._now_ns))
        if response.success:
            self._advance()
            response.message = f'at {self._now_ns / 1e9:.3f} s'
        else:
            response.message = 'not paused; call ~/pause first' if not self._paused else \
                'waiting for ' + ', '.join(self._listener.gate.missing(self._now_ns)
                                           or self._matching.missing() or ['readers'])
        return response
