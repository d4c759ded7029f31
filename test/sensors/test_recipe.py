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

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.sensors.registry import card_contents, SENSORS

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
RECIPE = Path(__file__).parent / 'recipe'
# File → text that is there, text that comes before it.
EDITS = {
    'base/topics.py': (
        ("JOINT_COMMANDS = Topic('joint_commands'",
         "THERMOMETER = Topic('thermometer/temperature', 'sensor_msgs/msg/Temperature', EVENT,\n"
         "                    'physics_node', frames.BASE_FRAME, 'of its plate [deg C], at '\n"
         "                    'thermometer.rate_hz')\n"),
        ('    JOINT_COMMANDS, CMD_VEL, LEFT_IMAGE', '    THERMOMETER,\n')),
    'sensors/registry.py': (
        ('from lunar_rover_sim.sensors.wheel_odometry import',
         'from lunar_rover_sim.sensors.thermometer import Thermometer, ThermometerConfig\n'),
        ('Imu, FootSlip', 'Thermometer, '),
        ('    wheel_odometry: WheelOdometryConfig =',
         '    thermometer: ThermometerConfig = group(ThermometerConfig)\n')),
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
    shutil.copy(RECIPE / 'thermometer.py', package / 'sensors')
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


def test_all_records_it_and_the_check_counts_on_it(source: Path, episode: Path,
                                                   tmp_path: Path) -> None:
    """A plate that looks at a sun of 10 degrees or so is warmer than in shadow, and below 80."""
    run(source, 'bag', 'check', episode / 'bag')
    with open_bag(episode / 'bag') as bag:
        stamps, degrees = zip(*((header_ns(message), message.temperature) for _, _, message
                                in bag.messages(['thermometer/temperature'])))
        kept = [message for message in bag.raw() if 'thermometer' not in message.topic]
    assert stamps == (100_000_000, 200_000_000, 300_000_000, 400_000_000)
    assert -150.0 < min(degrees) and max(degrees) < 80.0
    with BagWriter(tmp_path / 'bag') as writer:
        for topic, kind, time_ns, raw in kept:
            writer.write(topic, kind, raw, time_ns)
    with pytest.raises(AssertionError, match='missing: thermometer/temperature'):
        run(source, 'bag', 'check', tmp_path / 'bag')


# Where its author stops early: what is missing, by file, and what is said.
ROW, SENSOR = ('base/topics.py', '    THERMOMETER,\n'), ('sensors/registry.py', 'Thermometer, ')
PARAMETERS = ('sensors/registry.py',
              '    thermometer: ThermometerConfig = group(ThermometerConfig)\n')
FORGOTTEN = {
    'row': ([ROW], 'thermometer/temperature is no row of physics_node in CONTRACT'),
    'sensor': ([SENSOR], 'SensorsConfig: thermometer: no such sensor in SENSORS'),
    'parameters': ([PARAMETERS], 'its parameters are in only one of its class and SensorsConfig'),
    'both': ([SENSOR, PARAMETERS], 'thermometer/temperature: a row of physics_node in CONTRACT of '
             'base/topics.py that nobody publishes')}


@pytest.mark.parametrize('forgotten', FORGOTTEN)
def test_it_cannot_vanish(source: Path, world_folder: Path, domain: int,
                          forgotten: str) -> None:
    """The node names a row without a publisher; importing the sensors names the other gaps."""
    missing, said = FORGOTTEN[forgotten]
    paths = {name: source / 'lunar_rover_sim' / name for name, _ in missing}
    whole = {path: path.read_text() for path in paths.values()}
    try:
        for name, text in missing:
            before, after = paths[name].read_text().rsplit(text, 1)
            paths[name].write_text(before + after)
        program = (['-m', 'lunar_rover_sim.nodes.entry_points', 'physics_node', '--ros-args', '-p',
                    f'world:={world_folder}', '-p', 'duration_s:=0.1'] if forgotten == 'both'
                   else ['-c', 'import lunar_rover_sim.sensors.registry'])
        done = subprocess.run(
            [sys.executable, *program],
            env={**os.environ, 'PYTHONPATH': str(source)}, cwd=source, capture_output=True,
            text=True, timeout=300)
        assert done.returncode == 1
        assert said in done.stderr
    finally:
        for path, text in whole.items():
            path.write_text(text)


def test_it_stands_on_the_data_card(dataset: Path) -> None:
    card = json.loads((dataset / 'card.json').read_text())
    assert 'thermometer' in card['contents']
    assert 'thermometer' in (dataset / 'README.md').read_text()


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
    found = [sample['thermometer']['temperature_c'] for sample in samples
             if sample['thermometer'] is not None]
    assert len(found) >= len(samples) - 1       # the first image comes before it
    assert np.std(found) < 1.0


def test_an_export_that_has_no_place_for_it_names_it(source: Path, episode: Path,
                                                     tmp_path: Path) -> None:
    told = run(source, 'bag', 'export', episode / 'bag', '--format', 'kitti', '-o',
               tmp_path / 'out')
    assert any('left out' in line and 'thermometer/temperature' in line
               for line in told.splitlines())


def test_it_is_drawn(source: Path, episode: Path, tmp_path: Path) -> None:
    run(source, 'bag', 'preview', episode / 'bag', '-o', tmp_path / 'out')
    assert (tmp_path / 'out' / 'sensors.png').is_file()


def test_each_has_its_own_name_topics_and_stream() -> None:
    names = [sensor.name for sensor in SENSORS]
    published = [topic for sensor in SENSORS for topic in sensor.published]
    streams = [sensor.stream for sensor in SENSORS if sensor.stream]
    for values in (names, published, streams):
        assert len(values) == len(set(values))


def test_each_has_a_place_on_the_data_card() -> None:
    found = card_contents()
    assert {topic for published in found.values() for topic in published} == {
        topic for sensor in SENSORS for topic in sensor.published}
    assert {'imu', 'feet', 'heading', 'power'} <= {content.name for content in found}
