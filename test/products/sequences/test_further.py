"""Hazard cameras in exports: a fisheye with truth at half the rate, and a pair without."""

import io
import json
from pathlib import Path

import cv2
import numpy as np
from products.sequences.shard_reader import read_shards
import pytest
import synthetic_bag
import yaml

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import inverse
from lunar_rover_sim.base.seconds import EPOCH_NS
from lunar_rover_sim.image.camera.fisheye import geometry_of
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig, HazardConfig, HazardRig
from lunar_rover_sim.image.rendering.labels import LABEL_FIRST_ROCK
from lunar_rover_sim.products.sequences.export import export

FRONT = HazardConfig(camera=HazardCameraConfig(width=48, height=32))
REAR = HazardConfig(stereo_baseline_m=0.06, orientation_rpy_deg=(0.0, 20.0, 180.0),
                    camera=HazardCameraConfig(model='pinhole', width=40, height=30,
                                              horizontal_fov_deg=90.0))
STAMPS_NS = (2 * 10**8, 4 * 10**8)
TRUE_CAMERA = {'front': FRONT, 'rear/left': REAR, 'rear/right': REAR}


def info(name: str, ns: int) -> synthetic_bag.Item:
    camera, topic = geometry_of(TRUE_CAMERA[name]), topics.hazard(name)[1]
    roi = synthetic_bag.msg('sensor_msgs/RegionOfInterest', x_offset=0, y_offset=0, height=0,
                            width=0, do_rectify=False)
    return synthetic_bag.item(topic, synthetic_bag.msg(
        'sensor_msgs/CameraInfo', header=synthetic_bag.header(ns, topic.frame_id),
        height=camera.height, width=camera.width, distortion_model=camera.distortion_model,
        d=np.asarray(camera.D, float), k=camera.K.ravel(), r=np.eye(3).ravel(),
        p=camera.P_left.ravel(), binning_x=0, binning_y=0, roi=roi))


def picture(name: str, k: int) -> np.ndarray:
    camera = geometry_of(TRUE_CAMERA[name])
    return np.random.default_rng([k, len(name)]).integers(
        0, 255, (camera.height, camera.width)).astype(np.uint8)


def label(k: int) -> np.ndarray:
    image = np.ones((32, 48), np.uint16)
    image[10:16, 20 + k:30 + k] = LABEL_FIRST_ROCK + k
    return image


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    items = synthetic_bag.drive(0.4)
    for item in items:
        if item.topic == topics.SCENARIO.name:
            item.message.data += 'render_node:\n  ros__parameters: ' + json.dumps({
                'hazard': {'front': FRONT.to_mapping(), 'rear': REAR.to_mapping()}}) + '\n'
    for k, ns in enumerate(STAMPS_NS):
        for name in TRUE_CAMERA:
            image, _, labels, craters, depth = topics.hazard(name)
            items.append(info(name, ns))
            found = [(image, 'mono8', picture(name, k))]
            if name == 'front':
                found += [(labels, 'mono16', label(k)), (craters, 'mono16', 0 * label(k)),
                          (depth, '32FC1', label(k).astype(np.float32))]
            items += [synthetic_bag.picture(topic, ns, *drawn) for topic, *drawn in found]
        items.append(synthetic_bag.picture(topics.LABELS, ns, 'mono16',
                                           np.ones((120, 160), np.uint16)))
    return synthetic_bag.write(tmp_path_factory.mktemp('hazard') / 'bag', items)


def test_euroc_has_them_as_further_cameras(bag: Path, tmp_path: Path) -> None:
    """Kalibr reads such a sensor.yaml; images have the stamps of their own."""
    notes = export(bag, tmp_path / 'seq', 'euroc')
    assert 'hazard cameras: cam2 is front, cam3 is rear/left, cam4 is rear/right' in notes
    calibration = yaml.safe_load((tmp_path / 'seq/calibration.yaml').read_text())
    for k, (name, config) in enumerate(TRUE_CAMERA.items(), 2):
        folder = tmp_path / f'seq/mav0/cam{k}'
        told = yaml.safe_load((folder / 'sensor.yaml').read_text())
        camera, rig = geometry_of(config), HazardRig(config)
        T_base_imu = np.array(calibration['T_base_imu'])
        T = rig.T_base_right if name.endswith('right') else rig.T_base_left
        np.testing.assert_allclose(np.array(told['T_BS']['data']).reshape(4, 4),
                                   inverse(T_base_imu) @ T, atol=1e-12)
        np.testing.assert_allclose(told['intrinsics'], camera.K[[0, 1, 0, 1], [0, 1, 2, 2]])
        assert told['distortion_model'] == (
            'equidistant' if name == 'front' else 'radial-tangential')
        assert told['resolution'] == [camera.width, camera.height]
        own = calibration['hazard_' + name.replace('/', '_')]
        assert own['distortion_model'] == camera.distortion_model
        for number, ns in enumerate(STAMPS_NS):
            image = cv2.imread(str(folder / f'data/{EPOCH_NS + ns}.png'), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(image, picture(name, number))


@pytest.mark.parametrize('kind', ['coco', 'yolo'])
def test_labelled_ones_are_further_images(bag: Path, tmp_path: Path, kind: str) -> None:
    """The pair has no labels: it is named."""
    notes = export(bag, tmp_path / 'out', kind)
    assert any('left out: hazard cameras rear/left, rear/right; they need' in n for n in notes)
    if kind == 'yolo':
        lines = [line.split() for line in (tmp_path / 'out/times.txt').read_text().splitlines()]
        names = {(camera, int(ns)): number for number, ns, camera in lines}
        for k, ns in enumerate(STAMPS_NS):
            box = np.loadtxt(tmp_path / f'out/boxes/{names["hazard_front", ns]}.txt')
            assert box == pytest.approx([0, (25 + k) / 48, 13 / 32, 10 / 48, 6 / 32], abs=2e-6)
        return
    data = json.loads((tmp_path / 'out/annotations/instances.json').read_text())
    shown = {image['id']: image for image in data['images'] if image['camera'] != 'left'}
    assert [image['stamp_ns'] for image in shown.values()] == list(STAMPS_NS)
    assert {(i['camera'], i['width'], i['height']) for i in shown.values()} == {
        ('hazard_front', 48, 32)}
    boxes = [a['bbox'] for a in data['annotations'] if a['image_id'] in shown]
    assert boxes == [[20, 10, 10, 6], [21, 10, 10, 6]]


def test_samples_have_them_at_their_stamps(bag: Path, tmp_path: Path) -> None:
    """A sample of another stamp lacks their files; all have their poses."""
    export(bag, tmp_path / 'out', 'webdataset')
    found = []
    for _, files in read_shards(tmp_path / 'out'):
        told = json.loads(files['json'])
        T = np.array(told['T_odom_hazard_front']) @ inverse(HazardRig(FRONT).T_base_left)
        np.testing.assert_allclose(T, synthetic_bag.pose_at(told['stamp_ns'] / 1e9), atol=1e-8)
        if 'hazard_front.png' in files:
            k = STAMPS_NS.index(told['stamp_ns'])
            found.append(k)
            labels = np.load(io.BytesIO(files['hazard_front_labels.npy']))
            assert np.array_equal(labels, label(k)) and labels.dtype == np.uint16
            assert np.load(io.BytesIO(files['hazard_front_depth.npy'])).dtype == np.float32
            right = cv2.imdecode(np.frombuffer(files['hazard_rear_right.png'], np.uint8),
                                 cv2.IMREAD_UNCHANGED)
            assert np.array_equal(right, picture('rear/right', k))
    assert found == [0, 1]
    calibration = yaml.safe_load((tmp_path / 'out/calibration.yaml').read_text())
    assert calibration['hazard_front_depth.npy']['along'] == 'ray'


def test_formats_without_a_place_say_so(bag: Path, tmp_path: Path) -> None:
    notes = export(bag, tmp_path / 'out', 'kitti')
    assert ('left out: hazard cameras front, rear/left, rear/right; this format has no place for '
            'them') in notes
