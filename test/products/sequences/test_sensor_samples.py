"""LiDAR, heading and power in samples of WebDataset, and what other formats say of them."""

from collections.abc import Callable
import functools
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from products.sequences.shard_reader import read_shards
import pytest
import sensor_items
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, SequenceError
from lunar_rover_sim.base.frames import inverse, matrix_from_wxyz
from lunar_rover_sim.products.sequences.export import (export, FORMATS, hazards_left_out,
                                                       OF_SENSORS, sensors_left_out)
from lunar_rover_sim.products.sequences.sensor_samples import KEPT_NS, RecentMessages
from lunar_rover_sim.rover.description import Legs

NEEDED = (topics.LEFT_IMAGE, topics.LEFT_INFO, topics.RIGHT_IMAGE, topics.RIGHT_INFO,
          topics.TRUE_DEPTH, topics.ODOM, topics.IMU_RAW, topics.TF_STATIC)
MS = 1_000_000
SCAN_NS = 150 * MS
HEADING_NS = (120 * MS, 220 * MS, 240 * MS, 340 * MS, 400 * MS)


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    """Return images at 0.1 to 0.5 s, one scan, heading at some times, power at most."""
    found = sensor_items.with_lidar_frame(synthetic.drive(0.5, only=NEEDED))
    found += [sensor_items.cloud_item(topic, SCAN_NS, sensor_items.scan_points(
        SCAN_NS, topic is topics.LIDAR_DESKEWED))
        for topic in (topics.LIDAR_POINTS, topics.LIDAR_DESKEWED)]
    found.append(sensor_items.scan_item(SCAN_NS))
    for ns in HEADING_NS:
        found += [*sensor_items.heading_items(ns), *sensor_items.foot_items(ns)]
    for ns in range(5 * MS, 505 * MS, 35 * MS):
        found += sensor_items.power_items(ns)
    labels = np.zeros((synthetic.HEIGHT, synthetic.WIDTH), np.uint16)
    labels[50:70, 40:80] = 17
    found += [synthetic.picture(topics.LABELS, k * 100 * MS, 'mono16', labels)
              for k in range(1, 6)]
    return found


@pytest.fixture(scope='module')
def bag(items: list[synthetic.Item], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic.write(tmp_path_factory.mktemp('sensors') / 'bag', items)


def samples(folder: Path) -> list[tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """Return the JSON and the arrays of each sample."""
    return [(json.loads(files['json'], parse_constant=pytest.fail),
             {name: np.load(io.BytesIO(data), allow_pickle=False)
              for name, data in files.items() if name.endswith('.npy')})
            for _, files in read_shards(folder)]


@pytest.fixture(scope='module')
def made(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('shards') / 'out'
    notes = export(bag, folder, 'webdataset')
    assert [note for note in notes if 'left out' in note] == [
        'left out: imu/data_raw; this format has no place for them']
    return folder


def test_a_scan_is_the_last_at_or_before_the_image(made: Path) -> None:
    found = samples(made)
    assert len(found) == 5
    values, arrays = found[0]       # at 0.1 s, before the scan
    assert values['lidar'] is None and values['lidar_scan'] is None
    assert not any(name.startswith('lidar') for name in arrays)
    for values, arrays in found[1:]:
        assert values['lidar']['stamp_ns'] == SCAN_NS
        assert values['lidar']['frame'] == 'lidar_link'
        points = sensor_items.scan_points(SCAN_NS, False)
        rows = arrays['lidar.npy']
        assert rows.dtype == np.float32 and rows.shape == (len(points), 6)
        assert values['lidar']['columns'] == [
            'x_m', 'y_m', 'z_m', 'intensity_percent', 'ring', 'time_s']
        for k, name in enumerate(('x', 'y', 'z', 'intensity', 'ring', 'time')):
            np.testing.assert_array_equal(rows[:, k], points[name])
        ring = arrays['lidar_scan.npy']
        assert ring.shape == (360, 2) and np.isinf(ring[::10, 0]).all()
        assert values['lidar_scan']['angle_increment_rad'] == pytest.approx(np.radians(1), 1e-6)


def test_deskewed_points_lie_on_the_ground_by_the_transforms_of_the_sample(made: Path) -> None:
    """T_odom_left of the scan's time, T_left_lidar; 5e-7 m is the resolution of float32 here."""
    values, arrays = samples(made)[1]
    T_left_lidar = np.array(values['T_left_lidar'])
    place = arrays['lidar_deskewed.npy'][:, :3].astype(float)
    T = (synthetic.pose_at(SCAN_NS * 1e-9) @ synthetic.T_base_camera(1.0) @ T_left_lidar)
    near = np.linalg.norm(place, axis=1) < 5.0
    height = (place @ T[:3, :3].T + T[:3, 3])[near, 2]
    assert np.abs(height).max() < 2e-6
    document = yaml.safe_load((made / 'calibration.yaml').read_text())
    np.testing.assert_allclose(document['lidar']['T_imu_lidar'], sensor_items.T_BASE_LIDAR,
                               atol=1e-9)     # the IMU is at base_link
    np.testing.assert_allclose(T_left_lidar, inverse(synthetic.T_base_camera(1.0))
                               @ sensor_items.T_BASE_LIDAR, atol=1e-8)


def test_heading_and_power_are_those_at_the_image(made: Path) -> None:
    found = samples(made)
    last = {100: None, 200: 120, 300: 240, 400: 400, 500: 400}      # [ms]
    for values, _ in found:
        expected = last[values['stamp_ns'] // MS]
        for name in ('sun_sensor', 'star_tracker', 'wheel_odometry'):
            if expected is None:
                assert values[name] is None
                continue
            assert values[name]['stamp_ns'] == expected * MS
        for line in ('front_left', 'rear_right', 'bus', 'solar'):
            own_ns = values['power'][line]['stamp_ns']
            assert 0 <= values['stamp_ns'] - own_ns < 35 * MS and own_ns % (35 * MS) == 5 * MS
        assert values['power']['bus'] == {
            'stamp_ns': own_ns, 'voltage_v': 12.0, 'current_a': pytest.approx(-0.5, 1e-6)}
    values, _ = found[2]
    T = synthetic.pose_at(0.24)
    np.testing.assert_allclose(T[:3, :3] @ values['sun_sensor']['direction'], sensor_items.SUN,
                               atol=1e-9)
    np.testing.assert_allclose(matrix_from_wxyz(values['star_tracker']['wxyz_world_base']),
                               T[:3, :3], atol=1e-9)
    np.testing.assert_allclose(values['wheel_odometry']['T_wheel_odom_base'], T, atol=1e-9)


def test_what_is_not_a_number_is_null(tmp_path: Path, items: list[synthetic.Item]) -> None:
    """JSON has no NaN; a sensor that the bag lacks has no key."""
    kept = [item for item in items if item.topic in {topic.name for topic in NEEDED}]
    broken = sensor_items.power_item(sensor_items.POWER[4], 50 * MS, float('nan'))
    bag = synthetic.write(tmp_path / 'bag', [*kept, broken])
    export(bag, tmp_path / 'out', 'webdataset')
    values, _ = samples(tmp_path / 'out')[0]
    assert values['power'] == {'bus': {'stamp_ns': 50 * MS, 'voltage_v': 12.0,
                                       'current_a': None}}
    assert not {'lidar', 'sun_sensor', 'T_left_lidar'}.intersection(values)


def test_scans_that_are_not_whole_are_refused(tmp_path: Path,
                                              items: list[synthetic.Item]) -> None:
    broken = sensor_items.scan_item(SCAN_NS)
    broken.message.intensities = np.zeros(3, np.float32)
    kept = [item for item in items if item.topic != topics.LIDAR_SCAN.name]
    bag = synthetic.write(tmp_path / 'bag', [*kept, broken])
    with pytest.raises(BagError, match='lidar/scan: 3 intensities for 360 ranges'):
        export(bag, tmp_path / 'out', 'webdataset')
    assert not (tmp_path / 'out').exists()


SENSOR_TOPICS = tuple(topic.name for topic in topics.of_legs(OF_SENSORS, Legs().names))
Exported = Callable[..., tuple[dict[str, bytes], dict[str, str]]]


@pytest.fixture(scope='module')
def exported(items: list[synthetic.Item], tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Return what makes, of a format and lacking topics, its files and why topics are left out."""
    few = [item for item in items if item.topic == topics.TF_STATIC.name
           or header_ns(item.message) <= 300 * MS]

    @functools.cache
    def made(kind: str, lacking: tuple[str, ...] = ()) -> tuple[dict[str, bytes], dict[str, str]]:
        folder = tmp_path_factory.mktemp('table') / 'run'     # which names the sequence
        bag = synthetic.write(folder / 'bag', [i for i in few if i.topic not in lacking])
        notes = export(bag, folder / 'out', kind)
        assert all(len(note.splitlines()) == 1 for note in notes)
        reasons = {}
        for note in notes:
            if note.startswith('left out: '):
                names, _, reason = note.removeprefix('left out: ').partition('; ')
                reasons.update(dict.fromkeys(names.split(', '), reason))
        # The calibration is of all sensors of the bag.
        return {str(path.relative_to(folder)): path.read_bytes()
                for path in (folder / 'out').rglob('*')
                if path.is_file() and path.name != 'calibration.yaml'}, reasons

    return made


@pytest.mark.parametrize('topic', SENSOR_TOPICS)
@pytest.mark.parametrize('kind', FORMATS)
def test_a_sensor_is_in_a_format_or_named(kind: str, topic: str, exported: Exported) -> None:
    """Without its messages the files are others, or there are none; else a line says why."""
    files, reasons = exported(kind)
    if topic in reasons:
        assert reasons[topic]
        return
    try:
        assert exported(kind, (topic,))[0] != files
    except SequenceError as error:
        assert topic in str(error)


@pytest.mark.parametrize('kind', FORMATS)
def test_what_is_named_changes_nothing(kind: str, exported: Exported) -> None:
    """Nothing of the sensors that are left out is in the files."""
    files, reasons = exported(kind)
    assert exported(kind, tuple(reasons))[0] == files


def test_a_topic_without_messages_is_not_left_out(tmp_path: Path) -> None:
    bag = synthetic.write(tmp_path / 'bag', sensor_items.heading_items(MS)[:1])
    with open_bag(bag) as opened:
        assert sensors_left_out(opened, ()) == [
            'left out: sun_sensor/direction; this format has no place for them']
        assert not sensors_left_out(opened, ('sun_sensor/direction',))
        assert not hazards_left_out(opened, ())


def test_the_last_message_at_or_before() -> None:
    """Of a silent topic the last message counts however old it is; of others a second is kept."""
    recent: RecentMessages[int] = RecentMessages()
    assert recent.at('a', 10) is None
    recent.add('a', 5, 1)
    assert recent.at('a', 4) is None and recent.at('a', 5) == (5, 1)
    assert recent.at('a', 10 * KEPT_NS) == (5, 1)
    for k in range(1, 400):
        recent.add('a', k * KEPT_NS // 100, k)
    assert recent.at('a', 300 * KEPT_NS // 100) == (300 * KEPT_NS // 100, 300)
    assert recent.at('a', 200 * KEPT_NS // 100) is None       # forgotten
