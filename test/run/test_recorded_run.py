"""Real runs: every topic of the contract, what messages say, a drive to a goal."""

from pathlib import Path

from command_line import unfolded
from conftest import PLAIN, simulate, SMALL, TINY
import numpy as np
import pytest

from lunar_rover_sim.bag import series
from lunar_rover_sim.bag.messages import header_ns, xyz
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.judge.evaluation.map_evaluation import evaluate_maps
from lunar_rover_sim.rover.description import Legs
from lunar_rover_sim.run.recorded_run import RecordedRun
from lunar_rover_sim.run.scenario import Scenario

pytestmark = pytest.mark.ros


DURATION_S = 1
ABSENT = {'slam_node', 'mapping_node', 'navigator_node'}     # of this run


def test_a_good_run_warns_of_nothing(recorded_run: Path) -> None:
    """Neither by itself nor by a library: on stderr is progress, in the logs what is going on."""
    said = unfolded(recorded_run.with_suffix('.out').read_text())
    assert said.startswith('baseline, seed 1: ') and 'warning' not in said.lower()
    logs = {log.name: log.read_text() for log in (recorded_run / 'logs').glob('*.log')}
    assert {'physics_node.log', 'render_node.log', 'recorder_node.log'} <= set(logs)
    for name, text, usual in (
            ('stderr', unfolded(recorded_run.with_suffix('.err').read_text()),
             ('building the world: ', 'starting: ', 'simulating: ', 'summing up the bag: ')),
            *((name, text, '[INFO] [') for name, text in logs.items())):
        assert not [line for line in text.splitlines() if not line.startswith(usual)], name


def test_contract(recorded_run: Path) -> None:
    """Every topic of the contract is there: type, QoS, count, frame, stamps at their rate."""
    scenario = Scenario.load('baseline', SMALL)
    periods_ns = {topics.STATE: scenario.physics_node.state_period_ns,
                  topics.FRAME: scenario.render_node.frame_period_ns,
                  topics.DEPTH_FRAME: scenario.render_node.depth_period_ns}
    assert periods_ns[topics.DEPTH_FRAME] == 2 * periods_ns[topics.FRAME]
    with open_bag(recorded_run / 'bag') as bag:
        assert not bag.incomplete
        for topic in topics.of_legs(topics.CONTRACT, scenario.rover.legs.names):
            if (topic in (topics.RECORDED, topics.TRUE_ODOM, topics.LIDAR_SCANNED,
                          topics.MISCALIBRATION)
                    or topic.node in ABSENT):
                continue
            if not topic.in_all and topic.name not in (topics.SINKAGE.name,
                                                       topics.FOOT_SLIP.name):
                assert f'/{topic.name}' not in bag.types
                continue
            name = bag.resolve(topic.name)
            assert bag.types[name] == topic.type
            period_ns = periods_ns.get(topic.rate)
            if topic == topics.CMD_VEL:
                period_ns = 1_000_000_000 // scenario.drive_node.rate_hz
            if topic.rate == topics.LATCHED:
                assert bag.counts[name] == 1
                continue
            stamps = [bag.stamp_ns(message) for message in bag.raw([name])]
            if period_ns is None:
                continue
            assert stamps == list(range(period_ns, DURATION_S * 10**9 + 1, period_ns)), name
            message = bag.first(name)
            if hasattr(message, 'header'):
                assert message.header.frame_id == topic.frame_id, name
        latched_topics = {f'/{topic.name}' for topic in topics.CONTRACT
                          if topic.rate == topics.LATCHED}
        for connection in bag.connections:
            profile = connection.ext.offered_qos_profiles[0]
            assert profile.reliability.name == 'RELIABLE', connection.topic
            durability = 'TRANSIENT_LOCAL' if connection.topic in latched_topics else 'VOLATILE'
            assert profile.durability.name == durability, connection.topic


def test_messages_say_what_they_must(recorded_run: Path) -> None:
    """REP-145 on the IMU, REP-104 on the cameras, a complete disparity image."""
    with open_bag(recorded_run / 'bag') as bag:
        imu = bag.first(topics.IMU_RAW.name)
        assert imu.orientation_covariance[0] == -1
        assert imu.linear_acceleration_covariance[0] > 0
        odom = bag.first(topics.ODOM.name)
        assert odom.child_frame_id == 'base_link'
        left, right = bag.first(topics.LEFT_INFO.name), bag.first(topics.RIGHT_INFO.name)
        focal_px, baseline_m = left.k[0], 0.1
        assert left.p[3] == 0
        assert right.p[3] == pytest.approx(-focal_px * baseline_m)
        assert left.header.frame_id == right.header.frame_id
        exposure = bag.first(topics.EXPOSURE.name)
        assert exposure.name == ['left', 'right']
        assert 1e-5 < exposure.position[0] == exposure.position[1] < 0.1
        disparity = bag.first(topics.DISPARITY.name)
        assert disparity.f == pytest.approx(focal_px)
        assert disparity.t == pytest.approx(baseline_m)
        assert disparity.max_disparity == 63
        assert disparity.delta_d == pytest.approx(1 / 16)
        assert disparity.valid_window.width > 0
        joints = bag.first(topics.JOINT_STATES.name)
        assert list(joints.name) == [f'{leg}_joint' for leg in Legs().names]
        assert len(joints.position) == len(joints.velocity) == len(joints.effort) == 4
        scenario = bag.first(topics.SCENARIO.name).data
        assert scenario == (recorded_run / 'scenario.yaml').read_text()
        assert '<robot' in bag.first(topics.ROBOT_DESCRIPTION.name).data


def test_other_tools_read_the_bag(recorded_run: Path) -> None:
    """The MCAP project's own reader decodes it, tf included, which is there in any case."""
    mcap_reader = pytest.importorskip('mcap.reader')
    decoder = pytest.importorskip('mcap_ros2.decoder')
    with open(next((recorded_run / 'bag').glob('*.mcap')), 'rb') as stream:
        reader = mcap_reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
        found = {topic: [message for *_, message in reader.iter_decoded_messages(topics=[topic])]
                 for topic in ('/odom', '/tf', '/tf_static')}
    assert len(found['/odom']) == len(found['/tf']) == DURATION_S * 200
    for odometry, tf in zip(found['/odom'], found['/tf']):
        placed, = (t for t in tf.transforms if t.child_frame_id == 'base_link')
        assert (placed.header.frame_id, header_ns(placed)) == ('odom', header_ns(odometry))
        assert xyz(placed.transform.translation) == pytest.approx(
            xyz(odometry.pose.pose.position), abs=1e-12)
    fixed, = found['/tf_static']
    assert {t.child_frame_id for t in fixed.transforms} >= {'imu_link', 'lidar_link'}


GOAL_M = 0.5, 0.1


def test_it_maps_arrives_and_ends(tmp_path: Path) -> None:
    """On flat ground; the run ends when the navigator is done, long before its duration."""
    plain = [word for setting in (*PLAIN, *TINY) for word in ('--set', setting)]
    done = simulate(tmp_path / 'run', '--goal', '{:g},{:g}'.format(*GOAL_M), '--duration', '60',
                    '--set', 'world.craters.density=0', '--set', 'world.rocks.abundance=0',
                    *plain)
    assert done.returncode == 0, done.stderr
    assert 'goal: arrived at x' in done.stdout
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        topic = f'/{topics.NAVIGATOR_STATUS.name}'
        said = [status.message for _, _, message in bag.messages([topic])
                for status in message.status]
        assert 'arrived' in said[-1], said
        odometry = series.read_odometry(bag)
        assert bag.counts[f'/{topics.PLAN.name}'] >= 1
    assert np.linalg.norm(odometry.positions_m[-1, :2] - GOAL_M) < 0.3
    assert odometry.stamps_ns[-1] < 30e9
    assert evaluate_maps(tmp_path / 'run' / 'bag').near.rms_m < 0.03


def test_the_pair_is_one_that_image_pipeline_takes(recorded_run: Path) -> None:
    """One frame, equal f and cy; P projects points of it into the right image, as tf does."""
    with open_bag(recorded_run / 'bag') as bag:
        left, right = (bag.first(f'/stereo/{side}/camera_info') for side in ('left', 'right'))
        assert {bag.first(f'/stereo/{side}/image_raw').header.frame_id
                for side in ('left', 'right')} == {left.header.frame_id} == {right.header.frame_id}
        run = RecordedRun(bag)
        T_base_left, T_base_right = (run.frame_from_tf(f'stereo_{side}_optical_frame')
                                     for side in ('left', 'right'))
    assert left.header.frame_id == 'stereo_left_optical_frame'
    assert T_base_left is not None and T_base_right is not None
    assert [left.p[k] for k in (0, 5, 6)] == [right.p[k] for k in (0, 5, 6)]    # fx, fy, cy
    point = np.array([0.3, -0.2, 4.0, 1.0])
    in_right = np.linalg.inv(T_base_right) @ T_base_left @ point
    pixel = right.k.reshape(3, 3) @ in_right[:3]
    expected = right.p.reshape(3, 4) @ point
    np.testing.assert_allclose(pixel[:2] / pixel[2], expected[:2] / expected[2], atol=1e-9)
