"""WebDataset shards: what tars hold is what the bag holds, in samples that readers find."""

import io
import json
from pathlib import Path
import tarfile

from command_line import unfolded
import cv2
import numpy as np
from products.sequences.shard_reader import read_shards
import pytest
import synthetic_bag

from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.bag.series import picture
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import SequenceError
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.products.sequences.webdataset import key_part, ShardOptions, ShardWriter

TOPICS = (topics.LEFT_IMAGE, topics.LEFT_INFO, topics.RIGHT_IMAGE, topics.RIGHT_INFO,
          topics.TRUE_DEPTH, topics.ODOM, topics.TF_STATIC, topics.WORLD_HASH)
LAYERS = {topics.LABELS: ('mono16', (), np.uint16), topics.SHADOW: ('rgb8', (3,), np.uint8),
          topics.OPTICAL_FLOW: ('32FC2', (2,), np.float32),
          topics.RIGHT_LABELS: ('mono16', (), np.uint16),
          topics.RIGHT_TRUE_DEPTH: ('32FC1', (), np.float32)}
EXTENSIONS = ['depth.npy', 'json', 'labels.npy', 'left.png', 'optical_flow.npy', 'right.png',
              'right_depth.npy', 'right_labels.npy', 'shadow.png']


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of 5 sets with labels, shadow and flow of chance."""
    items = synthetic_bag.drive(0.5, only=TOPICS)
    rng = np.random.default_rng(1)
    for k in range(1, 6):
        for topic, (encoding, channels, kind) in LAYERS.items():
            pixels = rng.integers(0, 200, (synthetic_bag.HEIGHT, synthetic_bag.WIDTH, *channels))
            items.append(synthetic_bag.picture(topic, k * 10**8, encoding, pixels.astype(kind)))
    items.append(synthetic_bag.text(topics.LABEL_INFO, '{"rocks": {}}'))
    return synthetic_bag.write(tmp_path_factory.mktemp('web') / 'my.drive' / 'bag', items)


@pytest.fixture(scope='module')
def shards(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the shards of that bag, two samples in each."""
    folder = tmp_path_factory.mktemp('shards') / 'out'
    assert main(['bag', 'export', str(bag), '-o', str(folder), '--format', 'webdataset',
                 '--shard-size', '2']) == 0
    return folder


def test_samples_are_whole_and_their_keys_differ(shards: Path) -> None:
    found = read_shards(shards)
    assert [key for key, _ in found] == [f'my_drive-{k:06d}' for k in range(5)]
    assert all(sorted(files) == EXTENSIONS for _, files in found)
    assert (shards / 'label_info.json').read_text() == '{"rocks": {}}'


def test_samples_hold_what_the_bag_holds(shards: Path, bag: Path) -> None:
    found = read_shards(shards)
    with open_bag(bag) as source:
        for topic, extension in ((topics.LEFT_IMAGE, 'left.png'), (topics.SHADOW, 'shadow.png'),
                                 (topics.LABELS, 'labels.npy'), (topics.TRUE_DEPTH, 'depth.npy'),
                                 (topics.OPTICAL_FLOW, 'optical_flow.npy'),
                                 (topics.RIGHT_LABELS, 'right_labels.npy'),
                                 (topics.RIGHT_TRUE_DEPTH, 'right_depth.npy')):
            for (_, files), (_, _, message) in zip(found, source.messages([topic.name])):
                if extension.endswith('npy'):
                    pixels = np.load(io.BytesIO(files[extension]), allow_pickle=False)
                else:
                    pixels = cv2.imdecode(np.frombuffer(files[extension], np.uint8),
                                          cv2.IMREAD_UNCHANGED)
                    pixels = pixels[..., ::-1] if pixels.ndim == 3 else pixels
                truth = picture(source, message).pixels
                assert pixels.dtype == truth.dtype and np.array_equal(pixels, truth)


def test_poses_are_those_of_the_cameras_at_the_stamp(shards: Path) -> None:
    for k, (_, files) in enumerate(read_shards(shards), 1):
        told = json.loads(files['json'])
        assert told['stamp_ns'] == k * 10**8
        assert told['drive'] == 'my_drive' and told['world'] == 'ab' * 32
        for side, sign in (('left', 1.0), ('right', -1.0)):
            T = synthetic_bag.pose_at(k / 10) @ synthetic_bag.T_base_camera(sign)
            assert np.abs(np.array(told[f'T_odom_{side}']) - T).max() < 1e-8
        assert told['fx_fy_cx_cy_px'][0] == synthetic_bag.FOCAL_PX
        assert told['baseline_m'] == pytest.approx(synthetic_bag.MOUNT.baseline_m)


def test_index_lists_the_shards(shards: Path) -> None:
    index = json.loads((shards / 'index.json').read_text())
    assert [(s['url'], s['nsamples']) for s in index['shardlist']] == [
        ('shard-000000.tar', 2), ('shard-000001.tar', 2), ('shard-000002.tar', 1)]
    assert all((shards / s['url']).stat().st_size == s['filesize'] for s in index['shardlist'])


def test_the_same_bag_gives_the_same_bytes(shards: Path, bag: Path, tmp_path: Path) -> None:
    export(bag, tmp_path / 'again', 'webdataset', shards=ShardOptions(size=2))
    for path in shards.glob('*.tar'):
        assert path.read_bytes() == (tmp_path / 'again' / path.name).read_bytes()
    with tarfile.open(shards / 'shard-000000.tar') as tar:
        assert {(m.mtime, m.uid, m.gid, m.uname, m.mode) for m in tar} == {(0, 0, 0, '', 0o644)}


def test_the_library_reads_them(shards: Path) -> None:
    webdataset = pytest.importorskip('webdataset')
    data = webdataset.WebDataset(str(shards / 'shard-{000000..000002}.tar'),
                                 shardshuffle=False).decode()
    assert [s['__key__'] for s in data] == [f'my_drive-{k:06d}' for k in range(5)]
    for sample in data:
        assert sample['labels.npy'].dtype == np.uint16 and sample['json']['world'] == 'ab' * 32


def test_without_odometry_there_are_no_poses(tmp_path: Path) -> None:
    bag = synthetic_bag.write(tmp_path / 'blind', synthetic_bag.drive(0.2, only=(
        topics.LEFT_IMAGE, topics.LEFT_INFO, topics.TF_STATIC)))
    notes = export(bag, tmp_path / 'out', 'webdataset')
    assert any('no odometry' in note for note in notes)
    (key, files), _ = read_shards(tmp_path / 'out')
    assert key == 'blind-000000' and sorted(files) == ['json', 'left.png']
    assert 'T_odom_left' not in json.loads(files['json'])


def test_bad_input_is_refused(bag: Path, tmp_path: Path,
                              capsys: pytest.CaptureFixture[str]) -> None:
    command = ['bag', 'export', str(bag), '-o', str(tmp_path / 'x'), '--shard-size', '0']
    assert main([*command, '--format', 'webdataset']) == 1
    assert '--shard-size: 0 is not valid; valid is 1 to' in unfolded(capsys.readouterr().err)
    assert main([*command, '--format', 'tum']) == 1
    assert '--shard-size: is for --format webdataset' in unfolded(capsys.readouterr().err)
    assert not list(tmp_path.iterdir())
    with ShardWriter(tmp_path) as writer:
        for key in ('a.b', '', 'a/b'):
            with pytest.raises(SequenceError, match='key of a sample'):
                writer.write(key, {'json': b''})
    assert key_part('a.b c/d') == 'a_b_c_d'
