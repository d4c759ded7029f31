"""render_node: pose and motion of the rover to stereo images, true depth, SGM disparity, depth."""

from __future__ import annotations

import collections
import dataclasses
import json
import time
from typing import Any, NamedTuple

from std_msgs.msg import String

from lunar_rover_sim.bag.stamps import stamp_ns
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.moon_place import reported_site
from lunar_rover_sim.image.camera.miscalibration import Miscalibration
from lunar_rover_sim.image.illumination.sun_of_date import sun_of_date
from lunar_rover_sim.image.rendering.frame import unknown_flows
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.nodes import conversions, node_main, qos
from lunar_rover_sim.nodes.camera_publisher import (CameraPublisher, EXPOSURE, LabelPublisher,
                                                    Periods)
from lunar_rover_sim.nodes.diagnostics import Diagnostics, Drops, Rate, SubjectStatus
from lunar_rover_sim.nodes.ground_listener import (GroundListener, load_own_world, log_window,
                                                   refuse_other_worlds, WindowListener)
from lunar_rover_sim.nodes.moving_sun import MovingSun
from lunar_rover_sim.nodes.node_main import TimeJump
from lunar_rover_sim.nodes.parameters import declare, on_change
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery
from lunar_rover_sim.nodes.state_publisher import publish_frames
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.checkpoint import Checkpoint
from lunar_rover_sim.run.node_config import RenderNodeConfig

# A state between two periods that stays alone for so long is drawn all the same [wall time].
_SINGLE_S = 0.3


@dataclasses.dataclass
class _Frame:
    """A frame: the state that it shows, the layers drawn so far, and the topics published.

    Attributes:
        due: The periods [ns] whose first frame it is.
        before: The state of the last frame with depth before it, None for the first one.
    """

    stamp_ns: int
    state: RoverPose
    due: frozenset[int]
    before: RoverPose | None
    layers: dict[str, Any] = dataclasses.field(default_factory=dict)
    published: set[str] = dataclasses.field(default_factory=set)


class _Begun(NamedTuple):
    """A frame under way in the renderer, the topics to publish of it, and the layers they need."""

    frame: _Frame
    names: list[str]
    layers: set[str]


class RenderNode(node_main.GraphNode):
    """Draws the newest odometry of every frame period, for the topics that have subscribers.

    Callbacks only store messages; `work` draws. In lockstep a frame is finished in the call after
    the one that begins it, so that its successor can be begun in between if its state has arrived.
    What is computed from images runs in a thread of the publisher, beside the drawing.
    """

    def __init__(self) -> None:
        super().__init__('render_node')
        config = declare(self, RenderNodeConfig)
        world = load_own_world(config.world)
        # A run has done so already. A node that is started alone does it here.
        self._config = config = dataclasses.replace(
            config, sun=sun_of_date(config.sun, reported_site(world.report)))
        rover = load_rover(config.rover or None)
        self._legs = rover.legs
        self._renderer = Renderer(world, rover, config, config.seed)

        self._windows = WindowListener(self, world, config.lockstep)
        cameras = config.cameras
        # States begin periods of frames as they arrive, frames those of all images as they are
        # drawn.
        self._begin_periods(config)
        self._jump = TimeJump(self)
        self._single: tuple[int, bytes] | None = None   # odometry between periods, the only one
        self._single_s = 0.0
        self._poses: collections.deque[tuple[int, bytes]] = collections.deque()
        self._joints: dict[int, bytes] = {}
        self._ground = GroundListener(self, self._wake_if_idle)
        self._begun: collections.deque[_Begun] = collections.deque()
        self._newest: _Frame | None = None
        self._last_with_depth: RoverPose | None = None
        self._counted: _Frame | None = None
        self._awaited = list(config.await_readers)
        self._rate, self._drops, self._is_fed = Rate(0.0), Drops(), False

        # Before topics are advertised: who sees those may send the first state, and the cameras
        # that are prepared in between take seconds. Long queues also in real time: the state of a
        # period may come while a frame is drawn.
        qos.subscription(self, topics.JOINT_STATES, self._joints_callback, lockstep=True, raw=True)
        qos.subscription(self, config.truth, self._odom_callback, lockstep=True, raw=True)
        self._pair, *self._others = self._cameras = [
            CameraPublisher(self, camera, config, self._renderer, self._wake_if_idle,
                            self.wake_later) for camera in cameras]
        publish_frames(self, [frame for camera in cameras for frame in camera.frames])
        self._readers = ReaderDiscovery(
            self, [publisher for camera in self._cameras for publisher in camera.publishers],
            config.participants if config.lockstep else ())
        self._sun = MovingSun(self, config, self._renderer)
        self._labels = LabelPublisher(self, self._renderer, rover.legs.names)
        if not config.miscalibration.perfect:
            told = json.dumps(Miscalibration.drawn(config.miscalibration, config.seed).told(
                config.camera))
            qos.publisher(self, topics.MISCALIBRATION).publish(String(data=told))
        refuse_other_worlds(self, config.world, world, config.lockstep)
        on_change(self, config, self._configure)
        Diagnostics(self, {'Frame rate': self._frame_rate_status, 'Drops': self._drops.status})
        self.report_ready(config, f'world {world.hash[:12]}', (config.truth.name,))

    def close(self) -> None:
        """Finish the publishing under way and release the GL context.

        Raises what the matching of the last frame raised, if `work` has not.
        """
        for camera in self._cameras:
            camera.close()
        self._sun.close()
        self._windows.close()
        self._renderer.close()
        for camera in self._cameras:
            camera.raise_error()

    def _begin_periods(self, config: RenderNodeConfig) -> None:
        self._arrived = Periods([config.frame_period_ns], config.lockstep)
        self._due = Periods([output.period_ns for camera in config.cameras
                             for output in camera.outputs], config.lockstep)

    def _configure(self, config: RenderNodeConfig) -> None:
        """Use changed live parameters; raise ConfigError for what cannot change now."""
        before = self._config
        rates, before_rates = ([(output.topic, output.period_ns) for camera in of.cameras
                                for output in camera.outputs] for of in (config, before))
        if rates != before_rates and config.lockstep:
            raise ConfigError('frame_rate_hz, depth_every, rate_hz: cannot change in time_mode '
                              'lockstep, where others wait for frames; valid is real_time')
        if config.sun != before.sun:
            if config.sun.date:
                raise ConfigError('sun.azimuth_deg, sun.elevation_deg: follow from sun.date '
                                  f'({config.sun.date}); they can change where it is empty')
            self._sun.follow(config.sun, 0 if self._newest is None else self._newest.stamp_ns)
            self.get_logger().info('the sun has moved for images alone; sensors that see it '
                                   'follow sun.* of physics_node')
        for camera in self._cameras:
            camera.configure(config)
        self._config = config
        if rates != before_rates:
            self._begin_periods(config)

    # Checkpoints

    def is_at_rest(self, begun: Checkpoint) -> bool:
        """See `GraphNode`."""
        newest_ns = 0 if self._newest is None else self._newest.stamp_ns
        return (not (self._poses or self._begun)
                and newest_ns + self._config.frame_period_ns > begun.time_ns
                and all(camera.is_at_rest for camera in self._cameras))

    def state(self) -> dict[str, Any]:
        """See `GraphNode`; the ground comes with the first snapshot."""
        return {'arrived': self._arrived.state(), 'due': self._due.state(),
                'cameras': [camera.state() for camera in self._cameras],
                'middle_m': self._windows.middle_m, 'numbers': self._renderer.numbers,
                'last': self._last_with_depth}

    def resume(self, time_ns: int, state: Any) -> None:
        """See `GraphNode`."""
        self._arrived.resume(state['arrived'])
        self._due.resume(state['due'])
        self._last_with_depth = state['last']
        self._jump.resume(time_ns)
        self._renderer.numbers = state['numbers']
        if state['middle_m'] != self._windows.middle_m:
            world = self._windows.go_to(state['middle_m'])
            self._renderer.enter(world)
            for camera in self._cameras:
                camera.enter(world)
        self._sun.resume(time_ns)
        for camera, kept in zip(self._cameras, state['cameras']):
            camera.resume(kept)

    # Input

    def _joints_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.JOINT_STATES.type, raw)
        if stamp is None:
            return
        on_period = stamp % self._config.frame_period_ns == 0
        if self._config.lockstep and not on_period:
            return
        if not self._config.lockstep:
            # Those of the newest period, and the newest.
            self._joints = {} if on_period else {
                s: joints for s, joints in self._joints.items()
                if s % self._config.frame_period_ns == 0}
        self._joints[stamp] = raw
        self._wake_if_idle()

    def _odom_callback(self, raw: bytes) -> None:
        stamp = stamp_ns(topics.ODOM.type, raw)
        if stamp is None:
            return
        if self._jump.has_occurred(stamp):
            self._poses.clear()
            self._joints.clear()
            self._arrived.restart()
            self._due.restart()
            self._last_with_depth = None
        if self._single is not None and stamp != self._single[0]:
            self._single = None
        first = not self._arrived.has_begun
        if not self._arrived.begun(stamp):
            return
        if first and stamp % self._config.frame_period_ns:
            self._single, self._single_s = (stamp, raw), time.monotonic()
            return
        self._is_fed = True
        if not self._config.lockstep and self._poses:
            self._drops.add('Frames', len(self._poses))
            self._poses.clear()
        self._poses.append((stamp, raw))
        self._wake_if_idle()

    def _wake_if_idle(self) -> None:
        """Request a call of `work`, unless one is due anyway since a frame is under way.

        In real time states that came while a frame was drawn are read first: the newest counts.
        """
        if not self._begun:
            if self._config.lockstep:
                self.wake()
            else:
                self.wake_later()

    # Output

    def work(self) -> None:
        """Begin the next frame that is due, and finish the one that was begun before."""
        for camera in self._cameras:
            camera.raise_error()
        if self._single is not None and time.monotonic() - self._single_s > _SINGLE_S:
            self._poses.append(self._single)    # no stream: no period will begin
            self._single = None
        finish = bool(self._begun)
        frame = self._take()
        if frame is not None:
            self._newest = frame
        elif not self._begun:
            frame = self._newest    # new subscribers may want more of it
        if frame is not None:
            finish |= self._begin(frame) and not self._config.lockstep
        if finish:
            self._finish(self._begun.popleft())
        if self._begun:
            self.wake_later()
        elif finish and self._poses:
            self._wake_if_idle()

    def _take(self) -> _Frame | None:
        """Take the next frame, if all that it needs has arrived."""
        if not self._poses:
            return None
        lockstep = self._config.lockstep
        stamp, raw = self._poses[0]
        if lockstep and (stamp not in self._joints or not self._readers_are_there()):
            return None
        if lockstep and self._config.await_ground and not self._ground.knows(stamp):
            return None
        if self._begun and self._sun.is_due(stamp):
            return None     # frames under way have the earlier light
        self._poses.popleft()
        joints_raw = self._joints.pop(stamp, None) if lockstep else \
            self._joints.get(stamp, next(reversed(self._joints.values()), None))
        self._sun.announce(stamp)
        state = conversions.rover_pose(raw, joints_raw, self._legs)
        frame = _Frame(stamp, state, self._due.begun(stamp), self._last_with_depth)
        if self._config.depth_period_ns in frame.due:
            self._last_with_depth = state
        return frame

    def _readers_are_there(self) -> bool:
        """Return whether all awaited subscribers have been discovered."""
        while self._awaited and self._pair.is_read(self._awaited[-1]):
            self._awaited.pop()
        return not self._awaited and self._readers.is_complete

    def _begin(self, frame: _Frame) -> bool:
        """Begin what subscribers want of a frame and was not published yet; return if anything."""
        wanted = [camera.wanted(frame.due, frame.published) for camera in self._cameras]
        if not any(wanted):
            return False
        begun_s = time.monotonic()
        world = self._windows.at(frame.stamp_ns)
        if world is not None:
            self._enter(world)
            log_window(self, world, frame.stamp_ns, time.monotonic() - begun_s)
        elif (coming := self._windows.ahead(*frame.state.T_world_base[:2, 3].tolist())):
            self._renderer.ahead(coming)
        if self._ground.is_known and not self._begun and not self._renderer.follows:
            self._renderer.follow(self._ground.overlay)
        self._ground.advance(frame.stamp_ns)
        if not self._begun:
            self._sun.light(frame.stamp_ns)
        names, *of_others = wanted
        for camera, topics_of_it in zip(self._others, of_others):
            if topics_of_it:
                camera.draw(topics_of_it, frame.state, frame.stamp_ns)
                frame.published.update(topics_of_it)
        if not names:
            return False
        layers = self._pair.layers_of(names) - set(frame.layers)
        if frame.before is None:    # there is nothing to flow to
            frame.layers.update(unknown_flows(layers, self._renderer.rig))
            layers -= set(frame.layers)
        self._renderer.begin(frame.state, frame.stamp_ns // self._config.frame_period_ns, layers,
                             frame.before)
        self._begun.append(_Begun(frame, names, layers))
        return True

    def _enter(self, world: World) -> None:
        """Draw another window of the site; frames under way are of the one before."""
        self._renderer.enter(world)
        for camera in self._cameras:
            camera.enter(world)
        self._labels.enter()

    def _finish(self, begun: _Begun) -> None:
        """Take a frame from the renderer and publish it."""
        frame, names, layers = begun
        drawn = self._renderer.finish()
        frame.layers.update((layer, drawn.layer(layer)) for layer in layers)
        if 'left' in layers:
            frame.layers[EXPOSURE] = drawn.exposure_s
        self._pair.publish(names, frame.layers, frame.state, frame.stamp_ns)
        frame.published.update(names)
        if frame is not self._counted:
            self._counted = frame
            self._rate.tick()

    def _frame_rate_status(self) -> SubjectStatus:
        fed, self._is_fed = self._is_fed, False
        return self._rate.status('' if fed else 'No new odometry')
