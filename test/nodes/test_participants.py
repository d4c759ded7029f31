"""Who takes part in lockstep: what works, what is refused at once, how answers are judged."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time
from types import SimpleNamespace
from typing import Any

from conftest import BLIND, command, PLAIN, SMALL, TINY
import numpy as np
import pytest
from waiting import LIMIT_S, wait_until

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')


from builtin_interfaces.msg import Time  # noqa: E402  (needs rclpy)
from geometry_msgs.msg import PoseStamped, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from peer import ended, LEGS, Peer, running  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import Image, JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from lunar_rover_sim.bag.messages import header_ns  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base import topics  # noqa: E402
from lunar_rover_sim.base.errors import GraphError  # noqa: E402
from lunar_rover_sim.base.files.paths import config_folder  # noqa: E402
from lunar_rover_sim.nodes import lockstep_listener  # noqa: E402
from lunar_rover_sim.nodes.gait_controller_node import GaitControllerNode  # noqa: E402
from lunar_rover_sim.nodes.message_types import message_class  # noqa: E402
from lunar_rover_sim.nodes.qos import loss_events  # noqa: E402
from lunar_rover_sim.nodes.reader_discovery import ReaderDiscovery  # noqa: E402
from lunar_rover_sim.run.node_processes import NodeProcesses  # noqa: E402
from lunar_rover_sim.run.plan import prepare, resolve  # noqa: E402
from lunar_rover_sim.run.ros_domain import check_domain  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402
from lunar_rover_sim.run.transforms import tf_message  # noqa: E402

WAIT = ('-p', 'time_mode:=lockstep', '-p', 'wait.topics:=[joint_commands]', '-p',
        'wait.lags_s:=[0.0]')


def refusal(peer: Peer, world: Path, meanwhile: Any = lambda: None) -> str:
    """Return the last line of a physics_node that must end soon after it is ready."""
    with tempfile.NamedTemporaryFile('w+') as log:
        process = subprocess.Popen(
            [sys.executable, '-m', 'lunar_rover_sim.nodes.entry_points', 'physics_node',
             '--ros-args', '-p', f'world:={world}', *WAIT], stderr=log)
        try:
            peer.spin_until(lambda: 'FATAL' in Path(log.name).read_text(),
                            meanwhile=meanwhile)
            text = Path(log.name).read_text()
            ready = re.search(r'\[([0-9.]+)\] \[physics_node\]: ready', text)
            assert ready and time.time() - float(ready[1]) < 30.0
            assert process.wait(LIMIT_S) == 1
            return text.strip().splitlines()[-1]
        finally:
            process.kill()
            process.wait()


def test_a_controller_with_default_qos_answers_every_state(peer: Peer,
                                                           world_folder: Path) -> None:
    """RELIABLE, VOLATILE, KEEP_LAST 10: no state is missed from the first on."""
    stamps: list[int] = []
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 10)

    def answer(state: JointState) -> None:
        stamps.append(header_ns(state))
        publisher.publish(JointState(header=state.header, name=LEGS, velocity=[1.0] * 4))

    peer.node.create_subscription(JointState, 'joint_states', answer, 10)
    with running('physics_node', '-p', f'world:={world_folder}', *WAIT):
        peer.spin_until(lambda: len(stamps) > 200)
    assert stamps == [5_000_000 * (k + 1) for k in range(len(stamps))]


@pytest.mark.parametrize('late', [0, 1])
def test_a_command_acts_when_it_may_come_at_the_latest(peer: Peer, world_folder: Path,
                                                       late: int) -> None:
    """With a lag of two states answers may be one late, and it makes no difference whether."""
    states: list[JointState] = []
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 10)

    def answer(state: JointState) -> None:
        states.append(state)
        if len(states) > late:
            answered = states[-1 - late].header
            velocity = [4.0 if header_ns(states[-1 - late]) >= 250_000_000 else 0.0] * 4
            publisher.publish(JointState(header=answered, name=LEGS, velocity=velocity))

    peer.node.create_subscription(JointState, 'joint_states', answer, 10)
    with running('physics_node', '-p', f'world:={world_folder}', *WAIT[:-1],
                 'wait.lags_s:=[0.01]'):
        peer.spin_until(lambda: len(states) > 60)
    torques = {header_ns(state) // 1_000_000: abs(state.effort[0]) for state in states}
    # The answer to the state of 250 ms acts from 255 ms on, so the state of 260 ms shows it.
    assert torques[255] < 0.1 < torques[260]


@pytest.mark.parametrize(('offered', 'requested', 'said'), [
    ({'reliability': ReliabilityPolicy.BEST_EFFORT}, {},
     r'peer offers BEST_EFFORT, .* as QoSProfile\(depth=10\)'),
    ({}, {'durability': DurabilityPolicy.TRANSIENT_LOCAL},
     '/odom: peer cannot read it: it requests TRANSIENT_LOCAL')])
def test_a_participant_that_would_lose_messages_is_refused(
        peer: Peer, offered: dict[str, Any], requested: dict[str, Any], said: str) -> None:
    """BEST_EFFORT does not match; a durable reader gets nothing of a volatile publisher."""
    odometry = peer.node.create_publisher(Odometry, 'odom', 10)
    peer.node.create_publisher(JointState, 'joint_commands', QoSProfile(depth=10, **offered))
    peer.listen(Odometry, 'odom', QoSProfile(depth=10, **requested))
    matching = ReaderDiscovery(peer.node, [odometry], ['joint_commands'])
    with pytest.raises(GraphError, match=said):
        peer.spin_until(lambda: matching.is_complete)


def test_an_answer_without_a_stamp_is_refused(peer: Peer, world_folder: Path) -> None:
    """It answers no state: time would wait for ever."""
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 10)
    line = refusal(peer, world_folder, lambda: publisher.publish(
        JointState(name=LEGS, velocity=[0.0] * 4)))
    assert 'joint_commands: stamp 0 (from peer) is no answer' in line


def test_physics_gives_the_gait_controller_the_time_of_whom_it_waits_for(
        peer: Peer, world_folder: Path) -> None:
    """Somebody's first velocity may take as long as a first answer, though legs have answered."""
    peer.node.create_publisher(TwistStamped, 'cmd_vel', 10)
    commands = peer.node.create_publisher(JointState, 'joint_commands', 10)
    answered: list[int] = []

    def answer(state: JointState) -> None:
        if not answered:
            answered.append(header_ns(state))
            commands.publish(JointState(header=state.header, name=LEGS, velocity=[0.0] * 4))

    peer.node.create_subscription(JointState, 'joint_states', answer, 10)
    # As long as a busy machine takes to bring node and peer together.
    with ended('physics_node', '-p', f'world:={world_folder}', *WAIT, '-p', 'wait.start_s:=8.0',
               '-p', 'wait.silence_s:=0.1', '-p', 'participants:=[cmd_vel]') as errors:
        peer.spin_until(lambda: bool(answered))
    assert answered == [5_000_000]
    assert errors[-1] == ('FATAL nothing on joint_commands (from peer) since 0.005 s; '
                          'physics_node waits for it at 0.010 s of simulated time, 8 s so far')


def test_a_lost_answer_ends_the_run(peer: Peer, world_folder: Path) -> None:
    """The queue of its publisher holds one: what overflows is lost, and the topic is named."""
    publisher = peer.node.create_publisher(JointState, 'joint_commands', 1)
    states = peer.listen(JointState, 'joint_states')

    def burst() -> None:
        if states:
            for _ in range(2000):
                publisher.publish(JointState(header=states[-1].header, name=LEGS * 100,
                                             velocity=[0.0] * 400))

    line = refusal(peer, world_folder, burst)
    assert 'joint_commands: ' in line and 'messages of peer are lost' in line
    assert 'a depth of at least its lag' in line


def test_a_domain_in_use_is_refused(peer: Peer, domain: int) -> None:
    """Somebody publishes a topic of the run; other topics do no harm."""
    peer.node.create_publisher(Odometry, 'odom', 10)
    check_domain(domain, ['/clock'])
    with pytest.raises(GraphError, match=f'--domain {domain}: peer publishes /odom there'):
        check_domain(domain, ['/clock', '/odom'])


def test_a_run_joins_a_graph_that_publishes_tf(tmp_path: Path, open_domain: int) -> None:
    """A stack that was started first goes on with its frames, some at wall time or late.

    Without --join the run says how to; topics of which there can be one are refused all the same.
    The domain is that of the shell, or named.
    """
    peer = Peer()
    try:
        tf = peer.node.create_publisher(message_class(topics.TF.type), 'tf', 10)
        clock = peer.listen(Clock, 'clock')
        named = '--domain', str(open_domain)
        arguments = command('run', 'baseline', '--duration', '0.5', *BLIND, *(
            word for setting in SMALL for word in ('--set', setting)))

        def publish() -> None:
            now_ns = clock[-1].clock.sec * 10**9 + clock[-1].clock.nanosec if clock else 0
            for child, stamp_ns in (('late', now_ns - 50_000_000), ('wall', time.time_ns())):
                tf.publish(tf_message([('odom', child, np.eye(4))], max(0, stamp_ns)))

        def finished(*more: str) -> str:
            run = subprocess.Popen([*arguments, *more], stdout=subprocess.PIPE,
                                   stderr=subprocess.STDOUT, text=True)
            peer.spin_until(lambda: run.poll() is not None, publish)
            return ' '.join(run.communicate()[0].split())

        assert 'peer publishes /tf there; take part in its graph with --join' in finished(
            *named, '-o', str(tmp_path / 'refused'))
        lines = finished('-o', str(tmp_path / 'run'), '--join')
        assert '/tf: is stamped more than 5 s after /clock (with wall time?)' in lines
        with open_bag(tmp_path / 'run' / 'bag') as bag:
            assert bag.end_ns <= 600_000_000
            children = {transform.child_frame_id for _, _, message in bag.messages(['/tf'])
                        for transform in message.transforms}
        assert children > {'base_link', 'late', 'wall'}
        peer.node.create_publisher(Odometry, 'odom', 10)
        assert 'peer publishes /odom there; stop it' in finished(
            *named, '-o', str(tmp_path / 'second'), '--join')
    finally:
        peer.node.destroy_node()
        rclpy.try_shutdown()


# In real time a program may take a while to be heard.
DURATION_S = {'lockstep': 0.5, 'real_time': 1.0}


@pytest.mark.parametrize('template, time_mode', [
    ('controller', 'lockstep'), ('controller', 'real_time'), ('estimator', 'lockstep'),
    ('teleop', 'real_time')])
def test_templates(template: str, time_mode: str, tmp_path: Path, world_folder: Path,
                   domain: int) -> None:
    """What is there to be copied drives the rover, or is awaited and recorded with its stamps."""
    nodes = 'physics_node, gait_controller_node, recorder_node'
    waits = {'controller': ['gait_controller_node.wait.topics=[cmd_vel]',
                            'gait_controller_node.wait.lags_s=[0.05]'],
             'estimator': ['physics_node.wait.topics=[slam/pose]',
                           'physics_node.wait.lags_s=[0.3]', *TINY, *PLAIN]}
    if template == 'estimator':
        nodes += ', render_node'
    scenario = resolve(Scenario.load('flat', [
        f'time_mode={time_mode}', f'run.nodes=[{nodes}]', 'physics_node.ground.model=rigid',
        *waits.get(template, [])], duration_s=DURATION_S[time_mode]))
    folder = tmp_path / 'run'
    plans = prepare(scenario, folder, world_folder)
    program = subprocess.Popen([sys.executable, config_folder() / 'templates' / f'{template}.py'],
                               stdin=subprocess.PIPE, text=True)
    assert program.stdin is not None
    if template == 'teleop':
        program.stdin.write('0.1 0.0\n')
        program.stdin.flush()
    try:
        with NodeProcesses(plans, folder, domain) as graph:
            wait_until(graph.has_finished)
    finally:
        program.kill()
        program.wait()
    with open_bag(folder / 'bag') as bag:
        topic = '/slam/pose' if template == 'estimator' else '/cmd_vel'
        stamps = [bag.stamp_ns(message) for message in bag.raw([topic])]
        if time_mode == 'lockstep':
            assert stamps == list(range(50_000_000, 500_000_001, 50_000_000))
        else:
            assert stamps


def test_the_template_of_an_estimator_answers_whichever_image_comes_first(peer: Peer) -> None:
    stamps: list[int] = []
    peer.node.create_subscription(PoseStamped, 'slam/pose',
                                  lambda pose: stamps.append(header_ns(pose)), 10)
    sides = [peer.node.create_publisher(Image, f'stereo/{side}/image_raw', 10)
             for side in ('right', 'left')]
    program = subprocess.Popen([sys.executable, config_folder() / 'templates' / 'estimator.py'])
    try:
        peer.spin_until(lambda: all(side.get_subscription_count() for side in sides))
        for second, order in ((1, sides), (2, sides[::-1])):
            for publisher in order:
                publisher.publish(Image(header=Header(stamp=Time(sec=second))))
                assert publisher.wait_for_all_acked()
            peer.spin_until(lambda: len(stamps) == second)
    finally:
        program.kill()
        program.wait()
    assert stamps == [10**9, 2 * 10**9]


def test_refused_velocities_are_counted_to_the_last(peer: Peer) -> None:
    """The log has at most a line a second, and at the end the full count."""
    velocities = peer.node.create_publisher(TwistStamped, 'cmd_vel', 1000)
    bad = TwistStamped()
    bad.twist.linear.x = float('nan')
    with running('gait_controller_node') as process:
        peer.spin_until(lambda: velocities.get_subscription_count() > 0)
        for _ in range(8):      # of a queue of 10
            velocities.publish(bad)
        assert velocities.wait_for_all_acked()
        assert process.stdout is not None
        lines = [process.stdout.readline()]
        while 'refused' not in lines[-1]:
            lines.append(process.stdout.readline())
        assert '(1 so far)' in lines[-1]
        time.sleep(0.3)     # the last ones are acknowledged before they are handled
        process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
    told = re.findall(r'linear.x = nan, angular.z = 0.0 refused \((\d+) so far\)', rest)
    assert told and told[-1] == '8'


@pytest.mark.parametrize('time_mode', ['real_time', 'lockstep'])
def test_a_flood_of_answers_locks_nothing_up(peer: Peer, world_folder: Path,
                                             time_mode: str) -> None:
    """Most are lost: nobody waits for them in real time, in lockstep it is an error.

    In real time nothing tells of losses, which is what locked up; fewer show that it goes on.
    """
    assert loss_events(topics.CMD_VEL, print) is None
    count = 600_000 if time_mode == 'lockstep' else 100_000
    publisher = peer.node.create_publisher(TwistStamped, 'cmd_vel', 10)
    arguments = ('-p', f'world:={world_folder}', '-p', f'time_mode:={time_mode}', '-p',
                 'wait.topics:=[cmd_vel]', '-p', 'wait.lags_s:=[0.05]')

    def flood() -> None:
        peer.spin_until(lambda: publisher.get_subscription_count() > 0)
        message = TwistStamped(header=Header(stamp=Time(nanosec=1)))
        for k in range(count):
            publisher.publish(message)
            if k % 1000 == 0 and not publisher.get_subscription_count():
                break       # it has ended

    if time_mode == 'lockstep':
        with ended('physics_node', *arguments) as errors:
            flood()
        assert re.match('FATAL cmd_vel: messages of .* are lost', errors[-1])
    else:
        with running('physics_node', *arguments):
            flood()


STATE_NS = 50_000_000
WALL_TIME = 1_700_000_000
SILENCE_S = 0.4


class Gait:
    """A gait controller that waits for cmd_vel in lockstep, in simulated time 50 ms.

    Its wall clock stands still unless a test moves it.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.wall_s = 100.0
        monkeypatch.setattr(lockstep_listener, 'time',
                            SimpleNamespace(monotonic=lambda: self.wall_s))
        self.node = GaitControllerNode()
        self._callbacks = {subscription.topic_name: subscription.callback
                           for subscription in self.node.subscriptions}

    def velocity(self, stamp: Time) -> None:
        """Hand the node a velocity, as its executor does."""
        self._callbacks['/cmd_vel'](TwistStamped(header=Header(stamp=stamp)))

    def state(self) -> None:
        """Hand the node the state of 50 ms, as its executor does."""
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4)
        state.header.stamp.nanosec = STATE_NS
        self._callbacks['/joint_states'](state)

    def watch(self) -> None:
        """Let the node watch."""
        for timer in self.node.timers:
            timer.callback()

    def failure(self) -> str:
        """Let the node watch for longer than somebody may be silent; return its error."""
        self.wall_s += SILENCE_S + 0.1
        self.watch()
        return str(self.node.failure or '')


@contextmanager
def gait_controller(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Iterator[Gait]:
    """Give the node in this process."""
    rclpy.init(args=['--ros-args', '-p', 'time_mode:=lockstep', '-p', 'wait.topics:=[cmd_vel]',
                     '-p', 'wait.lags_s:=[0.05]', *arguments])
    gait = Gait(monkeypatch)
    try:
        yield gait
    finally:
        gait.node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture()
def gait(domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Give a gait controller in a domain of its own."""
    with gait_controller(monkeypatch, '-p', f'wait.silence_s:={SILENCE_S}', '-p',
                         f'wait.start_s:={SILENCE_S}') as controller:
        yield controller


@pytest.mark.parametrize('order', ['before', 'after'])
def test_stamps_of_another_clock_are_no_answer(gait: Gait, order: str) -> None:
    """Wall time in simulated time opens the gate neither before nor after the first state."""
    actions = [lambda: gait.velocity(Time(sec=WALL_TIME)), gait.state]
    for action in actions if order == 'before' else reversed(actions):
        action()
    assert gait.failure() == (
        'nothing on cmd_vel (from nobody, no publisher) since 0.000 s (1 stamps refused); '
        'gait_controller_node waits for it at 0.050 s of simulated time, '
        f'{SILENCE_S:g} s so far')


@pytest.mark.parametrize('order', ['before', 'after'])
def test_an_answer_counts_in_either_order(gait: Gait, order: str) -> None:
    """Who is quick and answers 50 ms before this node knows of it has answered."""
    actions = [lambda: gait.velocity(Time(nanosec=STATE_NS)), gait.state]
    for action in actions if order == 'before' else reversed(actions):
        action()
    assert not gait.failure()


def test_of_several_early_answers_each_is_judged(gait: Gait) -> None:
    """One of another clock does not spoil the valid one before it."""
    gait.velocity(Time(nanosec=STATE_NS))
    gait.velocity(Time(sec=WALL_TIME))
    gait.state()
    assert not gait.failure()


def test_a_long_wait_is_told_before_it_is_an_error(
        domain: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """Who waits says so: a warning once, later waits in the log."""
    with gait_controller(monkeypatch) as gait:
        gait.velocity(Time(sec=WALL_TIME))
        gait.state()
        for _ in range(2):
            gait.wall_s += 4.1
            for _ in range(2):
                gait.watch()
            assert gait.node.failure is None
            gait.velocity(Time(nanosec=1))
    lines = [line for line in capfd.readouterr().err.splitlines() if '3 s so far' in line]
    assert [line.split(']')[0] for line in lines] == ['[WARN', '[INFO']
    assert all('nothing on cmd_vel (from' in line and line.endswith('waits for up to 60 s')
               for line in lines)


def test_time_without_a_state_is_no_silence(gait: Gait) -> None:
    """Physics that is started late, or was paused, leaves the others their full time."""
    gait.wall_s += SILENCE_S + 0.1
    gait.state()
    gait.watch()
    assert gait.node.failure is None
    assert gait.failure().endswith(f', {SILENCE_S:g} s so far')
