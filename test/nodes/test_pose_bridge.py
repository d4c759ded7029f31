"""Poses to another simulator: on stand-ins of its two interfaces, and over DDS.

The stand-in of SetEntityState has the fields of simulation_interfaces, version 1, and answers when
it is told to. The last test calls the real service too where the package is installed.
"""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import Pose, PoseStamped, Twist  # noqa: E402  (needs rclpy)
from nav_msgs.msg import Odometry  # noqa: E402
from peer import fails, Peer, running  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns, time_ns  # noqa: E402
from lunar_rover_sim.base.errors import ConfigError  # noqa: E402
from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy  # noqa: E402
from lunar_rover_sim.nodes.pose_bridge_node import EntityStates  # noqa: E402
from lunar_rover_sim.nodes.pose_stream import (BridgedState, FAILED, LossLog,  # noqa: E402
                                               OVERTAKEN, PoseStream, UNANSWERED)
from lunar_rover_sim.rover.description import RoverDescription  # noqa: E402
from lunar_rover_sim.run.companion_config import PoseBridgeNodeConfig  # noqa: E402

BASE, LEG = '/World/Rover/base_link', '/World/Rover/front_left'
OK, NOT_FOUND = 1, 2


class StubFuture:
    """A future whose answer a test gives."""

    def __init__(self, request: Any) -> None:
        self.request = request
        self._callback: Any = None
        self._result: Any = None

    def add_done_callback(self, callback: Any) -> None:
        self._callback = callback

    def result(self) -> Any:
        return SimpleNamespace(result=self._result)

    def answer(self, code: int = OK, message: str = '') -> None:
        """Answer the call."""
        self._result = SimpleNamespace(result=code, error_message=message)
        self._callback(self)


class StubService:
    """Client and type of a SetEntityState that remembers its calls."""

    def __init__(self, **flags: bool) -> None:
        self.calls: list[StubFuture] = []
        self.is_there = True
        self.given_up: list[StubFuture] = []
        self._flags = flags

    def Request(self) -> Any:
        """Return an empty request, as the type does."""
        return SimpleNamespace(entity='', state=SimpleNamespace(
            header=Header(), pose=Pose(), twist=Twist()), **self._flags)

    def service_is_ready(self) -> bool:
        return self.is_there

    def call_async(self, request: Any) -> StubFuture:
        self.calls.append(StubFuture(request))
        return self.calls[-1]

    def remove_pending_request(self, future: StubFuture) -> None:
        self.given_up.append(future)


class Bench:
    """A stream to the stand-in, with a clock that a test sets."""

    def __init__(self, send_twist: bool = False, **flags: bool) -> None:
        self.service = StubService(**flags)
        self.now_s = 100.0
        self.taken: list[int] = []
        self.lost: list[tuple[str, str]] = []
        target = EntityStates(self.service, self.service, OK, 'world', send_twist, lambda f: f)
        self.stream = PoseStream(target, 5.0, self.taken.append,
                                 lambda kind, reason: self.lost.append((kind, reason)),
                                 lambda: self.now_s)

    def put(self, stamp: int, *entities: str) -> None:
        """Give it a state whose entities stand at x = stamp."""
        T = se3(matrix_from_wxyz(wxyz_from_rpy(0.1, 0.2, 0.3)), [stamp, 2.0, 3.0])
        self.stream.put(BridgedState(stamp, dict.fromkeys(entities or (BASE,), T),
                                     np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0])))


def test_one_call_at_a_time() -> None:
    """Entities follow one another; of the states that come meanwhile the newest waits."""
    bench = Bench()
    bench.put(1, BASE, LEG)
    calls = bench.service.calls
    assert [c.request.entity for c in calls] == [BASE]
    state = calls[0].request.state
    assert (state.header.frame_id, time_ns(state.header.stamp)) == ('world', 1)
    q = state.pose.orientation
    assert np.allclose([q.w, q.x, q.y, q.z], wxyz_from_rpy(0.1, 0.2, 0.3))
    assert (state.pose.position.x, state.twist.linear.x) == (1.0, 0.0)
    for stamp in (2, 3, 4):
        bench.put(stamp, BASE, LEG)
    assert len(calls) == 1
    calls[0].answer()
    assert [c.request.entity for c in calls] == [BASE, LEG] and not bench.taken
    calls[1].answer()
    assert bench.taken == [1]
    assert (calls[2].request.entity, calls[2].request.state.pose.position.x) == (BASE, 4.0)
    assert [kind for kind, _ in bench.lost] == [OVERTAKEN] * 2


def test_a_refused_state_is_sent_again_after_a_second() -> None:
    """With the reason; a newer state takes its place; the rest of a refused state is left out."""
    bench = Bench()
    bench.put(1, BASE, LEG)
    bench.service.calls[0].answer(NOT_FOUND, 'no such prim')
    assert bench.lost == [(FAILED, f'{BASE}: no such prim')] and not bench.taken
    bench.stream.advance()
    assert len(bench.service.calls) == 1
    bench.now_s += 1.1
    bench.stream.advance()
    assert bench.service.calls[1].request.state.pose.position.x == 1.0
    bench.service.calls[1].answer(NOT_FOUND)
    assert bench.lost[-1][1] == f'{BASE}: result 2'
    bench.put(7)
    bench.now_s += 1.1
    bench.stream.advance()
    bench.service.calls[2].answer()
    assert bench.taken == [7]


def test_a_silent_service_is_asked_again() -> None:
    """After the time for an answer; an answer that comes too late counts no more."""
    bench = Bench()
    bench.put(1)
    first = bench.service.calls[0]
    bench.now_s += 5.1
    bench.stream.advance()
    assert bench.lost[0][0] == UNANSWERED and bench.service.given_up == [first]
    bench.now_s += 1.1
    bench.stream.advance()
    first.answer()
    assert not bench.taken and len(bench.service.calls) == 2
    bench.service.calls[1].answer()
    assert bench.taken == [1]


def test_the_newest_state_waits_for_a_service_that_is_not_there() -> None:
    """It is sent as soon as the service appears."""
    bench = Bench()
    bench.service.is_there = False
    bench.put(1)
    bench.put(2)
    bench.service.is_there = True
    bench.stream.advance()
    assert bench.service.calls[0].request.state.pose.position.x == 2.0


def test_twist_and_the_flags_of_version_2() -> None:
    """The twist is that of base_link; flags say what is set."""
    bench = Bench(True, set_pose=False, set_twist=False)
    bench.put(1, BASE, LEG)
    bench.service.calls[0].answer()
    base, leg = (call.request for call in bench.service.calls)
    assert (base.state.twist.linear.z, base.state.twist.angular.x) == (3.0, 4.0)
    assert leg.state.twist.angular.x == 0.0
    assert base.set_pose and base.set_twist
    still = Bench(set_pose=False, set_twist=True)
    still.put(1)
    assert not still.service.calls[0].request.set_twist


def test_losses_are_told_once_a_minute() -> None:
    """At once, and then in one line a minute; silence where nothing is lost."""
    lines: list[str] = []
    now_s = [0.0]
    log = LossLog(lines.append, lambda: now_s[0])
    log.advance()
    assert not lines
    log.add(FAILED, 'no such prim')
    for _ in range(590):
        now_s[0] += 0.1
        log.add(OVERTAKEN, 'slow')
    assert lines == ['refused states: 1 (the last one: no such prim)']
    now_s[0] += 2.0
    log.advance()
    log.advance()
    assert lines[1:] == ['overtaken states: 590 (the last one: slow)']


def test_parameters(domain: int) -> None:
    """A name for each entity; without the package one line says what to install."""
    legs = RoverDescription().legs.names
    with pytest.raises(ConfigError, match='leg_entities: .* one for each leg of the rover: front'):
        PoseBridgeNodeConfig(leg_entities=('/a',)).entities_of(legs)
    with pytest.raises(ConfigError, match='valid are names that differ'):
        PoseBridgeNodeConfig(entity='/World/Rover/front_left').entities_of(legs)
    assert PoseBridgeNodeConfig().entities_of(legs)[0] == '/World/Rover/front_left'
    with pytest.raises(ConfigError, match='entity'):
        PoseBridgeNodeConfig(entity='')
    try:
        import simulation_interfaces  # noqa: F401
    except ImportError:
        assert 'apt install ros-jazzy-simulation-interfaces' in fails('pose_bridge_node')


@pytest.mark.ros
def test_over_dds_time_waits_for_the_picture(peer: Peer, world_folder: Path) -> None:
    """OmniLRS's interface in lockstep: no state of a period is left out, the legs move.

    Where simulation_interfaces is installed, a second bridge sets the states by the service.
    """
    poses = peer.listen(PoseStamped, '/OmniLRS/Robots/Teleport', 1)
    joints = peer.listen(JointState, 'pose_bridge/joint_states', 1000)
    states = {'odom': peer.listen(Odometry, 'odom', 1000),
              'joint_states': peer.listen(JointState, 'joint_states', 1000)}
    try:
        from simulation_interfaces.srv import SetEntityState
    except ImportError:
        SetEntityState = None
    calls: list[Any] = []
    lockstep = ('-p', 'time_mode:=lockstep', '-p', 'participants:=[pose_bridge/shown]')
    bridge = ('-p', 'interface:=teleport', '-p', 'entity:=husky', '-p', 'offset.x_m:=10.0', '-p',
              'offset.yaw_deg:=90.0', '-r', 'teleport:=/OmniLRS/Robots/Teleport')
    if SetEntityState is not None:
        def answer(request: Any, response: Any) -> Any:
            calls.append(request)
            response.result.result = OK
            return response

        peer.node.create_service(SetEntityState, 'set_entity_state', answer)
        bridge = ()
    with running('pose_bridge_node', *lockstep, *bridge), \
            running('physics_node', '-p', f'world:={world_folder}', *lockstep, '-p',
                    'wait.topics:=[pose_bridge/shown]', '-p', 'wait.lags_s:=[0.1]'):
        shown = calls if SetEntityState is not None else poses
        # The reader of the states may join later than that of the bridge.
        peer.spin_until(lambda: len(shown) >= 10 and len(joints) >= 5 and bool(
            {header_ns(m) for m in joints} & {header_ns(m) for m in states['joint_states']}))
    stamps = [header_ns(joint) for joint in joints]
    # Who takes no part may join late.
    assert stamps == [stamps[0] + 100_000_000 * k for k in range(len(stamps))]
    odometry = {header_ns(m): m for m in states['odom']}
    legs = {header_ns(m): m for m in states['joint_states']}
    # So may this test: it compares what it has of both.
    both = [joint for joint in joints if header_ns(joint) in legs]
    assert both and all(list(joint.position) == list(legs[header_ns(joint)].position)
                        for joint in both)
    if SetEntityState is not None:
        assert [call.entity for call in calls[:3]] == [BASE, LEG, '/World/Rover/front_right']
        state = next(call.state for call in calls[::5]
                     if time_ns(call.state.header.stamp) in odometry)
        at, there = state.pose.position, odometry[time_ns(state.header.stamp)].pose.pose.position
        assert (at.x, at.y, at.z) == pytest.approx((there.x, there.y, there.z))
        return
    there = next(pose for pose in poses if header_ns(pose) in odometry)
    here = odometry[header_ns(there)].pose.pose.position
    assert there.header.frame_id == 'husky'
    at = there.pose.position
    assert (at.x, at.y, at.z) == pytest.approx((10.0 - here.y, here.x, here.z))
