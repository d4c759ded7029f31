"""`bag preview`, its figure of sensors, and the other commands on bags."""

from pathlib import Path
import shutil

from command_line import unfolded
import cv2
from judge.slam import relief_walk
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
import numpy as np
import pytest
import sensor_items
import synthetic_bag as synthetic
import worlds

from lunar_rover_sim.bag import marker, series
from lunar_rover_sim.bag.reader import open_bag
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, WorldError
from lunar_rover_sim.base.frames import se3
from lunar_rover_sim.base.seconds import NS_PER_S
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world.world_folder import load_world, save_world
from lunar_rover_sim.image.lidar.scan import POINT
from lunar_rover_sim.products.inspection.bag_pictures import draw_hillshade, preview, sensor_figure
from lunar_rover_sim.products.inspection.map_pictures import overview_figure

STEREO = [f'stereo_{k}.png' for k in range(4)]


@pytest.fixture(scope='module')
def world(tmp_path_factory):
    return save_world(worlds.small(), tmp_path_factory.mktemp('world') / 'small')


@pytest.fixture(scope='module')
def items(world):
    items = synthetic.drive(0.6)
    next(i for i in items if i.topic == 'world_hash').message.data = load_world(world).hash
    return items


@pytest.fixture(scope='module')
def bag(items, tmp_path_factory):
    return synthetic.write(tmp_path_factory.mktemp('bag') / 'bag', items)


@pytest.fixture(scope='module')
def driven(items, tmp_path_factory):
    """Return the bag without images."""
    return synthetic.write(tmp_path_factory.mktemp('driven') / 'bag',
                           [i for i in items if 'image' not in i.topic])


def test_pictures_are_written_and_named(tmp_path, bag, driven, world, monkeypatch):
    monkeypatch.setenv('LUNAR_ROVER_SIM_CACHE', str(tmp_path / 'cache'))
    paths = preview(bag, tmp_path / 'out', world)
    names = [*STEREO, 'trajectory.png', 'attitude.png', 'imu.png']
    assert [p.name for p in paths] == names
    for path in paths:
        assert cv2.imread(str(path)).std() > 5.0
    bare = preview(driven, tmp_path / 'bare')
    assert not (cv2.imread(str(bare[0])) == cv2.imread(str(paths[4]))).all()
    shutil.copytree(world, tmp_path / 'cache' / 'worlds' / 'any_name')
    cached = preview(driven, tmp_path / 'cached')
    assert (cv2.imread(str(cached[0])) == cv2.imread(str(paths[4]))).all()


def test_what_is_missing_is_left_out(tmp_path, items, driven):
    assert [p.name for p in preview(driven, tmp_path / 'out')] == [
        'trajectory.png', 'attitude.png', 'imu.png']
    empty = synthetic.write(tmp_path / 'empty', [i for i in items if i.topic == 'sun'])
    with pytest.raises(BagError, match='nothing to preview'):
        preview(empty, tmp_path / 'none')
    assert not (tmp_path / 'none').exists()


def told(frame, ns, place, sigmas):
    """Return what slam_node says: a place, with standard deviations along x and y."""
    covariance = np.diag(np.square([*sigmas, 1.0, 0.1, 0.1, 0.1]))
    pose = synthetic.odometry(ns, frame, se3(np.eye(3), place)).pose.pose
    return synthetic.item(topics.SLAM_COVARIANCE, synthetic.msg(
        'geometry_msgs/PoseWithCovarianceStamped', header=synthetic.header(ns, frame),
        pose=synthetic.msg('geometry_msgs/PoseWithCovariance', pose=pose,
                           covariance=covariance.ravel())))


@pytest.mark.parametrize(('frame', 'sizes'), [
    ('odom', [(150.0, 90.0, 90.0), (6.0, 3.0, 0.0)]), ('slam_map', [])])
def test_the_overview_has_ellipses_of_an_estimate_in_the_site(tmp_path, items, frame, sizes):
    """Of three deviations; an estimate in a map of its own has no place on the site."""
    bag = synthetic.write(tmp_path / 'bag', [
        *(i for i in items if 'image' not in i.topic),
        told(frame, 100_000_000, (10.0, -5.0, 0.0), (15.0, 25.0)),
        told(frame, 200_000_000, (2.0, 0.5, 0.0), (1.0, 0.5))])
    found = []
    with open_bag(bag) as opened:
        overview_figure(opened, series.read_odometry(opened), relief_walk.orbital(0),
                        lambda figure, name: found.append((figure, name)))
    (figure, name), = found
    assert name == 'overview.png'
    drawn = [p for p in figure.axes[0].patches if isinstance(p, Ellipse) and p.angle is not None
             and not isinstance(p, Circle)]
    for ellipse, (width, height, angle) in zip(drawn, sizes, strict=True):
        np.testing.assert_allclose((ellipse.width, ellipse.height), (width, height))
        assert abs(np.sin(np.radians(ellipse.angle - angle))) < 1e-6


def test_rocks_below_a_pixel_are_not_drawn(bag, world):
    axes = {half_m: Figure().subplots() for half_m in (2.0, 300.0)}
    with open_bag(bag) as recording:
        for half_m, where in axes.items():
            draw_hillshade(where, recording, np.zeros(2), half_m, world)
    near, far = ([patch.radius for patch in where.patches if isinstance(patch, Circle)]
                 for where in axes.values())
    assert near and min(near) > 0.5 * 4.0 / 600
    assert len(far) < len(load_world(world).rocks) and all(r >= 0.5 * 600.0 / 600 for r in far)


def test_another_world_is_refused(tmp_path, items, world):
    other = [i for i in items if i.topic != 'world_hash' and 'stereo' not in i.topic]
    other.append(synthetic.Item('world_hash', 'std_msgs/msg/String',
                                synthetic.msg('std_msgs/String', data='0' * 32)))
    path = synthetic.write(tmp_path / 'bag', other)
    with pytest.raises(WorldError, match='is not that of the world of .*bag, 000000000000'):
        preview(path, tmp_path / 'out', world)


def test_the_commands(tmp_path, bag, capsys):
    assert main(['bag', 'info', str(bag)]) == 0
    assert '/stereo/disparity' in capsys.readouterr().out
    assert main(['bag', 'hash', '--topics', str(bag)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines[-1]) == 64 and any(line.endswith('  /odom') for line in lines)
    assert main(['bag', 'check', str(bag)]) == 0
    assert 'passed' in capsys.readouterr().out
    marker.mark(bag, 'the power went')
    try:
        assert main(['bag', 'check', str(bag)]) == 1
        assert 'the power went' in capsys.readouterr().out
        assert main(['bag', 'recover', str(bag)]) == 0
        assert 'INCOMPLETE: the power went' in (main(['bag', 'info', str(bag)]),
                                                capsys.readouterr().out)[1]
    finally:
        marker.unmark(bag)
    assert main(['bag', 'recover', str(bag)]) == 1
    assert 'nothing to recover' in unfolded(capsys.readouterr().err)
    assert main(['bag', 'info', str(tmp_path / 'missing')]) == 1
    assert unfolded(capsys.readouterr().err).count('\n') == 1
    assert main(['bag', 'export', str(bag), '-o', str(tmp_path / 'seq'), '--format', 'tum']) == 0
    assert '6 image sets' in capsys.readouterr().out


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
def of_sensors() -> list[synthetic.Item]:
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


def test_each_has_its_picture(tmp_path: Path, of_sensors: list[synthetic.Item]) -> None:
    bag = synthetic.write(tmp_path / 'bag', of_sensors)
    paths = preview(bag, tmp_path / 'out')
    assert [path.name for path in paths] == BESIDES
    for path in paths:
        picture = cv2.imread(str(path))
        assert picture is not None and picture.std() > 5.0, path.name


def test_a_hazard_camera_without_truth_of_its_image(tmp_path: Path,
                                                    of_sensors: list[synthetic.Item]) -> None:
    """Its image has a picture of its own, which it fills."""
    shown = next(item for item in of_sensors if item.topic == 'hazard/front/image_raw')
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


MS = 1_000_000


@pytest.fixture(scope='module')
def heading() -> list[synthetic.Item]:
    """Return half a second of truth, and sensors that measure just that."""
    found = synthetic.drive(0.5, only=(topics.ODOM, topics.SUN))
    for ns in range(100 * MS, 501 * MS, 100 * MS):
        found += sensor_items.heading_items(ns) + sensor_items.power_items(ns)
    return found


def test_each_topic_of_a_sensor_has_a_panel_of_its_numbers(
        tmp_path: Path, heading: list[synthetic.Item]) -> None:
    """At the stamps of its messages, with their values."""
    figures: list[Figure] = []
    with open_bag(synthetic.write(tmp_path / 'bag', heading)) as bag:
        sensor_figure(bag, lambda figure, name: figures.append(figure))
    panels = {axes.get_title(): axes for axes in figures[0].axes if axes.get_title()}
    assert set(panels) == {item.topic for item in heading} - {topics.ODOM.name, topics.SUN.name}
    sun = [item.message for item in heading if item.topic == topics.SUN_SENSOR.name]
    lines = panels[topics.SUN_SENSOR.name].get_lines()
    assert np.allclose(lines[0].get_xdata(), [0.1, 0.2, 0.3, 0.4, 0.5])
    assert np.allclose([line.get_ydata() for line in lines[:3]], np.transpose(
        [[m.vector.x, m.vector.y, m.vector.z] for m in sun]))
