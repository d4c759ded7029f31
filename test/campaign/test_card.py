"""The data card for other programs (Croissant, Hugging Face)."""

import csv
import json
from pathlib import Path
from typing import Any

import mlcroissant
import pytest
import yaml

from lunar_rover_sim.campaign.card import front_matter, write_card
from lunar_rover_sim.campaign.manifest import CAMPAIGN_FILE, EPISODES, MANIFEST, write_json

STATISTICS = {'duration_s': 20.0, 'frames': 400, 'sgm_error_px': None, 'bytes': 3_000_000_000}


@pytest.fixture(scope='module')
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes without bags."""
    folder = tmp_path_factory.mktemp('data')
    write_json(folder / CAMPAIGN_FILE, {'campaign': {
        'name': 'polar suns', 'license': 'CC-BY-4.0', 'formats': ['coco'], 'base': 'baseline',
        'settings': {'render_node.sensor.encoding': 'bayer_rggb16'}}})
    for name in ('0000', '0001', '0002'):
        (folder / EPISODES / name).mkdir(parents=True)
        write_json(folder / EPISODES / name / MANIFEST, {
            'name': name, 'bag_hash': f'ab{name}',
            'statistics': {**STATISTICS, 'frames': 400 + int(name)}})
    write_card(folder)
    return folder


def test_croissant_is_valid_and_its_records_are_read(dataset: Path) -> None:
    described = mlcroissant.Dataset(dataset / 'croissant.json')
    assert not described.metadata.issues.errors
    warned = ' '.join(described.metadata.issues.warnings)
    assert warned.count('is recommended') == len(described.metadata.issues.warnings) == 2
    records = list(described.records('episodes'))
    assert [r['episodes/folder'] for r in records] == [
        b'episodes/0000', b'episodes/0001', b'episodes/0002']
    assert [r['episodes/frames'] for r in records] == [400, 401, 402]
    assert records[0]['episodes/bytes'] == 3_000_000_000
    assert records[0]['episodes/sgm_error_px'] is None
    sets = {item.id for item in described.metadata.distribution}
    assert sets == {'card.json', 'episodes.csv', 'bag', 'coco'}


def test_the_table_names_folders_that_are_there(dataset: Path) -> None:
    rows = list(csv.DictReader((dataset / 'episodes.csv').open()))
    assert all((dataset / row['folder']).is_dir() for row in rows)
    assert rows[2]['bag_hash'] == 'ab0002' and rows[2]['sgm_error_px'] == ''


def head_of(text: str) -> dict[str, Any]:
    start, head, _ = text.split('---\n', 2)
    assert not start
    return yaml.safe_load(head)


def test_the_readme_begins_with_the_head_of_the_hub(dataset: Path) -> None:
    text = (dataset / 'README.md').read_text()
    head = head_of(text)
    assert head['license'] == 'cc-by-4.0' and head['size_categories'] == ['1K<n<10K']
    assert (dataset / head['configs'][0]['data_files']).is_file()
    assert text.split('---\n', 2)[2].startswith('\n# polar suns\n')


def test_the_readme_says_what_is_set_in_all_episodes(dataset: Path) -> None:
    """What images are, above all: a mosaic, or grey."""
    text = (dataset / 'README.md').read_text()
    assert '| `render_node.sensor.encoding` | `bayer_rggb16` |' in text.split('## What is set')[1]


@pytest.mark.parametrize('frames, size', [(0, 'n<1K'), (999, 'n<1K'), (1000, '1K<n<10K'),
                                          (2_000_000, 'n>1M')])
def test_sizes_and_other_licences(frames: int, size: str) -> None:
    head = head_of(front_matter({'license': 'Our terms: see "x"', 'name': 'a: b', 'contents': [],
                                 'campaign': {},
                                 'statistics': {'frames': {'total': frames}}}))
    assert head['license'] == 'other' and head['license_name'] == 'Our terms: see "x"'
    assert head['pretty_name'] == 'a: b' and head['size_categories'] == [size]


LEFT, RIGHT, IMU = 'stereo/left/image_raw', 'stereo/right/image_raw', 'imu/data_raw'
TRUTH = ['ground_truth/depth/image', 'ground_truth/labels']


@pytest.mark.parametrize('recorded, kept, tags, tasks', [
    ([LEFT, 'odom'], {}, {'slam', 'ros2'}, []),
    ([LEFT, RIGHT, IMU, *TRUTH, 'lidar/points'], {}, {'stereo', 'imu', 'lidar', 'slam', 'ros2'},
     ['depth-estimation', 'image-segmentation']),
    ([LEFT, RIGHT, IMU], {'keep_bag': False, 'formats': ['kitti']}, {'stereo', 'slam'}, []),
    ([LEFT, RIGHT, IMU, TRUTH[0]], {'keep_bag': False, 'formats': ['tum']}, {'slam'},
     ['depth-estimation']),
    ([IMU], {}, {'imu', 'ros2'}, [])])
def test_tags_follow_what_is_in_the_data(tmp_path: Path, recorded: list[str],
                                         kept: dict[str, Any], tags: set[str],
                                         tasks: list[str]) -> None:
    write_json(tmp_path / CAMPAIGN_FILE, {'campaign': {'name': 'x', 'license': 'MIT', **kept}})
    for name, names in (('0000', recorded), ('0001', [])):
        (tmp_path / EPISODES / name).mkdir(parents=True)
        write_json(tmp_path / EPISODES / name / MANIFEST, {
            'name': name, 'topics': names, 'statistics': {'imu_preset': 'adis16448'}})
    write_card(tmp_path)
    text = (tmp_path / 'README.md').read_text()
    head = head_of(text)
    assert set(head['tags']) == {'moon', 'simulation', *tags}
    assert head['task_categories'] == ['robotics', *tasks]
    assert ('IMU noise' in text) == ('inertial data' in text) == ('imu' in tags)
    assert ('stereo images' in text) == ('stereo' in tags)


@pytest.mark.parametrize('recorded, formats, scans', [
    ([LEFT, 'lidar/points', 'sun_sensor/direction', 'power/bus'], ['webdataset'], True),
    ([LEFT, 'lidar/scan'], ['webdataset'], True), ([LEFT], ['webdataset'], False),
    ([LEFT, 'lidar/points'], ['euroc'], False)])
def test_croissant_describes_the_scans_in_shards(tmp_path: Path, recorded: list[str],
                                                 formats: list[str], scans: bool) -> None:
    write_json(tmp_path / CAMPAIGN_FILE, {'campaign': {
        'name': 'x', 'license': 'MIT', 'keep_bag': False, 'formats': formats}})
    (tmp_path / EPISODES / '0000').mkdir(parents=True)
    write_json(tmp_path / EPISODES / '0000' / MANIFEST, {
        'name': '0000', 'topics': recorded, 'statistics': STATISTICS})
    write_card(tmp_path)
    metadata = mlcroissant.Dataset(tmp_path / 'croissant.json').metadata
    assert not metadata.issues.errors
    sets = {item.id: item for item in metadata.distribution}
    assert ('webdataset/lidar' in sets) == scans
    text = (tmp_path / 'README.md').read_text()
    assert ('LiDAR scans' in text.split('##')[0]) == ('lidar' in head_of(text)['tags']) == scans
    if scans:
        assert 'x_m, y_m, z_m, intensity_percent, ring, time_s' in sets[
            'webdataset/lidar'].description
    assert ('wheel odometry and power.' in text) == ('power/bus' in recorded)


def test_the_same_data_set_has_the_same_card(dataset: Path) -> None:
    names = ('card.json', 'croissant.json', 'episodes.csv', 'README.md')
    before = [(dataset / name).read_bytes() for name in names]
    write_card(dataset)
    assert [(dataset / name).read_bytes() for name in names] == before
    assert json.loads(before[1])['name'] == 'polar suns'
