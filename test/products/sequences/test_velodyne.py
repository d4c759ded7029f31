"""LiDAR scans in KITTI sequences, read as the devkit's readme says: plain arrays, P and Tr."""

from pathlib import Path

import numpy as np
import pytest
import sensor_items
import synthetic_bag as synthetic

from lunar_rover_sim.bag.messages import header_ns
from lunar_rover_sim.bag.writer import BagWriter
from lunar_rover_sim.base import topics
from lunar_rover_sim.base.errors import BagError, SequenceError
from lunar_rover_sim.base.frames import inverse
from lunar_rover_sim.products.sequences.export import export

NEEDED = (topics.LEFT_IMAGE, topics.LEFT_INFO, topics.RIGHT_IMAGE, topics.RIGHT_INFO, topics.ODOM,
          topics.TF_STATIC)
SCANS_NS = tuple(range(160_000_000, 1_000_000_000, 100_000_000))     # images are at 0.1, 0.2 s ...


@pytest.fixture(scope='module')
def drive() -> list[synthetic.Item]:
    return sensor_items.with_lidar_frame(synthetic.drive(1.0, only=NEEDED))


def clouds(topic: topics.Topic) -> list[synthetic.Item]:
    return [sensor_items.cloud_item(topic, ns, sensor_items.scan_points(
        ns, topic is topics.LIDAR_DESKEWED)) for ns in SCANS_NS]


def read(folder: Path) -> tuple[dict[str, np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
    """Return matrices by name, scans (n, 4), and the stamps of images and scans [s]."""
    matrices = {}
    for line in (folder / 'calib.txt').read_text().splitlines():
        name, _, row = line.partition(':')
        matrices[name] = np.array(row.split(), float).reshape(3, 4)
    scans = [np.fromfile(path, np.float32).reshape(-1, 4)
             for path in sorted((folder / 'velodyne').glob('*.bin'))]
    return (matrices, scans, np.loadtxt(folder / 'times.txt'),
            np.loadtxt(folder / 'velodyne_times.txt'))


def test_points_lie_on_the_ground_of_their_image(tmp_path: Path,
                                                 drive: list[synthetic.Item]) -> None:
    """P Tr x projects each point to where the image shows the ground, at the depth of the ground.

    The fourth value is a reflectance. Scans begin 40 or 60 ms before their image, in which the
    rover turns by up to 3 degrees.
    """
    bag = synthetic.write(tmp_path / 'bag', [*drive, *clouds(topics.LIDAR_DESKEWED)])
    notes = export(bag, tmp_path / 'seq', 'kitti')
    matrices, scans, times, began = read(tmp_path / 'seq')
    np.testing.assert_allclose(np.unique(scans[0][:, 3]), (20.0 + np.arange(8)) / 100.0, rtol=1e-6)
    assert len(scans) == len(times) == len(began) == 9      # the image at 0.1 s has no scan
    assert '1 image set left out at the beginning: no LiDAR scan before them' in notes
    assert any('velodyne: lidar/points_deskewed' in note for note in notes)
    np.testing.assert_allclose(times - began, 0.04, atol=1e-9)
    to_camera = np.vstack([matrices['Tr'], [0, 0, 0, 1]])
    for stamp_s, scan in zip(times, scans):
        homogeneous = np.column_stack([scan[:, :3], np.ones(len(scan))]).astype(float)
        for camera, side in (('P0', 1.0), ('P1', -1.0)):
            u, v, depth = matrices[camera] @ to_camera @ homogeneous.T
            seen = (depth > 0.2) & (depth < 5.0)
            assert seen.sum() > 100
            u, v, depth = u[seen] / depth[seen], v[seen] / depth[seen], depth[seen]
            T = synthetic.pose_at(stamp_s) @ synthetic.T_base_camera(side)
            pixel = np.linalg.inv(matrices['P0'][:, :3]) @ np.stack([u, v, np.ones_like(u)])
            ground = -T[2, 3] / (T[2, :3] @ pixel)
            # Points are float32, to 5e-7 m here; at grazing incidence ten times that in depth.
            np.testing.assert_allclose(depth, ground, rtol=2e-5)


def test_without_deskewed_clouds_points_are_as_they_were_seen(
        tmp_path: Path, drive: list[synthetic.Item]) -> None:
    """In the order of firing, moved by nothing; what does not return is left out."""
    points = sensor_items.scan_points(SCANS_NS[0], False)
    points['x'][5] = np.nan
    bag = synthetic.write(tmp_path / 'bag', [
        *drive, sensor_items.cloud_item(topics.LIDAR_POINTS, SCANS_NS[0], points)])
    notes = export(bag, tmp_path / 'seq', 'kitti')
    _, scans, times, began = read(tmp_path / 'seq')
    assert (began == 0.16).all() and len(times) == 9
    kept = points[np.isfinite(points['x'])]
    for scan in scans:
        for k, name in enumerate('xyz'):
            np.testing.assert_array_equal(scan[:, k], kept[name])
    assert any('velodyne: lidar/points,' in note for note in notes)


def test_the_other_cloud_is_named(tmp_path: Path, drive: list[synthetic.Item]) -> None:
    bag = synthetic.write(tmp_path / 'bag', [*drive, *clouds(topics.LIDAR_DESKEWED),
                                             *clouds(topics.LIDAR_POINTS)])
    notes = export(bag, tmp_path / 'seq', 'kitti')
    assert 'left out: lidar/points; velodyne holds lidar/points_deskewed' in notes


def test_late_clouds_of_other_recorders(tmp_path: Path, drive: list[synthetic.Item]) -> None:
    """They stand in the bag at the time of their arrival, after the image that they belong to."""
    late = clouds(topics.LIDAR_DESKEWED)
    ordered = synthetic.write(tmp_path / 'ordered', [*drive, *late])
    export(ordered, tmp_path / 'a', 'kitti')
    with BagWriter(tmp_path / 'late') as writer:
        for item in drive:
            writer.write(f'/{item.topic}', item.msgtype, synthetic.serialise(item),
                         item.fallback_ns)
        writer.add_topic('/lidar/points_deskewed', late[0].msgtype)
        for item in late:
            writer.write_at('/lidar/points_deskewed', header_ns(item.message) + 130_000_000,
                            synthetic.serialise(item))
    export(tmp_path / 'late', tmp_path / 'b', 'kitti')
    for path in (tmp_path / 'a' / 'velodyne').iterdir():
        assert path.read_bytes() == (tmp_path / 'b' / 'velodyne' / path.name).read_bytes()


def test_without_tf_the_scenario_says_where_the_lidar_is(tmp_path: Path,
                                                         drive: list[synthetic.Item]) -> None:
    """The rover of the scenario: its LiDAR 0.3 m above base_link, looking as base_link does."""
    text = ('rover:\n  ros__parameters:\n'
            '    lidar: {position_m: [0.1, 0.0, 0.3], rpy_deg: [0.0, 0.0, 0.0]}\n')
    scenario = synthetic.text(topics.SCENARIO, text)
    kept = [item for item in drive if item.topic != topics.TF_STATIC.name]
    bag = synthetic.write(tmp_path / 'bag', [*kept, scenario, *clouds(topics.LIDAR_DESKEWED)])
    export(bag, tmp_path / 'seq', 'kitti')
    matrices, _, _, _ = read(tmp_path / 'seq')
    expected = inverse(synthetic.T_base_camera(1.0)) @ [0.1, 0.0, 0.3, 1.0]
    np.testing.assert_allclose(matrices['Tr'][:, 3], expected[:3], atol=1e-9)


def test_bad_clouds_are_refused(tmp_path: Path, drive: list[synthetic.Item]) -> None:
    broken = clouds(topics.LIDAR_POINTS)[0]
    broken.message.point_step = 4
    bag = synthetic.write(tmp_path / 'bag', [*drive, broken])
    with pytest.raises(BagError, match='lidar/points: fields end at 22 of 4 bytes'):
        export(bag, tmp_path / 'seq', 'kitti')
    ends = [sensor_items.cloud_item(topics.LIDAR_POINTS, 2 * 10**9,
                                    sensor_items.scan_points(SCANS_NS[0], False))]
    bag = synthetic.write(tmp_path / 'after', [*drive, *ends])
    with pytest.raises(SequenceError, match='after the first LiDAR scan; there is nothing'):
        export(bag, tmp_path / 'seq', 'kitti')
    unmounted = [item for item in drive if item.topic != topics.TF_STATIC.name]
    bag = synthetic.write(tmp_path / 'unmounted', [*unmounted, *clouds(topics.LIDAR_POINTS)])
    with pytest.raises(BagError, match='where .* is on the rover is not known'):
        export(bag, tmp_path / 'seq', 'kitti')
    assert not (tmp_path / 'seq').exists()
