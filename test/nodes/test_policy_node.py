"""policy_node: it answers as the gait controller does, pairs states with the IMU, and stands."""

from collections.abc import Iterator
from pathlib import Path
import signal
import threading
import time
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip('rclpy')
onnx = pytest.importorskip('onnx')

from geometry_msgs.msg import TwistStamped  # noqa: E402
from peer import LEGS, Peer, running  # noqa: E402
from sensor_msgs.msg import Imu, JointState  # noqa: E402

from lunar_rover_sim.autonomy.learning.controller import PolicyController  # noqa: E402
from lunar_rover_sim.autonomy.learning.policy_file import save_policy  # noqa: E402
from lunar_rover_sim.autonomy.learning.senses import Sample  # noqa: E402
from lunar_rover_sim.autonomy.learning.tasks import make_task  # noqa: E402
from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.base.errors import LearningError, LunarRoverSimError  # noqa: E402
from lunar_rover_sim.nodes.conversions import time_msg  # noqa: E402
from lunar_rover_sim.nodes.policy_node import PolicyNode  # noqa: E402
from lunar_rover_sim.rover.description import load_rover  # noqa: E402
from lunar_rover_sim.run.recording import record  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402
from lunar_rover_sim.run.scenario_options import with_policy  # noqa: E402

TIMEOUT_S = 0.2


@pytest.fixture(scope='module')
def policy_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a policy with random weights."""
    path = tmp_path_factory.mktemp('policy') / 'walk.onnx'
    task, rng = make_task('walk', {'ground': 'rigid'}), np.random.default_rng(2)
    layers = [(rng.normal(0.0, 0.2, (4, len(task.channels))), rng.normal(0.0, 0.3, 4))]
    save_policy(path, layers, task, {'algorithm': 'none', 'decisions': 0, 'seeds': [1]})
    return path


def test_a_run_is_walked_by_the_policy(policy_file: Path, tmp_path: Path) -> None:
    """Each state is answered, with what the policy gives for the recorded messages."""
    scenario = Scenario.load('flat', {
        'run.nodes': ['physics_node', 'gait_controller_node', 'drive_node', 'recorder_node'],
        'world.size_m': 12.8, 'world.surroundings.samples': 257,
        'physics_node.ground.model': 'rigid'}, duration_s=1.5)
    scenario = with_policy(scenario, policy_file)
    assert 'gait_controller_node' not in scenario.run.nodes
    recording = record(scenario, tmp_path / 'run')
    names = ('joint_states', 'imu/data_raw', 'cmd_vel', 'joint_commands')
    found: dict[str, dict[int, Any]] = {name: {} for name in names}
    assert recording.bag is not None
    with open_bag(recording.bag) as bag:
        for topic, _, message in bag.messages([f'/{name}' for name in names]):
            stamp = message.header.stamp
            found[topic.lstrip('/')][stamp.sec * 10**9 + stamp.nanosec] = message
    states, commands = found['joint_states'], found['joint_commands']
    assert list(commands) == list(states)[:len(commands)] and len(commands) >= 200
    controller = PolicyController.load(policy_file, load_rover())
    largest = 0.0
    for stamp_ns, state in states.items():
        if stamp_ns not in commands:
            break
        if stamp_ns in found['cmd_vel']:
            twist = found['cmd_vel'][stamp_ns].twist
            controller.set_velocity(twist.linear.x, twist.angular.z, stamp_ns)
        imu = found['imu/data_raw'][stamp_ns]
        rate, force = imu.angular_velocity, imu.linear_acceleration
        expected = controller.update(Sample(
            stamp_ns, np.array(state.position), np.array(state.velocity), np.array(state.effort),
            np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])))
        np.testing.assert_allclose(commands[stamp_ns].velocity, expected.velocity_radps,
                                   atol=1e-6)
        largest = max(largest, float(np.abs(expected.velocity_radps).max()))
    assert largest > 0.3


def test_the_first_nan_ends_the_run_with_its_stamp(policy_file: Path, tmp_path: Path) -> None:
    """One that no drawn observation brings about: as soon as the rover is asked for 0.12 m/s."""
    model = onnx.load(policy_file)
    helper, graph = onnx.helper, model.graph
    graph.node[-1].output[0] = 'finite'
    for name, value in (('first', np.array([0])), ('low', np.array([[0.599]], np.float32)),
                        ('high', np.array([[0.601]], np.float32)),
                        ('nan', np.array([[np.nan]], np.float32))):
        graph.initializer.append(onnx.numpy_helper.from_array(value, name))
    graph.node.extend([helper.make_node('Gather', ['observation', 'first'], ['speed'], axis=1),
                       helper.make_node('Greater', ['speed', 'low'], ['above']),
                       helper.make_node('Less', ['speed', 'high'], ['below']),
                       helper.make_node('And', ['above', 'below'], ['there']),
                       helper.make_node('Where', ['there', 'nan', 'finite'], ['action'])])
    onnx.save(model, tmp_path / 'rare.onnx')
    scenario = Scenario.load('flat', {
        'run.nodes': ['physics_node', 'gait_controller_node', 'drive_node', 'recorder_node'],
        'world.size_m': 12.8, 'world.surroundings.samples': 257}, duration_s=3.0)
    with pytest.raises(LunarRoverSimError, match=r'policy_node .*rare.onnx: gives .*nan.* at \d'):
        record(with_policy(scenario, tmp_path / 'rare.onnx'), tmp_path / 'run')


def test_a_policy_of_another_rover_does_not_start(policy_file: Path) -> None:
    """The reason comes before any node is started."""
    with pytest.raises(LearningError, match='is a policy for rover quad'):
        with_policy(Scenario.load('flat', rover='hexapod'), policy_file)


def test_another_ground_and_a_speed_out_of_the_training_are_warned_of_once(
        policy_file: Path, peer: Peer) -> None:
    """By ground, quantity, value and range; however long it goes on."""
    states, imus, velocities = (peer.node.create_publisher(kind, topic, 10) for kind, topic in (
        (JointState, 'joint_states'), (Imu, 'imu/data_raw'), (TwistStamped, 'cmd_vel')))
    answers, lines, stamps = peer.listen(JointState, 'joint_commands'), [], iter(
        range(10**9, 10**12, 5 * 10**7))

    def send() -> None:
        stamp = time_msg(next(stamps))
        state = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4, effort=[0.0] * 4)
        imu, velocity = Imu(), TwistStamped()
        state.header.stamp = imu.header.stamp = velocity.header.stamp = stamp
        imu.linear_acceleration.z, velocity.twist.linear.x = 1.62, 0.5
        for publisher, message in ((states, state), (imus, imu), (velocities, velocity)):
            publisher.publish(message)

    with running('policy_node', '-p', f'policy:={policy_file}', '-p', 'ground:=highland') as node:
        reader = threading.Thread(target=lambda: lines.extend(node.stdout))
        reader.start()
        peer.spin_until(lambda: len(answers) > 20, meanwhile=send)
        answered = len(answers)
        peer.spin_until(lambda: len(answers) > answered + 60, meanwhile=send)   # 3 s
        node.send_signal(signal.SIGINT)
        reader.join()
    warned = [line.partition(']: ')[2].strip() for line in lines if '[WARN]' in line]
    assert warned == ['policy walk was trained on rigid; here is highland',
                      'policy walk was trained for a speed of 0.06 to 0.16 m/s; 0.5 is commanded']


class Late(PolicyNode):
    """Looks at the graph before it reads its last topic."""

    def prepare(self, config) -> None:
        """Count who would be taken for a controller that is there."""
        self.advertised = self.count_publishers('joint_commands')
        super().prepare(config)


def test_nobody_sees_it_before_it_reads_all_topics(policy_file: Path, domain: int) -> None:
    """Physics would send the first state, without whose IMU the node never answers."""
    rclpy.init(args=['--ros-args', '-p', f'policy:={policy_file}', '-p', 'time_mode:=real_time'])
    try:
        node = Late()
        assert (node.advertised, node.count_publishers('joint_commands')) == (0, 1)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


@pytest.fixture()
def node(policy_file: Path, domain: int) -> Iterator[PolicyNode]:
    """Give a node in this process, in real time."""
    rclpy.init(args=['--ros-args', '-p', f'policy:={policy_file}', '-p', 'time_mode:=real_time',
                     '-p', f'observation_timeout_s:={TIMEOUT_S}'])
    made = PolicyNode()
    try:
        yield made
    finally:
        made.destroy_node()
        rclpy.try_shutdown()


def test_it_stands_still_when_observations_stop(node: PolicyNode) -> None:
    """States without IMU are not answered; after the timeout the legs are told to stop."""
    sent: list[JointState] = []
    node.publish = lambda command, stamp: sent.append(          # type: ignore[method-assign]
        (stamp.nanosec, command.velocity_radps))
    callbacks = {one.topic_name: one.callback for one in node.subscriptions}

    def state(stamp_ns: int) -> None:
        message = JointState(name=LEGS, position=[0.0] * 4, velocity=[0.0] * 4, effort=[0.0] * 4)
        message.header.stamp.nanosec = stamp_ns
        callbacks['/joint_states'](message)

    def imu(stamp_ns: int) -> None:
        message = Imu()
        message.header.stamp.nanosec, message.linear_acceleration.z = stamp_ns, 1.62
        callbacks['/imu/data_raw'](message)

    state(5_000_000)
    assert not sent
    imu(5_000_000)
    imu(15_000_000)         # before its state; that of 10 ms is lost
    state(10_000_000)
    state(15_000_000)
    assert [stamp for stamp, _ in sent] == [5_000_000, 15_000_000]
    state(20_000_000)
    time.sleep(TIMEOUT_S + 0.05)
    for timer in node.timers:
        timer.callback()
    stamp, velocities = sent[-1]
    assert len(sent) == 3 and stamp == 15_000_000 and not np.any(velocities)
    for timer in node.timers:
        timer.callback()
    assert len(sent) == 3   # once
