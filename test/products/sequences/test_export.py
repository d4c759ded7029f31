"""Export to EuRoC, TUM and KITTI, what holds of every format, and ORB-SLAM3 settings."""

import re

import cv2
import numpy as np
import pytest
import synthetic_bag as synthetic
import yaml

from lunar_rover_sim.bag import message_validity, messages
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import ConfigError, SequenceError
from lunar_rover_sim.base.frames import inverse
from lunar_rover_sim.base.seconds import EPOCH_NS, from_seconds
from lunar_rover_sim.cli.main import execute
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.judge.evaluation import trajectory_files
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.evaluation.trajectory_files import load
from lunar_rover_sim.products.sequences.export import export, FORMATS
from lunar_rover_sim.products.sequences.orbslam3_settings import SENSORS, settings
from lunar_rover_sim.products.sequences.sensors import described_sensors, recorded_sensors
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.sensors.imu import ImuConfig


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    return synthetic.drive(1.0)


@pytest.fixture(scope='module')
def bag(items, tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('export') / 'bag', items)


def images_of(items: list[synthetic.Item], topic: topics.Topic) -> dict[int, np.ndarray]:
    return {messages.header_ns(i.message): message_validity.pixels(i.message) for i in items
            if i.topic == topic.name}


def test_euroc(tmp_path, items, bag):
    notes = export(bag, tmp_path / 'seq', 'euroc')
    mav0 = tmp_path / 'seq' / 'mav0'
    words = (tmp_path / 'seq' / 'times.txt').read_text().split()
    times = [int(word) - EPOCH_NS for word in words]
    for camera, topic in (('cam0', topics.LEFT_IMAGE), ('cam1', topics.RIGHT_IMAGE)):
        assert sorted(p.stem for p in (mav0 / camera / 'data').iterdir()) == words
        rows = (mav0 / camera / 'data.csv').read_text().splitlines()[1:]
        assert rows == [f'{word},{word}.png' for word in words]
        for ns, pixels in images_of(items, topic).items():
            if ns in times:
                word = words[times.index(ns)]
                written = cv2.imread(str(mav0 / camera / 'data' / f'{word}.png'), -1)
                assert np.array_equal(written, pixels)
    imu = np.loadtxt(mav0 / 'imu0' / 'data.csv', delimiter=',')
    assert imu.shape == (200, 7)
    # The last sample and the last image have one stamp; a loop that reads on needs another one.
    assert times[-1] == 1_000_000_000 == imu[-1, 0] - EPOCH_NS and len(times) == 10
    enclosed = (tmp_path / 'seq' / 'times_imu.txt').read_text().split()
    assert enclosed == words[:9] and any('9 of 10 image sets' in note for note in notes)
    assert np.mean(imu[:, 6]) == pytest.approx(synthetic.GRAVITY, rel=0.1)
    truth = trajectory_files.read_euroc(mav0 / 'state_groundtruth_estimate0' / 'data.csv')
    odom = load(bag)
    assert np.array_equal(truth.stamps_ns - EPOCH_NS, odom.stamps_ns)
    assert np.allclose(truth.positions_m, odom.positions_m, rtol=0, atol=1e-15)  # IMU at base
    table = np.loadtxt(mav0 / 'state_groundtruth_estimate0' / 'data.csv', delimiter=',')
    speed = np.gradient(table[:, 1:4], odom.stamps_ns * 1e-9, axis=0)
    assert np.abs(speed - table[:, 8:11])[1:-1].max() < 1e-3
    assert np.allclose(table[:, 11], 1e-3) and np.allclose(table[:, 14], 0.01)


def test_euroc_mounts_project_a_point_into_both_images(tmp_path, bag):
    """The camera poses in sensor.yaml give the disparity f b / Z."""
    export(bag, tmp_path / 'seq')
    T = {}
    for camera in ('cam0', 'cam1'):
        sensor = yaml.safe_load((tmp_path / 'seq' / 'mav0' / camera / 'sensor.yaml').read_text())
        T[camera] = np.array(sensor['T_BS']['data']).reshape(4, 4)
        fx, fy, cx, cy = sensor['intrinsics']
    point = np.array([2.0, 0.1, -0.2, 1.0])
    left, right = (inverse(T[camera]) @ point for camera in ('cam0', 'cam1'))
    u = [fx * p[0] / p[2] + cx for p in (left, right)]
    assert left[2] > 0 and u[0] - u[1] == pytest.approx(fx * 0.1 / left[2], rel=1e-12)


def test_tum(tmp_path, items, bag):
    export(bag, tmp_path / 'seq', 'tum')
    folder = tmp_path / 'seq'
    lines = (folder / 'associations.txt').read_text().splitlines()
    assert len(lines) == 10 and lines[0].split()[::2] == ['1704067200.100000000'] * 2
    depths = images_of(items, topics.TRUE_DEPTH)
    for line in lines:
        stamp, rgb, _, depth = line.split()
        written = cv2.imread(str(folder / depth), -1)
        true = depths[from_seconds(stamp) - EPOCH_NS]
        assert written.dtype == np.uint16
        seen = true < 13.0
        assert np.abs(written[seen] / 5000.0 - true[seen]).max() <= 0.5 / 5000 + 1e-6
        assert (written[~np.isfinite(true)] == 0).all()
        assert (folder / rgb).is_file()
    truth = trajectory_files.read_tum(folder / 'groundtruth.txt')
    camera = load(bag).of_frame(synthetic.T_base_camera(+1.0))
    assert np.allclose(truth.positions_m, camera.positions_m, rtol=0, atol=1e-12)
    dots = np.sum(truth.orientations_wxyz * camera.orientations_wxyz, axis=1)
    assert np.allclose(np.abs(dots), 1.0)


@pytest.fixture(scope='module')
def long_bag(tmp_path_factory):
    """Frames before and after 0.1, 1, 10 and 100 s."""
    scene, rng = synthetic.Scene(), np.random.default_rng(0)
    items = synthetic.latched_items()
    for ns in (50_000_000, 100_000_000, 900_000_000, 1_000_000_000, 9_950_000_000,
               10_000_000_000, 99_900_000_000, 100_000_000_000, 100_050_000_000):
        items += synthetic.state_items(ns, 5_000_000, rng) + synthetic.frame_items(ns, scene)
    items += synthetic.state_items(100_055_000_000, 5_000_000, rng)
    return synthetic.write(tmp_path_factory.mktemp('long') / 'bag', items)


@pytest.mark.parametrize('epoch_ns', [EPOCH_NS, 0])
def test_names_in_the_order_of_text_are_in_the_order_of_time(tmp_path, long_bag, epoch_ns):
    """A tool that sorts file names as text reads the drive from its start to its end."""
    with open_bag(long_bag) as bag:
        stamps = [frame.stamp_ns for frame in bag.frames()]
    for kind in ('euroc', 'tum', 'kitti', 'tartanair'):
        export(long_bag, tmp_path / kind, kind, epoch_ns=epoch_ns)
    cam0 = sorted(p.stem for p in (tmp_path / 'euroc/mav0/cam0/data').iterdir())
    assert [int(stem) - epoch_ns for stem in cam0] == stamps
    assert {len(stem) for stem in cam0} == {19}
    for name in ('rgb', 'depth'):
        stems = sorted(p.stem for p in (tmp_path / 'tum' / name).iterdir())
        assert [from_seconds(stem) - epoch_ns for stem in stems] == stamps
    for kind, folder in (('kitti', 'image_0'), ('tartanair', 'image_left')):
        names = sorted(p.name for p in (tmp_path / kind / folder).iterdir())
        times = (tmp_path / kind / 'times.txt').read_text().split()
        assert [int(name[:6]) for name in names] == list(range(len(stamps)))
        assert [from_seconds(time) for time in times] == stamps
    for name in ('euroc/mav0/imu0/data.csv', 'euroc/mav0/state_groundtruth_estimate0/data.csv',
                 'euroc/times.txt', 'tum/groundtruth.txt', 'tum/associations.txt'):
        lines = [line for line in (tmp_path / name).read_text().splitlines() if line[0] != '#']
        assert lines == sorted(lines) and len(lines) >= len(stamps)


def test_evaluation_of_an_estimate_in_the_time_of_a_sequence(tmp_path, bag):
    """Bags and sequences count time from different dates; what is exported fits both."""
    for kind, file, frame in (('euroc', 'mav0/state_groundtruth_estimate0/data.csv', 'imu'),
                              ('tum', 'groundtruth.txt', 'left')):
        export(bag, tmp_path / kind, kind)
        result = evaluate(bag, tmp_path / kind / file, align='none', estimate_frame=frame)
        assert result.ate_m.max < 1e-9 and result.unmatched == 0
        assert frame in (tmp_path / kind / 'README.txt').read_text().lower()


def test_epoch_of_the_command_line(tmp_path, bag):
    args = ['bag', 'export', str(bag), '-o', str(tmp_path / 'seq'), '--epoch',
            '2027-03-01T12:00:00']
    assert execute(args) == 0
    assert '2027-03-01T12:00:00 UTC' in (tmp_path / 'seq' / 'README.txt').read_text()
    first = (tmp_path / 'seq' / 'times.txt').read_text().split()[0]
    assert first == str(1_803_902_400 * 10**9 + 100_000_000)
    args = ['bag', 'export', str(bag), '-o', str(tmp_path / 'k'), '--format', 'kitti',
            '--epoch', '2027-03-01']
    with pytest.raises(ConfigError, match='--epoch: is for --format euroc or tum, not for kitti'):
        execute(args)
    with pytest.raises(SequenceError, match='epoch_ns: -1 is not valid'):
        export(bag, tmp_path / 'early', epoch_ns=-1)


def test_depth_with_every_second_image(tmp_path):
    """RGB-D takes what has depth and says what it leaves out; stereo takes every image."""
    bag = synthetic.write(tmp_path / 'bag', synthetic.drive(1.0, depth_every=2))
    notes = export(bag, tmp_path / 'tum', 'tum')
    times = [line.split()[0] for line in
             (tmp_path / 'tum' / 'associations.txt').read_text().splitlines()]
    assert [from_seconds(t) - EPOCH_NS for t in times] == [k * 200_000_000 for k in range(1, 6)]
    assert any('5 image sets without ground_truth/depth/image left out (render_node.depth_every=1'
               in note for note in notes)
    assert 'frame_rate_hz: 5.0' in (tmp_path / 'tum' / 'calibration.yaml').read_text()
    euroc = export(bag, tmp_path / 'euroc', 'euroc')
    assert len((tmp_path / 'euroc' / 'times.txt').read_text().split()) == 10
    assert not any('without' in note for note in euroc)
    assert 'frame_rate_hz: 10.0' in (tmp_path / 'euroc' / 'calibration.yaml').read_text()


@pytest.fixture(scope='module')
def labelled_bag(items, tmp_path_factory):
    """A bag from which every format can be written."""
    labels = np.zeros((synthetic.HEIGHT, synthetic.WIDTH), np.uint16)
    return synthetic.write(tmp_path_factory.mktemp('labelled') / 'bag', items + [
        synthetic.picture(topics.LABELS, k * 10**8, 'mono16', labels) for k in range(1, 11)])


@pytest.mark.parametrize('kind', FORMATS)
def test_every_format_has_its_calibration(kind, tmp_path, labelled_bag):
    """Intrinsics and mounts are beside every sequence, and noise where there is an IMU."""
    export(labelled_bag, tmp_path / kind, kind)
    document = yaml.safe_load((tmp_path / kind / 'calibration.yaml').read_text())
    assert document['left']['fx_fy_cx_cy_px'][0] == synthetic.FOCAL_PX
    assert np.shape(document['right']['T_imu_camera']) == (4, 4)
    assert document['imu']['rate_hz'] == 200.0


def test_kitti(tmp_path, bag):
    export(bag, tmp_path / 'seq', 'kitti')
    folder = tmp_path / 'seq'
    truth = trajectory_files.read_kitti(folder / 'poses.txt', folder / 'times.txt')
    camera = load(bag).of_frame(synthetic.T_base_camera(+1.0)).select(np.arange(19, 200, 20))
    first = camera.positions_m[0]
    expected = camera.rotations[0].inv().apply(camera.positions_m - first)
    assert np.array_equal(truth.stamps_ns, camera.stamps_ns)
    assert np.allclose(truth.positions_m, expected, rtol=0, atol=1e-12)
    assert sorted(p.name for p in (folder / 'image_1').iterdir())[-1] == '000009.png'
    calib = dict(line.split(': ') for line in (folder / 'calib.txt').read_text().splitlines())
    assert float(calib['P1'].split()[3]) == -synthetic.FOCAL_PX * 0.1


@pytest.mark.parametrize('encoding,kind', [('mono8', 'uint8'), ('rgb8', 'uint8'),
                                           ('bayer_rggb8', 'uint8'), ('bayer_rggb16', 'uint16')])
def test_kitti_has_colour_where_its_programs_look_for_it(tmp_path, encoding, kind):
    """The devkit has grey images in image_0 and image_1, those in colour in image_2 and 3."""
    rng, items = np.random.default_rng(3), synthetic.drive(0.3)
    shape = (synthetic.HEIGHT, synthetic.WIDTH, 3)[:3 if encoding == 'rgb8' else 2]
    pixels = rng.integers(0, np.iinfo(kind).max, shape, endpoint=True).astype(kind)
    for item in items:
        if item.topic in ('stereo/left/image_raw', 'stereo/right/image_raw'):
            item.message.encoding = encoding
            item.message.step = pixels.strides[0]
            item.message.data = np.frombuffer(pixels.tobytes(), np.uint8)
    export(synthetic.write(tmp_path / 'bag', items), tmp_path / 'seq', 'kitti')
    grey, colour = ([cv2.imread(str(tmp_path / f'seq/image_{camera}/000000.png'),
                                cv2.IMREAD_UNCHANGED) for camera in cameras]
                    for cameras in ((0, 1), (2, 3)))
    for image in grey:
        assert image.shape == shape[:2] and image.dtype == kind
    if encoding == 'mono8':
        assert not list((tmp_path / 'seq').glob('image_[23]'))
        return
    for image, of in zip(colour, grey):
        assert image.shape == (*shape[:2], 3) and image.dtype == kind
        np.testing.assert_array_equal(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), of)


def test_bad_export(tmp_path, items, bag):
    with pytest.raises(SequenceError, match='did you mean euroc'):
        export(bag, tmp_path / 'seq', 'eurok')
    (tmp_path / 'there').mkdir()
    with pytest.raises(SequenceError, match='exists already'):
        export(bag, tmp_path / 'there')
    with pytest.raises(SequenceError, match='cannot be written: Not a directory'):
        (tmp_path / 'file').touch()
        export(bag, tmp_path / 'file' / 'seq')
    poor = synthetic.write(tmp_path / 'poor', [i for i in items if 'image' not in i.topic])
    for kind in FORMATS:
        with pytest.raises(SequenceError, match='lacks stereo/left/image_raw'):
            export(poor, tmp_path / 'seq', kind)
    blind = synthetic.write(tmp_path / 'blind', [i for i in items if i.topic != 'odom'])
    assert any('ground truth is missing' in note for note in export(blind, tmp_path / 'seq'))
    ended = synthetic.write(tmp_path / 'short', [
        i for i in items
        if i.topic != 'imu/data_raw' or messages.header_ns(i.message) < 90_000_000])
    assert any('0 of 10 image sets' in note for note in export(ended, tmp_path / 'without_imu'))
    assert not [p for p in tmp_path.iterdir() if 'partial' in p.name]


@pytest.mark.parametrize('sensor', SENSORS)
def test_settings_are_what_opencv_reads(tmp_path, bag, sensor):
    with open_bag(bag) as recording:
        suite = recorded_sensors(recording)
    text = settings(suite, sensor)
    path = tmp_path / 'settings.yaml'
    path.write_text(text)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode('Camera1.fx').real() == synthetic.FOCAL_PX
    assert storage.getNode('Camera.width').isInt()
    for line in text.splitlines():
        match = re.fullmatch(r'([\w.]+): ([^!\s]+)', line)
        if match and match[1] != 'Camera.type' and match[1] != 'File.version':
            node = storage.getNode(match[1])
            whole = match[1] in ('Camera.width', 'Camera.height', 'Camera.fps', 'Camera.RGB',
                                 'ORBextractor.nFeatures', 'ORBextractor.nLevels',
                                 'ORBextractor.iniThFAST', 'ORBextractor.minThFAST')
            assert node.isInt() if whole else node.isReal(), line
    if sensor == 'stereo-inertial':
        T = storage.getNode('IMU.T_b_c1').mat()
        assert np.allclose(T, synthetic.T_base_camera(+1.0), atol=1e-6)
    # With an IMU, ORB-SLAM3 must know of the Moon.
    assert ('GRAVITY_VALUE' in text) == (sensor == 'stereo-inertial')
    gravity = storage.getNode('IMU.Gravity')
    assert gravity.real() == 1.62 if sensor == 'stereo-inertial' else gravity.empty()
    if sensor.startswith('stereo'):
        T = storage.getNode('Stereo.T_c1_c2').mat()
        expected = np.eye(4)
        expected[0, 3] = 0.1
        assert np.allclose(T, expected, atol=1e-6)


def test_settings_command_and_its_errors(tmp_path, bag):
    output = tmp_path / 'mono.yaml'
    args = ['slam', 'settings', str(bag), '-o', str(output), '--sensor', 'mono']
    assert execute(args) == 0
    assert 'Stereo' not in output.read_text()
    with pytest.raises(ConfigError, match='exists already'):
        execute(args)
    suite = described_sensors(RoverDescription(), CameraConfig(), ImuConfig(), 10.0, 0.0, 1.62)
    with pytest.raises(ConfigError, match='did you mean stereo'):
        settings(suite, 'stere')
    with pytest.raises(ConfigError, match='no signal'):
        settings(suite, 'stereo-inertial')
