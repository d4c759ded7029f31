"""`bag preview` shows the sensors besides the left camera."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import synthetic_bag as synthetic

from lunar_rover_sim import topics
from lunar_rover_sim.inspection.bag_pictures import preview
from lunar_rover_sim.lidar.scan import POINT
from lunar_rover_sim.seconds import NS_PER_S

NS = NS_PER_S // 10
BESIDES = ['truth_right.png', 'hazard_front.png', 'hazard_rear_left.png', 'chase.png', 'lidar.png']


def image(topic: str, encoding: str, pixels: np.ndarray) -> synthetic.Item:
    return synthetic.Item(topic, 'sensor_msgs/msg/Image',
                          synthetic.image(NS, 'frame', encoding, pixels))


def cloud() -> synthetic.Item:
    """Return a ring of 90 points, 3 m away."""
    points = np.zeros(90, POINT)
    angle = np.linspace(-np.pi, np.pi, 90)
    points['x'], points['y'] = 3.0 * np.cos(angle), 3.0 * np.sin(angle)
    points['z'], points['intensity'] = -0.3, 50.0 + 40.0 * np.cos(angle)
    return synthetic.cloud(topics.LIDAR_POINTS, NS, 'lidar_link', points)


@pytest.fixture(scope='module')
def items() -> list[synthetic.Item]:
    """Return images of each kind, with something in them."""
    rng = np.random.default_rng(3)
    gray = rng.integers(0, 256, (48, 64), dtype=np.uint8)
    numbers = np.repeat(np.arange(48, dtype=np.uint16), 64).reshape(48, 64)
    depth = np.linspace(0.5, 8.0, 48 * 64, dtype=np.float32).reshape(48, 64)
    normals = np.broadcast_to(np.array([0.0, -0.6, -0.8], np.float32), (48, 64, 3)).copy()
    found = [image(f'ground_truth/right/{name}', encoding, pixels) for name, encoding, pixels in (
        ('depth/image', '32FC1', depth), ('labels', 'mono16', numbers),
        ('craters', 'mono16', numbers), ('shadow', 'rgb8', np.repeat(gray[..., None], 3, axis=2)),
        ('normals', '32FC3', normals))]
    for camera in ('front', 'rear/left'):
        found.append(image(f'hazard/{camera}/image_raw', 'mono8', gray))
        found.append(image(f'ground_truth/hazard/{camera}/labels', 'mono16', numbers))
    return [*found, image('ground_truth/hazard/front/depth/image', '32FC1', depth),
            image('chase/image_raw', 'mono8', gray), cloud()]


def test_each_has_its_picture(tmp_path: Path, items: list[synthetic.Item]) -> None:
    bag = synthetic.write(tmp_path / 'bag', items)
    paths = preview(bag, tmp_path / 'out')
    assert [path.name for path in paths] == BESIDES
    for path in paths:
        picture = cv2.imread(str(path))
        assert picture is not None and picture.std() > 5.0, path.name


def test_a_hazard_camera_without_truth_of_its_image(tmp_path: Path,
                                                    items: list[synthetic.Item]) -> None:
    """Its image has a picture of its own, which it fills."""
    shown = next(item for item in items if item.topic == 'hazard/front/image_raw')
    numbers = np.zeros((48, 64), np.uint16)
    late = synthetic.Item('ground_truth/hazard/front/labels', 'sensor_msgs/msg/Image',
                          synthetic.image(2 * NS, 'frame', 'mono16', numbers))
    drawn = []
    for name, held in (('alone', [shown]), ('late', [shown, late])):
        path, = preview(synthetic.write(tmp_path / name, held), tmp_path / f'{name}_out')
        assert path.name == 'hazard_front.png'
        drawn.append(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    np.testing.assert_array_equal(*drawn)
    assert (drawn[0] < 255).mean() > 0.6     # in four panels it had a fifth


@pytest.mark.parametrize('part', ['ground_truth/right/labels', 'ground_truth/hazard/front/labels',
                                  'hazard/front/image_raw', 'chase/image_raw', 'lidar/points'])
def test_one_topic_is_enough(tmp_path: Path, items: list[synthetic.Item], part: str) -> None:
    bag = synthetic.write(tmp_path / 'bag', [item for item in items if item.topic == part])
    assert len(preview(bag, tmp_path / 'out')) == 1
