"""A late reader gets the present; time that goes back; QoS overrides; use_sim_time."""

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
import dataclasses
from pathlib import Path
import signal
import time

from conftest import PLAIN, SMALL_WORLD, TINY
import numpy as np
import pytest
from waiting import wait_until

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import Peer, PLAIN_DETAIL, running, SMALL_CAMERA  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image, JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns, time_ns  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.nodes.ground_listener import GroundListener  # noqa: E402
from lunar_rover_sim.run.node_processes import NodeProcesses  # noqa: E402
from lunar_rover_sim.run.plan import prepare, resolve  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

STATE_NS, FRAME_NS = 5_000_000, 100_000_000


@contextmanager
def physics(peer: Peer, world: Path, *arguments: str) -> Iterator[list[Clock]]:
    """Run physics for a simulated second; give its clock messages."""
    with running('physics_node', '-p', f'world:={world}', *arguments):
        clock = peer.listen(Clock, 'clock')
        peer.spin_until(lambda: bool(clock) and time_ns(clock[-1].clock) > 1_000_000_000)
        yield clock


@pytest.mark.alone
def test_a_late_reader_gets_the_present_state_and_image(peer: Peer, world_folder: Path) -> None:
    """The first message is less than two periods old; latched topics come all the same."""
    with ExitStack() as stack:
        stack.enter_context(running('render_node', '-p', f'world:={world_folder}', *SMALL_CAMERA,
                                    *PLAIN_DETAIL))
        clock = stack.enter_context(physics(peer, world_folder))
        image = peer.echo(Image, 'stereo/left/image_raw')
        peer.spin_until(lambda: bool(image))    # that of the shown frame, drawn for this reader
        for topic, kind, period_ns in (('odom', Odometry, STATE_NS),
                                       ('stereo/left/image_raw', Image, FRAME_NS)):
            messages = peer.echo(kind, topic)
            joined_ns = time_ns(clock[-1].clock)
            peer.spin_until(lambda messages=messages: bool(messages))
            assert header_ns(messages[0]) > joined_ns - 2 * period_ns, topic
        description = peer.echo(String, 'robot_description')
        peer.spin_until(lambda: bool(description))


def test_in_lockstep_a_late_reader_gets_nothing_of_the_past(peer: Peer,
                                                            world_folder: Path) -> None:
    """Physics that waits for nobody stands still at its end: there is only a past."""
    with physics(peer, world_folder, '-p', 'time_mode:=lockstep') as clock:
        odometry = peer.echo(Odometry, 'odom')
        joined_ns = time_ns(clock[-1].clock)
        peer.spin_until(lambda: bool(odometry))
        assert header_ns(odometry[0]) > joined_ns - 2 * STATE_NS


def test_a_recorder_that_starts_late_records_from_then_on(peer: Peer, world_folder: Path,
                                                          tmp_path: Path) -> None:
    """No odometry of the time before it; commands with wall time do not stretch the bag."""
    commands = peer.node.create_publisher(TwistStamped, 'cmd_vel', 10)
    command = TwistStamped()
    command.header.stamp.sec = 1_700_000_000

    def send() -> None:
        commands.publish(command)

    with physics(peer, world_folder) as clock:
        before_ns = time_ns(clock[-1].clock)
        with running('recorder_node', '-p', f'output:={tmp_path / "bag"}', '-p',
                     'topics:=[odom, clock, cmd_vel]') as recorder:
            peer.spin_until(lambda: any(
                info.node_name == 'recorder_node'
                for info in peer.node.get_subscriptions_info_by_topic('/odom')))
            joined_ns = time_ns(clock[-1].clock)
            peer.spin_until(lambda: time_ns(clock[-1].clock) > joined_ns + 500_000_000
                            and peer.node.count_subscribers('cmd_vel') > 0)
            joined_ns = time_ns(clock[-1].clock)
            peer.spin_until(lambda: time_ns(clock[-1].clock) > joined_ns + 500_000_000,
                            meanwhile=send)
            recorder.send_signal(signal.SIGINT)
            log = recorder.stdout.read()
    assert log.count('/cmd_vel: is stamped more than 5 s after /clock (with wall time?)') == 1
    with open_bag(tmp_path / 'bag') as bag:
        stamps = [bag.stamp_ns(message) for message in bag.raw(['/odom'])]
        assert bag.counts['/cmd_vel'] > 0
        assert max(message.time_ns for message in bag.raw()) < joined_ns + 60_000_000_000
    assert stamps[0] > before_ns
    assert len(stamps) > 10


def test_diagnostics_are_recorded_at_the_time_of_their_arrival(peer: Peer,
                                                               tmp_path: Path) -> None:
    """Also those before the first message of the clock; nobody is warned of them."""
    diagnostics = peer.node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    odometry = peer.node.create_publisher(Odometry, 'odom', 10)
    status, state = DiagnosticArray(), Odometry()
    status.header.stamp.sec, state.header.stamp.sec = 1_700_000_000, 3
    with running('recorder_node', '-p', f'output:={tmp_path / "bag"}', '-p',
                 'topics:=[odom, diagnostics]') as recorder:
        peer.spin_until(lambda: diagnostics.get_subscription_count() > 0
                        and odometry.get_subscription_count() > 0)
        diagnostics.publish(status)
        time.sleep(0.5)
        odometry.publish(state)
        time.sleep(0.5)
        diagnostics.publish(status)
        time.sleep(0.5)
        recorder.send_signal(signal.SIGINT)
        log = recorder.stdout.read()
    assert 'wall time' not in log
    with open_bag(tmp_path / 'bag') as bag:
        times_s = [message.time_ns // 10**9 for message in bag.raw(['/diagnostics'])
                   if bag.stamp_ns(message) == 1_700_000_000 * 10**9]
    assert times_s == [0, 3]


def test_qos_overrides_and_use_sim_time_work(peer: Peer, world_folder: Path) -> None:
    """A durable odometry, by the parameter that ROS 2 defines: a late reader gets the first.

    `running` checks that physics alone ends at Ctrl-C under use_sim_time, too.
    """
    with physics(peer, world_folder, '-p', 'use_sim_time:=true', '-p',
                 'qos_overrides./odom.publisher.durability:=transient_local', '-p',
                 'qos_overrides./odom.publisher.depth:=3'):
        odometry = peer.echo(Odometry, 'odom')
        peer.spin_until(lambda: len(odometry) > 3)
        infos = peer.node.get_publishers_info_by_topic('/odom')
        assert [info.qos_profile.durability.name for info in infos] == ['TRANSIENT_LOCAL']
        infos = peer.node.get_publishers_info_by_topic('/imu/data_raw')
        assert [info.qos_profile.durability.name for info in infos] == ['VOLATILE']


def test_every_node_works_with_use_sim_time(world_folder: Path, tmp_path: Path,
                                            domain: int) -> None:
    """As SetParameter('use_sim_time', True) gives it: time goes on, frames and commands come.

    Without it: every other test.
    """
    scenario = resolve(Scenario.load('baseline', [
        'time_mode=lockstep', *SMALL_WORLD, *PLAIN, *TINY], duration_s=0.5))
    folder = tmp_path / 'run'
    plans = [dataclasses.replace(plan, parameters={**plan.parameters, 'use_sim_time': True})
             for plan in prepare(scenario, folder, world_folder)]
    with NodeProcesses(plans, folder, domain) as nodes:
        wait_until(nodes.has_finished)
    with open_bag(folder / 'bag') as bag:
        assert bag.counts['/joint_commands'] > 50
        assert bag.counts['/stereo/left/image_raw'] > 1
        assert bag.counts['/cmd_vel'] > 3


def test_a_late_reader_has_the_ground_exactly(peer: Peer, world_folder: Path) -> None:
    """The snapshot and the later changes give what a reader from the start has."""
    soft = ('-p', 'ground.model:=regolith')
    early = GroundListener(peer.node, lambda: None)     # type: ignore[arg-type]
    with physics(peer, world_folder, *soft) as clock:
        peer.spin_until(lambda: early.knows(1_000_000_000))
        late = GroundListener(peer.node, lambda: None)  # type: ignore[arg-type]
        joined_ns = time_ns(clock[-1].clock)
        at_ns = joined_ns // FRAME_NS * FRAME_NS + 5 * FRAME_NS
        peer.spin_until(lambda: early.knows(at_ns) and late.knows(at_ns))
    for listener in (early, late):
        listener.advance(at_ns)
    first, second = early.overlay.snapshot(), late.overlay.snapshot()
    assert len(first) > 20      # it has sunk in
    np.testing.assert_array_equal(first.index, second.index)
    np.testing.assert_array_equal(first.height_m, second.height_m)
    np.testing.assert_array_equal(first.compaction_m, second.compaction_m)


@pytest.mark.alone
def test_every_node_goes_on_when_time_restarts(peer: Peer, world_folder: Path,
                                               tmp_path: Path) -> None:
    """Physics restarts: commands and frames come for the new time, one log line a node.

    All frames, the first one too, have stamps on the period.
    """
    world = '-p', f'world:={world_folder}'
    answers = {topic: peer.listen(kind, topic) for topic, kind in (
        ('cmd_vel', TwistStamped), ('joint_commands', JointState),
        ('stereo/left/camera_info', CameraInfo))}

    def answered(low_s: float, high_s: float, since: dict[str, int]) -> bool:
        return all(any(low_s < header_ns(m) / 1e9 < high_s for m in messages[since[topic]:])
                   for topic, messages in answers.items())

    with ExitStack() as stack:
        nodes = {name: stack.enter_context(running(name, *arguments)) for name, arguments in (
            ('drive_node', ('-p', 'mode:=spline', '-p', 'shape:=circle')),
            ('gait_controller_node', ()),
            ('render_node', (*world, *SMALL_CAMERA, *PLAIN_DETAIL)),
            ('recorder_node', ('-p', f'output:={tmp_path / "bag"}', '-p',
                               'topics:=[odom, clock]')))}
        peer.spin_until(lambda: peer.node.count_publishers('stereo/left/camera_info') > 0)
        stack.enter_context(running('physics_node', *world))
        peer.spin_until(lambda: answered(2.0, 1e9, dict.fromkeys(answers, 0)))
        response = peer.call(Trigger, 'physics_node/restart', Trigger.Request())
        assert response.success and 'time begins at 0' in response.message
        since = {topic: len(messages) for topic, messages in answers.items()}
        peer.spin_until(lambda: answered(0.0, 1.5, since))
        # The recorder answers nobody: it is given the time that the others took, and more.
        peer.spin_until(lambda: answered(1.0, 3.0, since))
        for name, node in nodes.items():
            node.send_signal(signal.SIGINT)
            lines = [line for line in node.stdout if 'time has gone back' in line]
            assert len(lines) == 1, name
    stamps = [header_ns(info) for info in answers['stereo/left/camera_info']]
    assert all(stamp % 100_000_000 == 0 for stamp in stamps)
    with open_bag(tmp_path / 'bag') as bag:
        odometry = [bag.stamp_ns(message) for message in bag.raw(['/odom'])]
    # Both times are in the bag, so stamps are there twice.
    assert len(odometry) - len(set(odometry)) > 50


def test_lockstep_goes_on_after_reset_and_restart(peer: Peer, world_folder: Path) -> None:
    """~/reset: every stamp once. ~/restart: time begins at one period, nobody stalls."""
    states = peer.listen(JointState, 'joint_states', 50_000)
    lockstep = ('-p', 'time_mode:=lockstep', '-p', 'participants:=[joint_commands, cmd_vel]')

    def reached(second: float) -> bool:
        return bool(states) and header_ns(states[-1]) / 1e9 > second

    def jumps() -> list[int]:
        return [k for k, (a, b) in enumerate(zip(states, states[1:]), 1)
                if header_ns(b) < header_ns(a)]

    with ExitStack() as stack:
        for name, arguments in (
                ('drive_node', ('-p', 'mode:=spline', '-p', 'shape:=circle')),
                ('gait_controller_node', ('-p', 'wait.topics:=[cmd_vel]', '-p',
                                          'wait.lags_s:=[0.05]')),
                ('physics_node', ('-p', f'world:={world_folder}', '-p',
                                  'wait.topics:=[joint_commands]', '-p', 'wait.lags_s:=[0.0]'))):
            stack.enter_context(running(name, *lockstep, *arguments))
        peer.spin_until(lambda: reached(0.5))
        assert peer.call(Trigger, 'physics_node/reset', Trigger.Request()).success
        later_s = header_ns(states[-1]) / 1e9 + 0.5
        peer.spin_until(lambda: reached(later_s))
        assert peer.call(Trigger, 'physics_node/restart', Trigger.Request()).success
        # States of the time before are still on their way.
        peer.spin_until(lambda: bool(jumps()))
        peer.spin_until(lambda: len(states) > jumps()[0] + 100)
    stamps = [header_ns(state) for state in states]
    first, = jumps()
    # Who takes no part may join late.
    assert stamps[:first] == [stamps[0] + 5_000_000 * k for k in range(first)]
    assert stamps[first:] == [5_000_000 * (k + 1) for k in range(len(stamps) - first)]
