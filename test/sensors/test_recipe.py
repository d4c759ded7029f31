"""A sensor by the recipe of CONTRIBUTING.md: what it takes, and that all else follows.

The sensor is added to a copy of the package, in which a campaign of one episode is recorded.
"""

import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tarfile

import numpy as np
import pytest

from lunar_rover_sim.base import topics
from lunar_rover_sim.run.node_config import PhysicsNodeConfig
from lunar_rover_sim.sensors.power_monitor import PowerMonitorConfig
from lunar_rover_sim.sensors.registry import card_contents, sensor_of, SENSORS, SensorsConfig
from lunar_rover_sim.sensors.star_tracker import StarTrackerConfig
from lunar_rover_sim.sensors.sun_sensor import SunSensorConfig

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
RECIPE = Path(__file__).parent / 'recipe'
# File → text that is there, text that comes before it.
EDITS = {
    'topics.py': (
        ("JOINT_COMMANDS = Topic('joint_commands'",
         "INCLINOMETER = Topic('inclinometer/tilt', 'geometry_msgs/msg/Vector3Stamped', EVENT,\n"
         "                     'physics_node', frames.BASE_FRAME, 'noisy roll and pitch [rad], '\n"
         "                     'at inclinometer.rate_hz', on_request=True)\n"),
        ('    JOINT_COMMANDS, CMD_VEL, LEFT_IMAGE', '    INCLINOMETER,\n')),
    'sensors/registry.py': (
        ('from lunar_rover_sim.sensors.power_monitor import',
         'from lunar_rover_sim.sensors.inclinometer import Inclinometer, InclinometerConfig\n'),
        ('Imu, FootSlip', 'Inclinometer, '),
        ('    odometry: OdometryConfig =',
         '    inclinometer: InclinometerConfig = group(InclinometerConfig)\n')),
}


@pytest.fixture(scope='module')
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the sources with the sensor."""
    root = tmp_path_factory.mktemp('source')
    package = root / 'lunar_rover_sim'
    # With what Python and Numba have compiled: it is valid for files of the same time and size.
    shutil.copytree(ROOT / 'lunar_rover_sim', package)
    for name in ('config', 'resource', 'package.xml'):
        (root / name).symlink_to(ROOT / name)
    shutil.copy(RECIPE / 'inclinometer.py', package / 'sensors')
    for name, insertions in EDITS.items():
        text = (package / name).read_text()
        for there, new in insertions:
            assert text.count(there) == 1, there
            text = text.replace(there, new + there)
        (package / name).write_text(text)
    return root


def run(source: Path, *words: str | Path) -> str:
    """Run a command of the copy and return what it prints."""
    done = subprocess.run([sys.executable, '-m', 'lunar_rover_sim.cli.main', *map(str, words)],
                          env={**os.environ, 'PYTHONPATH': str(source)}, cwd=source,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout + done.stderr


@pytest.fixture(scope='module')
def dataset(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data set of a campaign: one episode, checked."""
    folder = tmp_path_factory.mktemp('campaign') / 'out'
    run(source, 'campaign', RECIPE / 'campaign.yaml', '-o', folder)
    return folder


@pytest.fixture(scope='module')
def episode(dataset: Path) -> Path:
    found, = (dataset / 'episodes').iterdir()
    return found


def test_it_takes_the_sensor_its_topic_and_its_row_in_the_registry() -> None:
    """Beside test, page, layout and changelog: seven files."""
    assert len({'sensors/inclinometer.py', *EDITS}) + 4 == 7


def test_it_is_recorded_and_checked(source: Path, episode: Path) -> None:
    info = run(source, 'bag', 'info', episode / 'bag')
    assert '/inclinometer/tilt' in info
    assert 'inclinometer/tilt' in json.loads((episode / 'manifest.json').read_text())['topics']
    run(source, 'bag', 'check', episode / 'bag')


def test_an_invalid_parameter_is_refused(source: Path, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match='inclinometer.rate_hz: 7 is not valid; valid is a '
                       'divisor of state_rate_hz = 200'):
        run(source, 'run', 'flat', '--set', 'physics_node.inclinometer.rate_hz=7',
            '-o', tmp_path / 'out')


def test_it_stands_on_the_data_card(dataset: Path) -> None:
    card = json.loads((dataset / 'card.json').read_text())
    assert 'inclinometer' in card['contents']
    assert 'inclinometer' in (dataset / 'README.md').read_text()


def test_it_is_in_the_samples_of_a_learner(episode: Path) -> None:
    samples = []
    for path in sorted((episode / 'webdataset').glob('*.tar')):
        with tarfile.open(path) as tar:
            for member in tar:
                if member.name.endswith('.json'):
                    file = tar.extractfile(member)
                    assert file is not None
                    samples.append(json.load(file))
    assert samples
    tilts = [sample['inclinometer']['tilt_rad'] for sample in samples
             if sample['inclinometer'] is not None]
    assert len(tilts) >= len(samples) - 1       # the first image comes before it
    assert np.abs(tilts).max() < 0.1


def test_an_export_that_has_no_place_for_it_names_it(source: Path, episode: Path,
                                                     tmp_path: Path) -> None:
    told = run(source, 'bag', 'export', episode / 'bag', '--format', 'kitti', '-o',
               tmp_path / 'out')
    assert any('left out' in line and 'inclinometer/tilt' in line for line in told.splitlines())


def test_it_is_drawn(source: Path, episode: Path, tmp_path: Path) -> None:
    run(source, 'bag', 'preview', episode / 'bag', '-o', tmp_path / 'out')
    assert (tmp_path / 'out' / 'heading_and_power.png').is_file()


def test_each_has_its_own_name_topics_and_stream() -> None:
    names = [sensor.name for sensor in SENSORS]
    published = [topic for sensor in SENSORS for topic in sensor.published]
    streams = [sensor.stream for sensor in SENSORS if sensor.stream]
    for values in (names, published, streams):
        assert len(values) == len(set(values))
    assert set(published) <= set(topics.CONTRACT)


def test_what_is_made_on_request_of_states_is_of_a_sensor() -> None:
    """But for maps of the ground, and diagnostics."""
    others = topics.GROUND_SNAPSHOT, topics.DIAGNOSTICS
    for topic in topics.CONTRACT:
        if topic.node == 'physics_node' and topic.on_request and topic not in others:
            assert sensor_of(topic.name) is not None, topic.name
    assert sensor_of(topics.ODOM.name) is None


def test_parameters_stand_under_the_name_of_their_sensor() -> None:
    for sensor in SENSORS:
        config = getattr(SensorsConfig(), sensor.name, None)
        assert (config is None) == (sensor.parameters is None)
        assert sensor.parameters is None or isinstance(config, sensor.parameters)
    config = PhysicsNodeConfig()
    assert (config.power_monitor, config.sun_sensor, config.star_tracker) == (
        PowerMonitorConfig(), SunSensorConfig(), StarTrackerConfig())


def test_each_has_a_place_on_the_data_card() -> None:
    found = card_contents()
    assert {topic for published in found.values() for topic in published} == {
        topic for sensor in SENSORS for topic in sensor.published}
    assert {'imu', 'feet', 'heading', 'power'} <= {content.name for content in found}
