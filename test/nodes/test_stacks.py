"""Beside other stacks, wherever they are installed: our graph and bags with others' programs.

    python -m pytest -m stacks -rs

Each test is skipped by the name of the package that it lacks. None of them is on PyPI: source
apt's Jazzy or a workspace first.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import time
from typing import Any

from conftest import BLIND, command, PLAIN, SMALL
import numpy as np
import pytest
from waiting import LIMIT_S

pytestmark = [pytest.mark.ros, pytest.mark.stacks]
pytest.importorskip('rclpy')

from lunar_rover_sim.bag.reader import open_bag  # noqa: E402
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate  # noqa: E402

# Depth 5 times a second on ground of 25.6 m: enough for a map.
NAV2 = ('run.nodes=[physics_node,gait_controller_node,render_node,mapping_node,recorder_node]',
        'world.size_m=25.6', 'world.surroundings.samples=257', 'physics_node.ground.model=rigid',
        'render_node.camera.width=320', 'render_node.camera.height=240',
        'render_node.sgm.num_disparities=64', 'render_node.frame_rate_hz=5', *PLAIN)
EXAMPLES = Path(__file__).parents[2] / 'config/launch_examples'


def needs(*packages: str) -> None:
    """Skip a test unless all packages are installed; name the one that is not."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(':')
    for package in packages:
        if not any(Path(prefix, 'share', package, 'package.xml').is_file()
                   for prefix in prefixes if prefix):
            pytest.skip(f'the ROS package {package} is not installed')


@contextmanager
def beside(*words: str) -> Iterator[subprocess.Popen[str]]:
    """Run a program of others in the domain of the test, and end it as Ctrl-C does."""
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                               start_new_session=True)
    try:
        yield process
        assert process.poll() is None, process.communicate()[0]
    finally:
        os.killpg(process.pid, signal.SIGINT)
        try:
            process.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()


def drive(folder: Path, *arguments: str) -> Path:
    """Record a small drive in the graph of the test; return its bag."""
    words = [word for setting in SMALL for word in ('--set', setting)]
    done = subprocess.run(command('run', 'baseline', '-o', str(folder), '--join', *words,
                                  *arguments), capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / 'bag'


def test_robot_localization_keeps_the_heading(tmp_path: Path, open_domain: int) -> None:
    """It turns with the gyroscope: over a metre its heading errs by half of the wheels' at most.

    The wheels lose ten degrees a metre, the filter two. Its covariances are finite. Time goes at
    a quarter, since a filter that cannot keep up drops samples of the gyroscope.
    """
    needs('robot_localization', 'ros2launch')
    with beside('ros2', 'launch', str(EXAMPLES / 'robot_localization.launch.py')):
        bag = drive(tmp_path / 'run', '--duration', '25', *BLIND, '--real-time',
                    '--set', 'separate_truth=true', '--set', 'physics_node.real_time_factor=0.25',
                    '--set', 'recorder_node.topics=[all,wheel/odometry,star_tracker/attitude]')
    wheels, filtered = (evaluate(str(bag), f'{bag}:{topic}')
                        for topic in ('/wheel/odometry', '/odometry/filtered'))
    assert filtered.rpe_distance_deg.count > 100
    assert filtered.rpe_distance_deg.mean < 0.5 * wheels.rpe_distance_deg.mean
    with open_bag(bag) as recorded:
        covariances = [m.pose.covariance for _, _, m in recorded.messages(['/odometry/filtered'])]
        children = {(t.header.frame_id, t.child_frame_id)
                    for _, _, m in recorded.messages(['/tf']) for t in m.transforms}
    assert np.isfinite(covariances).all()
    assert {('odom', 'base_link'), ('ground_truth/odom', 'ground_truth/base_link')} <= children


DISTORTED = '[-0.25, 0.08, 0.001, -0.001, 0.0]'


@pytest.mark.parametrize('size, distortion', [('320 240', ''), ('640 480', ''),
                                              ('320 240', DISTORTED),
                                              ('640 480', DISTORTED)])
def test_stereo_image_proc_agrees_with_our_disparities(size: str, distortion: str, tmp_path: Path,
                                                       open_domain: int) -> None:
    """On the topics as they are by default: pairs of the same stamps, f and T, half a pixel.

    Images with distortion go through image_proc first.
    """
    needs('stereo_image_proc', 'image_proc', 'ros2launch')
    width, height = size.split()
    rectify = ('rectify:=true',) if distortion else ()
    settings = [f'render_node.camera.width={width}', f'render_node.camera.height={height}',
                'render_node.sgm.num_disparities=128', 'render_node.frame_rate_hz=5']
    if distortion:
        settings.append(f'render_node.camera.distortion={distortion}')
    with beside('ros2', 'launch', str(EXAMPLES / 'stereo_image_proc.launch.py'), *rectify):
        # The nodes that rectify are loaded when there are images.
        bag = drive(tmp_path / 'run', '--duration', '4' if distortion else '2', '--real-time',
                    '--set', 'physics_node.real_time_factor=0.1',
                    *(word for setting in settings for word in ('--set', setting)))
    with open_bag(bag) as recorded:
        theirs, ours = ({(m.header.stamp.sec, m.header.stamp.nanosec): m
                         for _, _, m in recorded.messages([topic])}
                        for topic in ('/stereo_image_proc/disparity', '/stereo/disparity'))
    both = sorted(theirs.keys() & ours.keys())
    assert len(both) >= 5
    for stamp in both:
        a, b = theirs[stamp], ours[stamp]
        assert (a.f, a.t) == pytest.approx((b.f, b.t))
        assert a.header.frame_id == b.header.frame_id
        p, q = (np.frombuffer(m.image.data, np.float32).reshape(m.image.height, -1)
                for m in (a, b))
        known = (p > a.min_disparity) & (q > b.min_disparity)
        assert known.mean() > 0.3
        difference = p[known] - q[known]
        assert abs(np.median(difference)) < 0.5
        assert (abs(difference) < 1.0).mean() > 0.8


def test_image_transport_decodes_our_compressed_images(tmp_path: Path, open_domain: int) -> None:
    """Its `republish` makes raw images of `stereo/left/image_raw/compressed`, as ours are."""
    needs('image_transport', 'compressed_image_transport', 'ros2run')
    with beside('ros2', 'run', 'image_transport', 'republish', '--ros-args',
                '-p', 'in_transport:=compressed', '-p', 'out_transport:=raw',
                '-r', 'in/compressed:=stereo/left/image_raw/compressed', '-r', 'out:=decoded'):
        bag = drive(tmp_path / 'run', '--duration', '1', '--real-time',
                    '--set', 'physics_node.real_time_factor=0.1')
    with open_bag(bag) as recorded:
        decoded, raw = ({(m.header.stamp.sec, m.header.stamp.nanosec): m
                         for _, _, m in recorded.messages([topic])}
                        for topic in ('/decoded', '/stereo/left/image_raw'))
    both = decoded.keys() & raw.keys()
    assert len(both) >= 5
    for stamp in both:
        a, b = decoded[stamp], raw[stamp]
        assert (a.encoding, a.width, a.height, a.header.frame_id) == (
            b.encoding, b.width, b.height, b.header.frame_id)
        assert np.abs(a.data.astype(int) - b.data).mean() < 3.0


def test_rosbag2_knows_our_bags(request: pytest.FixtureRequest, peer: Any) -> None:
    """`ros2 bag info` counts as we do, `ros2 bag play` gives every message to a peer of ROS."""
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import Imu

    needs('ros2bag', 'rosbag2_storage_mcap')
    recorded_run: Path = request.getfixturevalue('recorded_run')
    info = subprocess.run(['ros2', 'bag', 'info', str(recorded_run / 'bag')],
                          capture_output=True, text=True, timeout=LIMIT_S)
    assert info.returncode == 0, info.stderr
    counted = {topic: int(count) for topic, count in re.findall(
        r'Topic: (\S+) \| Type: \S+ \| Count: (\d+)', info.stdout)}
    with open_bag(recorded_run / 'bag') as bag:
        counts = {topic: count for topic, count in bag.counts.items() if count}
    assert {topic: count for topic, count in counted.items() if count} == counts
    samples, clock = peer.listen(Imu, 'imu/data_raw', 1000), peer.listen(Clock, 'clock', 1000)
    with beside('ros2', 'bag', 'play', str(recorded_run / 'bag'), '--rate', '0.2',
                '--delay', '2', '--loop'):
        peer.spin_until(lambda: len(samples) >= counts['/imu/data_raw']
                        and len(clock) >= counts['/clock'])


def test_rosbag2_plays_with_a_clock_of_its_own(request: pytest.FixtureRequest,
                                               peer: Any) -> None:
    """Its clock tells the time of our stamps, for bags that were recorded without one."""
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rosgraph_msgs.msg import Clock

    needs('ros2bag', 'rosbag2_storage_mcap')
    bag: Path = request.getfixturevalue('recorded_run') / 'bag'
    with open_bag(bag) as recorded:
        end_s = recorded.end_ns * 1e-9

    def seconds(message: Clock) -> float:
        return float(message.clock.sec + message.clock.nanosec * 1e-9)

    clock = peer.listen(Clock, 'clock', QoSProfile(
        depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT))     # as it is played
    with beside('ros2', 'bag', 'play', str(bag), '--rate', '0.2', '--delay', '2', '--loop',
                '--clock', '50', '--exclude-topics', '/clock'):
        peer.spin_until(lambda: len(clock) > 50 and seconds(clock[-1]) > 0.5 * end_s)
    assert all(0.0 <= seconds(message) <= end_s + 0.1 for message in clock)


@pytest.mark.parametrize('options', [(), ('--max-bag-size', '300000'),
                                     ('--compression-mode', 'file',
                                      '--compression-format', 'zstd'),
                                     ('--qos-profile-overrides-path', 'QOS')],
                         ids=['plain', 'split', 'compressed', 'qos'])
def test_rosbag2_records_our_graph(options: tuple[str, ...], tmp_path: Path,
                                   open_domain: int) -> None:
    """What `ros2 bag record` leaves, our reader reads: each state once."""
    needs('ros2bag', 'rosbag2_storage_mcap')
    qos = tmp_path / 'qos.yaml'
    qos.write_text('/imu/data_raw: {reliability: reliable, history: keep_last, depth: 4000}\n')
    with beside('ros2', 'bag', 'record', '--all', '--use-sim-time', '--storage', 'mcap',
                '-o', str(tmp_path / 'theirs'),
                *(str(qos) if word == 'QOS' else word for word in options)):
        drive(tmp_path / 'run', '--duration', '2', *BLIND)
    with open_bag(tmp_path / 'theirs') as bag:
        stamps = [(m.header.stamp.sec, m.header.stamp.nanosec)
                  for _, _, m in bag.messages(['/imu/data_raw'])]
    assert stamps == sorted(set(stamps))
    assert len(stamps) > 390
    if '--max-bag-size' in options:
        assert len(list((tmp_path / 'theirs').glob('*.mcap'))) > 1


@pytest.mark.parametrize('stamped', ['false', 'true'], ids=['Twist', 'TwistStamped'])
def test_nav2_reaches_a_goal(stamped: str, tmp_path: Path, open_domain: int) -> None:
    """8 m off, by its action: our map, odometry and tf in, its commands out."""
    needs('nav2_bt_navigator', 'nav2_controller', 'nav2_planner', 'nav2_navfn_planner',
          'nav2_regulated_pure_pursuit_controller', 'nav2_behaviors', 'nav2_lifecycle_manager',
          'ros2launch', 'ros2action')
    # A Python client would need the Python of nav2_msgs in this process.
    goal = '{pose: {header: {frame_id: odom}, pose: {position: {x: 8.0}, orientation: {w: 1.0}}}}'
    run = command('run', 'baseline', '-o', str(tmp_path / 'run'), '--join', '--duration', '600',
                  '--real-time', '--set', 'physics_node.real_time_factor=0.3', *(
                      word for setting in NAV2 for word in ('--set', setting)))
    with beside('ros2', 'launch', str(EXAMPLES / 'nav2.launch.py'), f'stamped:={stamped}'), \
            beside(*run):
        # Refused until all servers are active, for which they need our tf.
        until = time.monotonic() + LIMIT_S
        told = None
        while told is None or 'Goal was rejected' in told.stdout and time.monotonic() < until:
            told = subprocess.run(['ros2', 'action', 'send_goal', 'navigate_to_pose',
                                   'nav2_msgs/action/NavigateToPose', goal],
                                  capture_output=True, text=True, timeout=10 * LIMIT_S)
    assert 'Goal finished with status: SUCCEEDED' in told.stdout, told.stdout + told.stderr
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        *_, (_, _, last) = bag.messages(['/odom'])
        kind = bag.types['/cmd_vel'].rpartition('/')[2]
    place = last.pose.pose.position
    assert np.hypot(place.x - 8.0, place.y) < 0.4
    assert kind == ('TwistStamped' if stamped == 'true' else 'Twist')


def test_ros2_control_turns_the_legs(tmp_path: Path, open_domain: int) -> None:
    """By the description and topics alone: a velocity controller drives as the gait would."""
    needs('controller_manager', 'joint_state_topic_hardware_interface', 'velocity_controllers',
          'joint_state_broadcaster', 'ros2launch', 'ros2topic')
    with beside('ros2', 'launch', str(EXAMPLES / 'ros2_control.launch.py')), \
            beside('ros2', 'topic', 'pub', '--rate', '10', 'legs/commands',
                   'std_msgs/msg/Float64MultiArray', '{data: [2.0, 2.0, 2.0, 2.0]}'):
        bag = drive(tmp_path / 'run', '--duration', '10', '--real-time',
                    '--set', 'physics_node.real_time_factor=0.3',
                    '--set', 'run.nodes=[physics_node,recorder_node]')
    with open_bag(bag) as recorded:
        times_ns, ours = [], []
        for _, t_ns, message in recorded.messages(['/joint_states']):
            times_ns.append(t_ns)
            ours.append(message.position)
        theirs = [m for _, _, m in recorded.messages(['/joint_state_broadcaster/joint_states'])]
        commands = [m.velocity for _, _, m in recorded.messages(['/joint_commands'])]
        *_, (_, _, last) = recorded.messages(['/odom'])
    turned = (np.array(ours[-1]) - ours[-400]) / (1e-9 * (times_ns[-1] - times_ns[-400]))
    assert np.allclose(turned, 2.0, atol=0.3)
    assert np.allclose(commands[-1], 2.0)
    assert last.pose.pose.position.x > 0.5
    assert set(theirs[-1].name) == {f'{leg}_joint' for leg in (
        'front_left', 'front_right', 'rear_left', 'rear_right')}


# A figure of eight of 1.3 m, at 20 Hz of small images; time goes slowly enough for any machine.
ORB = """
run: {ros__parameters: {duration_s: 12.0}}
world: {ros__parameters: {size_m: 25.6, surroundings: {samples: 257}}}
physics_node: {ros__parameters: {real_time_factor: 0.15, ground: {model: rigid}}}
render_node:
  ros__parameters:
    {frame_rate_hz: 20.0, camera: {width: 320, height: 240}, sgm: {num_disparities: 64}}
drive_node:
  ros__parameters: {mode: spline, shape: figure_eight, shape_size_m: 4.0, speed_mps: 0.12}
"""


def test_orb_slam3_keeps_the_way(tmp_path: Path, open_domain: int) -> None:
    """By our launch file and a wrapper: its keyframes are where the rover was."""
    needs('orbslam3', 'lunar_rover_sim', 'ros2launch')
    vocabulary = os.environ.get('ORB_SLAM3_VOCABULARY')
    if not vocabulary:
        pytest.skip('ORB_SLAM3_VOCABULARY does not name a vocabulary')
    scenario, settings = tmp_path / 'eight.yaml', tmp_path / 'orb.yaml'
    scenario.write_text(ORB)
    subprocess.run(command('slam', 'settings', str(scenario), '--sensor', 'stereo', '-o',
                           str(settings)), check=True, timeout=LIMIT_S)
    with beside('ros2', 'launch', 'lunar_rover_sim', 'slam.launch.py', 'wrapper:=orbslam3',
                f'vocabulary:={vocabulary}', f'settings:={settings}', f'scenario:={scenario}',
                f'estimate:={tmp_path / "estimate"}', f'output:={tmp_path / "run"}', 'delay:=5'):
        until = time.monotonic() + 10 * LIMIT_S
        while not (tmp_path / 'run/bag/metadata.yaml').is_file() and time.monotonic() < until:
            time.sleep(1.0)
    found = evaluate(str(tmp_path / 'run/bag'),
                     str(tmp_path / 'estimate/KeyFrameTrajectory.txt'), estimate_frame='left')
    assert found.ate_m.count >= 8 and found.length_m > 1.0
    assert found.ate_m.rmse < 0.02 and abs(found.scale - 1.0) < 0.03


def test_tf2_finds_all_frames(tmp_path: Path, open_domain: int) -> None:
    """A listener of tf2 looks up the way from the world to the right camera, at a stamp."""
    needs('tf2_ros', 'ros2run')
    with beside('ros2', 'run', 'tf2_ros', 'tf2_echo', 'odom',
                'stereo_right_optical_frame') as echo:
        drive(tmp_path / 'run', '--duration', '3', '--real-time', *BLIND, *(
            word for setting in PLAIN for word in ('--set', setting)))
        assert echo.stdout is not None
        os.set_blocking(echo.stdout.fileno(), False)
        text = echo.stdout.read()
    places = re.findall(r'Translation: \[(\S+), (\S+), (\S+)\]', text)
    assert places, text
    with open_bag(tmp_path / 'run' / 'bag') as bag:
        heights = [m.pose.pose.position.z for _, _, m in bag.messages(['/odom'])]
    assert min(heights) - 0.2 < float(places[-1][2]) < max(heights) + 0.5


def test_every_program_is_named_that_is_missing() -> None:
    """A test of a package that is not there is skipped with its name."""
    with pytest.raises(pytest.skip.Exception, match='the ROS package no_such_package is not'):
        needs('no_such_package')
