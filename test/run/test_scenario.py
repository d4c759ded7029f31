"""Scenarios: packaged files, overrides, resolution, mistakes."""

from pathlib import Path
import re
from typing import Any

import pytest
import yaml

from lunar_rover_sim.base.errors import ConfigError, WorldError
from lunar_rover_sim.base.files.paths import packaged_names
from lunar_rover_sim.rover.gait.calibration import (differences, GaitCalibration,
                                                    ground_conditions, rover_conditions)
from lunar_rover_sim.run.lockstep import StampGate, WrittenStamps
from lunar_rover_sim.run.params_files import arguments_of_program
from lunar_rover_sim.run.plan import check_launch_arguments, resolve
from lunar_rover_sim.run.scenario import Scenario

NAMES = packaged_names('scenario')
TUTORIAL = Path(__file__).parents[2] / 'docs/tutorials/first_drive.md'


@pytest.mark.parametrize('name', NAMES)
def test_resolved_scenario_round_trip(name: str, tmp_path: Path) -> None:
    """The scenario in a bag's folder gives the same run again."""
    scenario = resolve(Scenario.load(name, seed=7))
    path = tmp_path / f'{name}.yaml'
    path.write_text(scenario.to_yaml())
    assert Scenario.load(str(path)) == scenario
    assert resolve(Scenario.load(str(path))) == scenario
    assert f'| `{name}` |' in TUTORIAL.read_text(), 'the first tutorial says what each is'


def test_overrides() -> None:
    """`--set` reaches nodes, groups, the world, the rover and shared parameters."""
    scenario = Scenario.load('baseline', [
        'gait_controller_node.duty_factor=0.55', 'render_node.sun.elevation_deg=3',
        'world.craters.density=2e-2', 'rover.chassis.mass_kg=2.5', 'seed=9'])
    assert scenario.gait_controller_node.duty_factor == 0.55
    assert scenario.render_node.sun.elevation_deg == 3.0
    assert scenario.world.craters.density == 0.02
    assert scenario.rover.chassis.mass_kg == 2.5
    assert {scenario.node(n).seed for n in scenario.run.nodes} == {9}


@pytest.mark.parametrize('override', [
    'gait_controler_node.duty_factor=0.5', 'gait_controller_node.duty_facto=0.5', 'sed=3', 'seed',
    'render_node.frame_rate_hz=30', 'drive_node.rate_hz=7', 'drive_node.speed_mps=12',
    'drive_node.max_yaw_rate_radps=8.6', 'physics_node.start.joint_angle_rad=[30.0]',
    'render_node.hazard.front.rate_hz=7', 'physics_node.state_rate_hz=300', 'run.nodes=[rviz]',
    'run.may_fail=[physics_node]', 'run.nodes=[physics_node, physics_node]',
    'run.duration_s=1e10', 'run.world_hash=abc'])
def test_wrong_overrides(override: str) -> None:
    """Names and values that do not exist are refused in one line that names them."""
    with pytest.raises(ConfigError) as error:
        Scenario.load('baseline', [override])
    name = override.partition('=')[0]
    assert re.search(rf"{name}|'{name.partition('.')[0]}'|\b{name.rpartition('.')[2]}\b",
                     str(error.value))
    assert '\n' not in str(error.value)


def test_a_lidar_that_sees_only_the_rover_is_refused_before_a_run() -> None:
    inside = {'rover.lidar.position_m': [0.0, 0.0, 0.0]}
    assert Scenario.load('flat', inside).rover.lidar.position_m == (0.0, 0.0, 0.0)
    with_lidar = {**inside, 'run.nodes': ['physics_node', 'lidar_node']}
    with pytest.raises(ConfigError, match=r'^rover\.lidar\.position_m: \[0\.0, 0\.0, 0\.0\] is '
                                          'not valid .* valid is outside chassis and mast'):
        Scenario.load('flat', with_lidar)
    # Above the deck, but with a narrow field of view that looks down on it.
    down = {'rover.lidar.position_m': [0.0, 0.0, 0.15], 'rover.lidar.rpy_deg': [0.0, 80.0, 0.0],
            'lidar_node.part': 'espros_tofcam635', 'run.nodes': ['physics_node', 'lidar_node']}
    with pytest.raises(ConfigError, match=r'not valid with rpy_deg = \[0\.0, 80\.0, 0\.0\]'):
        Scenario.load('flat', down)


@pytest.mark.parametrize('name', ['render_nod', 'name', 3, ['x']])
def test_unknown_node(name: Any) -> None:
    """What is not a node is no parameters of one."""
    with pytest.raises(ConfigError, match=re.escape(repr(name))):
        Scenario.load('flat').node(name)


@pytest.mark.parametrize('name', ['basline', 'nowhere/x.yaml'])
def test_unknown_scenario(name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        Scenario.load(name)


@pytest.mark.parametrize(('text', 'named'), [
    ('[1, 2]', ''), ('phisics_node: {ros__parameters: {}}', 'phisics_node'),
    ('physics_node: {step_s: 0.001}', 'physics_node'),
    ('physics_node: {ros__parameters: 3}', 'physics_node'), ('a: [', ''),
    ('!!python/object:os.system {}', ''),
    ('run: {ros__parameters: {}}\nrun: {ros__parameters: {}}', 'run'),
    ('run: {ros__parameters: {duration_s: 1, duration_s: 2}}', 'duration_s'),
    ('render_node: {ros__parameters: {sun: {azimuth_deg: 1}, sun.azimuth_deg: 2}}',
     'sun.azimuth_deg'),
])
def test_broken_files(text: str, named: str, tmp_path: Path) -> None:
    """A file that is no scenario is refused in one line."""
    path = tmp_path / 'x.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=named) as error:
        Scenario.load(str(path))
    assert '\n' not in str(error.value)


def test_duration_is_rounded_up_to_whole_frames() -> None:
    """So that every topic ends with the run."""
    scenario = resolve(Scenario.load('flat', ['run.duration_s=1.01']))
    assert scenario.physics_node.duration_s == 1.05
    assert resolve(Scenario.load('flat', ['run.duration_s=1.1'])).run.duration_s == 1.1


@pytest.mark.parametrize(('frame_rate_hz', 'depth_every', 'frames'),
                         [(200, 1, 3), (20, 1, 3), (20, 2, 7), (20, 20, 59), (10, 2, 7),
                          (10, 20, 3), (1, 1, 3), (1, 3, 8)])
def test_time_neither_stops_for_depth_nor_waits_for_one_after_the_end(
        frame_rate_hz: int, depth_every: int, frames: int) -> None:
    """Renderer and recorder are as late as they may be; the end lies between two depths."""
    scenario = resolve(Scenario.load('baseline', [
        f'render_node.frame_rate_hz={frame_rate_hz}', f'render_node.depth_every={depth_every}']))
    frame_ns, wait = 10**9 // frame_rate_hz, scenario.physics_node.wait
    recorder = scenario.recorder_node
    period_ns, gate = recorder.period_ns_by_topic(), StampGate(wait.lag_ns_by_topic())
    assert period_ns['odom'] == 5_000_000
    assert period_ns['stereo/left/image_raw'] == frame_ns
    assert period_ns['stereo/depth/image'] == depth_every * frame_ns
    written = WrittenStamps(period_ns)

    def write(state_ns: int, frames_ns: int) -> None:
        for name, ns in period_ns.items():
            drawn = name.startswith(('stereo', 'ground_truth/depth'))
            newest_ns = frames_ns // ns * ns if drawn else state_ns
            if newest_ns:
                written.write(name, newest_ns)
        gate.answer('recorder/written', written.up_to_ns)

    end_ns = frames * frame_ns
    for now_ns in range(5_000_000, end_ns + 1, 5_000_000):
        gate.answer('joint_commands', now_ns)
        shown_ns = max(0, now_ns // frame_ns - 1) * frame_ns
        gate.answer('stereo/left/camera_info', shown_ns)
        write(now_ns, max(0, shown_ns - frame_ns))
        assert gate.is_open(now_ns), gate.missing(now_ns)
    gate.answer('stereo/left/camera_info', end_ns)
    assert gate.behind(end_ns)
    write(end_ns, end_ns)
    assert not gate.behind(end_ns)


@pytest.mark.parametrize(('name', 'calibration'), [
    ('baseline', 'highland'), ('dem', 'highland'), ('feature_sparse', 'highland'),
    ('flat', 'rigid'), ('low_albedo', 'highland'), ('permanent_shadow', 'highland')])
def test_a_run_walks_by_the_calibration_of_its_ground(name: str, calibration: str) -> None:
    """It was measured under the conditions of the scenario, so nothing is warned of."""
    scenario = resolve(Scenario.load(name))
    assert scenario.gait_controller_node.calibration == calibration
    measured = GaitCalibration.of(scenario.gait_controller_node).conditions
    assert differences(measured, {**rover_conditions(scenario.rover),
                                  **ground_conditions(scenario.physics_node)}) == []


def test_another_ground_or_calibration_than_the_packaged_ones() -> None:
    """A ground without a calibration walks by that of rigid ground; one that is named stays."""
    def calibration(*overrides: str) -> str:
        return resolve(Scenario.load('baseline', overrides)).gait_controller_node.calibration
    assert calibration('physics_node.ground.model=rigid') == 'rigid'
    assert calibration('physics_node.ground.preset=highland_dense') == 'rigid'
    assert calibration('gait_controller_node.calibration=own.yaml') == 'own.yaml'


def test_lockstep_waits_for_the_nodes_of_the_run() -> None:
    """Who is not started is not waited for."""
    full = resolve(Scenario.load('baseline'))
    assert full.physics_node.wait.topics == ('joint_commands', 'stereo/left/camera_info',
                                             'recorder/written')
    assert full.gait_controller_node.wait.topics == ('cmd_vel',)
    blind = resolve(Scenario.load(
        'baseline', ['run.nodes=[physics_node, gait_controller_node, recorder_node]']))
    assert blind.physics_node.wait.topics == ('joint_commands', 'recorder/written')
    assert blind.gait_controller_node.wait.topics == ()
    assert not any(t.startswith('stereo') for t in blind.recorder_node.acknowledge)
    lidar = {'run.nodes': ['physics_node', 'recorder_node', 'lidar_node']}
    scans = {'recorder_node.topics': ['all', 'lidar/points']}
    named = {'physics_node.wait.topics': ['lidar/scanned'], 'physics_node.wait.lags_s': [0.2]}
    for more, awaited in (({}, False), (scans, True), (named, True),
                          ({**scans, 'run.may_fail': ['lidar_node']}, False)):
        of_lidar = resolve(Scenario.load('baseline', {**lidar, **more}))
        assert ('lidar/scanned' in of_lidar.physics_node.wait.topics) == awaited
        # Unless somebody reads it, lidar_node does not listen to the rover.
        assert ('lidar/scanned' in of_lidar.recorder_node.exclude) == (more == {})
        assert resolve(of_lidar) == of_lidar
    live = resolve(Scenario.load('baseline', ['time_mode=real_time']))
    assert live.physics_node.wait.topics == full.physics_node.wait.topics
    assert live.gait_controller_node.wait.topics == live.recorder_node.acknowledge == ()


def test_scenarios_are_ros_parameter_files() -> None:
    """Every section holds ros__parameters, lists are of one type, no null values."""
    def leaves(value: object) -> None:
        if isinstance(value, dict):
            for item in value.values():
                leaves(item)
        elif isinstance(value, list):
            assert value and len({type(item) for item in value}) == 1
        else:
            assert isinstance(value, (bool, int, float, str))

    for name in NAMES:
        document = yaml.safe_load(Scenario.load(name).to_yaml())
        for section in document.values():
            assert set(section) == {'ros__parameters'}
        leaves(document)


def test_a_users_own_participant_is_awaited_too() -> None:
    """What a scenario names comes on top of the run's own nodes, with the lag it names."""
    scenario = resolve(Scenario.load('baseline', [
        'physics_node.wait.topics=[slam/pose, joint_commands]',
        'physics_node.wait.lags_s=[0.3, 0.01]']))
    lags_ns = scenario.physics_node.wait.lag_ns_by_topic()
    assert lags_ns['slam/pose'] == 300_000_000
    assert lags_ns['joint_commands'] == 10_000_000
    assert 'recorder/written' in lags_ns


def test_the_gait_controller_names_a_silent_controller_before_physics_names_it() -> None:
    """The limits hold for drive_node and for a user's program, before its first answer too."""
    own = ('run.nodes=[physics_node, gait_controller_node]',
           'gait_controller_node.wait.topics=[cmd_vel]', 'gait_controller_node.wait.lags_s=[0.05]')
    for overrides in (own, ()):
        scenario = resolve(Scenario.load('flat', overrides))
        gait, physics = scenario.gait_controller_node.wait, scenario.physics_node.wait
        assert gait.silence_s < physics.silence_s
        assert gait.start_s < physics.start_s


def test_a_scenario_refuses_another_world_than_it_names() -> None:
    small = {'world.size_m': 6.4, 'world.surroundings.samples': 65}
    hash_here = Scenario.load('flat', small).load_world().hash
    assert Scenario.load('flat', {**small, 'run.world_hash': hash_here}).load_world()
    other = Scenario.load('flat', {**small, 'run.world_hash': '0' * 32})
    with pytest.raises(WorldError, match=f'run.world_hash: 0+ is not the world of these '
                                         f'parameters here, {hash_here}; to go on with that one'):
        other.world_folder()


def test_hazard_cameras_by_name(tmp_path) -> None:
    """A file adds cameras; two of one name, or with one frame, are refused."""
    text = ('render_node:\n  ros__parameters:\n    hazard:\n'
            '      {}: {{rate_hz: 5}}\n      {}: {}\n')
    path = tmp_path / 'own.yaml'
    path.write_text(text.format('front', 'rear', '{stereo_baseline_m: 0.1}'))
    scenario = Scenario.load(path)
    assert list(scenario.render_node.hazard) == ['front', 'rear']
    again = tmp_path / 'again.yaml'
    again.write_text(scenario.to_yaml())
    assert Scenario.load(again).render_node == scenario.render_node
    path.write_text(text.format('front', 'front', '{}'))
    with pytest.raises(ConfigError, match="'front' is given twice"):
        Scenario.load(path)
    path.write_text(text.format('front_left', 'front', '{stereo_baseline_m: 0.1}'))
    with pytest.raises(ConfigError, match='two cameras have the frame hazard_front_left_link'):
        Scenario.load(path)


FILE = """
/**: {ros__parameters: {seed: 3, world: /w}}
drive_node: {ros__parameters: {seed: 4, shape.size: 2.0}}
physics_node: {ros__parameters: {step_s: 0.001}}
/rover2/drive_node: {ros__parameters: {seed: 5}}
"""


def arguments(path: Path, folder: Path, program: str = 'drive_node') -> list[str]:
    """Return the arguments of a node that is given a file."""
    return arguments_of_program(
        [program, '--params-file', 'of the program', '--ros-args', '--params-file', str(path),
         '-p', 'seed:=9'], program, folder)


@pytest.mark.parametrize('name', ['drive_node', '/**/drive_node'])
def test_the_section_of_a_program_holds_under_every_name(tmp_path: Path, name: str) -> None:
    """It joins `/**`, where later arguments win; other sections keep their meaning for ROS 2."""
    path = tmp_path / 'file.yaml'
    path.write_text(FILE.replace('\ndrive_node', f'\n{name}'))
    given = arguments(path, tmp_path)
    assert given[:5] == ['drive_node', '--params-file', 'of the program', '--ros-args',
                         '--params-file'] and given[6:] == ['-p', 'seed:=9']
    sections = yaml.safe_load(Path(given[5]).read_text())
    assert sections['/**']['ros__parameters'] == {'seed': 4, 'world': '/w', 'shape.size': 2.0}
    assert sections['/rover2/drive_node']['ros__parameters'] == {'seed': 5}
    assert 'drive_node' not in sections and 'physics_node' in sections


def test_a_file_without_the_program_is_left_alone(tmp_path: Path) -> None:
    """Also one of another package."""
    path = tmp_path / 'file.yaml'
    path.write_text(FILE)
    assert arguments(path, tmp_path, 'render_node')[5] == str(path)


@pytest.mark.parametrize(('text', 'said'), [
    (None, 'no such file'), ('a: [1', 'not valid YAML'), ('- 1', 'not a parameter file'),
    ('drive_node: {seed: 1}', "section 'drive_node' must hold 'ros__parameters'"),
    ('drive_node: {ros__parameters: 1}', 'not a mapping of parameters')])
def test_bad_files_are_named(tmp_path: Path, text: str | None, said: str) -> None:
    """In one line, instead of an error of rcl's parser with a traceback."""
    path = tmp_path / 'file.yaml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        arguments(path, tmp_path)


def test_a_scenario_may_name_nodes_in_every_namespace(tmp_path: Path) -> None:
    """As ROS 2 users write it; but not both ways in one file."""
    path = tmp_path / 'scenario.yaml'
    path.write_text('/**/drive_node: {ros__parameters: {speed_mps: 0.07}}\n')
    assert Scenario.load(path).drive_node.speed_mps == 0.07
    path.write_text(path.read_text() + 'drive_node: {ros__parameters: {speed_mps: 0.08}}\n')
    with pytest.raises(ConfigError, match='section drive_node is given twice'):
        Scenario.load(path)


@pytest.mark.parametrize(('value', 'said'), [
    ('[]', '-p topics: [] is not valid: ROS 2 gives an empty list no type; leave the parameter'),
    ('[ ]', '-p topics: [] is not valid'),
    ('[[1], [2]]', 'valid is a list of numbers or of texts'),
    ('[{a: 1}]', 'valid is a list of numbers or of texts'), ('[1', 'not valid YAML')])
def test_lists_that_ros_does_not_take_are_named(tmp_path: Path, value: str, said: str) -> None:
    """On the command line and in a file; it would say nothing of the parameter, or drop items."""
    words = ['recorder_node', '--ros-args', '-p', f'topics:={value}']
    with pytest.raises(ConfigError, match=re.escape(said)):
        arguments_of_program(words, 'recorder_node', tmp_path)
    path = tmp_path / 'file.yaml'
    path.write_text(f'/**: {{ros__parameters: {{topics: {value}}}}}\n')
    with pytest.raises(ConfigError, match='file.yaml.*not valid'):
        arguments(path, tmp_path, 'recorder_node')
    words[-1] = 'topics:=[odom, imu/data_raw]'
    assert arguments_of_program(words, 'recorder_node', tmp_path) == words


VALID = 'scenario', 'output', 'duration'


def test_a_mistyped_name_is_refused() -> None:
    with pytest.raises(ConfigError, match='scenari: no such launch argument; did you mean scenar'):
        check_launch_arguments(['output:=x', 'scenari:=flat'], VALID)


def test_arguments_of_a_launch_file_around_it_are_not() -> None:
    check_launch_arguments(['scenario:=flat', 'rovers:=a b', 'use_rviz:=true', '--debug'], VALID)


def test_a_recorded_scenario_of_an_earlier_version_is_read(
        caplog: pytest.LogCaptureFixture) -> None:
    """It names every parameter of its version: each is one of today, or stands in `gone`."""
    path = Path(__file__).with_name('scenario_of_1.0.0.yaml')
    assert Scenario.load(path).shared.seed == 3
    assert not caplog.records
    with pytest.raises(ConfigError, match='blind_metres: no such parameter'):
        Scenario.load(path, ['navigator_node.plan.blind_metres=0.3'])
    assert Scenario.load(path, ['navigator_node.plan.blind_m=0.3']).name
    assert 'navigator_node.plan.blind_m: there is no such parameter any more; 0.3 is ignored' in \
        caplog.text


@pytest.mark.parametrize('frame_hz, depth_every, end_s', [(10.0, 2, 1.0), (0.5, 1, 2.0),
                                                          (0.25, 1, 4.0), (0.5, 2, 2.0)])
def test_a_drive_ends_where_images_are_due(frame_hz, depth_every, end_s):
    """Time waits for the answers to its end: between two images there would be none."""
    scenario = resolve(Scenario.load('expedition', [
        f'render_node.frame_rate_hz={frame_hz}', f'render_node.depth_every={depth_every}',
        'navigator_node.map_age_s=20']))
    assert scenario.navigator_node.end_step_s == end_s
