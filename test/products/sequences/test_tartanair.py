"""TartanAir export: layout, axes, depth, calibration; against the analytic bag."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag
import yaml

from lunar_rover_sim.base import topics
from lunar_rover_sim.base.frames import inverse, R_BODY_OPTICAL, se3
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.products.sequences.sequence import depth_counts
from lunar_rover_sim.products.sequences.tartanair import ned_pose, seen_mask
from lunar_rover_sim.rover.description import RoverDescription


@pytest.fixture(scope='module')
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an exported second of the analytic drive."""
    folder = tmp_path_factory.mktemp('tartanair')
    bag = synthetic_bag.write(folder / 'bag', synthetic_bag.drive())
    notes = export(bag, folder / 'P000', 'tartanair')
    assert '10 image sets' in notes[0]
    return folder / 'P000'


def test_layout(sequence: Path) -> None:
    """Names are those of the data set; one pose a line and an image."""
    for name, suffix in (('image_left', '_left.png'), ('image_right', '_right.png'),
                         ('depth_left', '_left_depth.npy'),
                         ('depth_left_mm', '_left_depth.png')):
        assert sorted(p.name for p in (sequence / name).iterdir()) == [
            f'{k:06d}{suffix}' for k in range(10)]
    for side in ('left', 'right'):
        assert np.loadtxt(sequence / f'pose_{side}.txt').shape == (10, 7)
    assert np.loadtxt(sequence / 'times.txt') == pytest.approx(np.arange(1, 11) / 10)


def test_axes() -> None:
    """A level camera that looks north has the identity; east of it yaw is positive."""
    for heading, yaw_deg in (('north', 0.0), ('east', 90.0), ('south', 180.0)):
        # Our x is east, y north; body x forward. Yaw is counted from east to north.
        R_odom_body = Rotation.from_euler('z', {'north': 90, 'east': 0, 'south': -90}[heading],
                                          degrees=True).as_matrix()
        position, (w, x, y, z) = ned_pose(se3(R_odom_body @ R_BODY_OPTICAL, [3.0, 4.0, 0.5]))
        assert position == pytest.approx([4.0, 3.0, -0.5])
        turn = Rotation.from_quat([x, y, z, w]).inv() * Rotation.from_euler('z', yaw_deg,
                                                                            degrees=True)
        assert turn.magnitude() == pytest.approx(0.0, abs=1e-9)
    # Nose down is a negative pitch about the axis that points right.
    down = Rotation.from_euler('ZY', [90, 30], degrees=True).as_matrix()
    _, (w, x, y, z) = ned_pose(se3(down @ R_BODY_OPTICAL, np.zeros(3)))
    forward = Rotation.from_quat([x, y, z, w]).apply([1.0, 0.0, 0.0])
    assert forward == pytest.approx([np.cos(np.pi / 6), 0.0, 0.5])


def test_poses(sequence: Path) -> None:
    """Both cameras are where the analytic drive had them, a baseline apart."""
    left, right = (np.loadtxt(sequence / f'pose_{side}.txt') for side in ('left', 'right'))
    for k, row in enumerate(left):
        T = synthetic_bag.pose_at((k + 1) / 10) @ synthetic_bag.T_base_camera(+1.0)
        x, y, z = T[:3, 3]
        assert row[:3] == pytest.approx([y, x, -z], abs=1e-9)
    assert np.linalg.norm(left[:, :3] - right[:, :3], axis=1) == pytest.approx(
        synthetic_bag.MOUNT.baseline_m)
    # The right camera lies along the second axis of the left one.
    side = Rotation.from_quat(left[:, 3:]).inv().apply(right[:, :3] - left[:, :3])
    assert side == pytest.approx(np.tile([0.0, synthetic_bag.MOUNT.baseline_m, 0.0], (10, 1)))


def test_depth_projects_onto_the_ground(sequence: Path) -> None:
    """Depth, calibration and NED pose together put every ground pixel onto the plane z = 0."""
    document = yaml.safe_load((sequence / 'calibration.yaml').read_text())
    fx, fy, cx, cy = document['left']['fx_fy_cx_cy_px']
    depth = np.load(sequence / 'depth_left' / '000004_left_depth.npy', allow_pickle=False)
    assert depth.dtype == np.float32
    pose = np.loadtxt(sequence / 'pose_left.txt')[4]
    v, u = np.nonzero(depth < 100.0)
    d = depth[v, u].astype(float)
    in_camera = np.stack([d, d * (u - cx) / fx, d * (v - cy) / fy], axis=1)
    world = Rotation.from_quat(pose[3:]).apply(in_camera) + pose[:3]
    assert np.abs(world[:, 2]).max() < 1e-3
    assert depth.max() == 10_000.0
    png = cv2.imread(str(sequence / 'depth_left_mm' / '000004_left_depth.png'),
                     cv2.IMREAD_UNCHANGED)
    assert png.dtype == np.uint16
    near = depth < 65.0
    assert np.abs(png[near] / 1000.0 - depth[near]).max() <= 0.00051
    assert (png[depth == 10_000.0] == 0).all()
    assert document['depth_left_mm']['png_counts_per_m'] == 1000.0
    assert document['baseline_m'] == pytest.approx(synthetic_bag.MOUNT.baseline_m)


def test_millimetres_are_bounded() -> None:
    """Nothing wraps round."""
    depth = np.array([0.0004, 1.2344, 65.5354, 65.6, np.inf, np.nan, -1.0], dtype=np.float32)
    assert depth_counts(depth, 1000.0).tolist() == [0, 1234, 65535, 0, 0, 0, 0]


BODY, LEG, ROCK = (slice(100, 110), slice(10, 30)), (slice(100, 110), slice(120, 140)), 700


@pytest.fixture(scope='module')
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an exported drive of 3 frames with labels: sky, ground, a rock, body and a leg."""
    items = synthetic_bag.drive(0.3)
    scenario = next(i for i in items if i.topic == topics.SCENARIO.name)
    scenario.message.data += 'rover:\n  ros__parameters: ' + json.dumps(
        RoverDescription().to_mapping()) + '\n'
    for k in range(1, 4):
        depth = depth_at(k)
        label = np.where(np.isfinite(depth), 1, 0).astype(np.uint16)
        label[90:95, 60:70] = ROCK
        label[BODY], label[LEG] = 2, 4
        for topic, encoding, pixels in (
                (topics.LABELS, 'mono16', label), (topics.RIGHT_LABELS, 'mono16', label[:, ::-1]),
                (topics.RIGHT_TRUE_DEPTH, '32FC1', depth[:, ::-1].astype(np.float32))):
            items.append(synthetic_bag.picture(topic, k * 10**8, encoding,
                                               np.ascontiguousarray(pixels)))
    folder = tmp_path_factory.mktemp('labelled')
    notes = export(synthetic_bag.write(folder / 'bag', items), folder / 'P000', 'tartanair')
    assert not any('not written' in note for note in notes)
    return folder / 'P000'


def camera_at(k: int) -> np.ndarray:
    return synthetic_bag.pose_at(k / 10) @ synthetic_bag.T_base_camera(+1.0)


def depth_at(k: int) -> np.ndarray:
    return synthetic_bag.Scene().view(camera_at(k))[1]


def projected(T_camera_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the (n, 2) pixels of (n, 3) points."""
    p = points @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    centre = [(synthetic_bag.WIDTH - 1) / 2, (synthetic_bag.HEIGHT - 1) / 2]
    return p[:, :2] / p[:, 2:] * synthetic_bag.FOCAL_PX + centre


def points_of(k: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the (n, 3) points in the world that frame k shows at pixels."""
    rays = synthetic_bag.Scene().rays[rows, columns] * depth_at(k)[rows, columns, None]
    return rays @ camera_at(k)[:3, :3].T + camera_at(k)[:3, 3]


def test_segmentation_is_that_of_the_labels(labelled: Path) -> None:
    """Rocks are one class, everything else keeps its label; the map names them."""
    seg = np.load(labelled / 'seg_left/000001_left_seg.npy')
    names = json.loads((labelled / 'seg_label_map.json').read_text())['name_map']
    assert seg.dtype == np.uint8 and (seg[90:95, 60:70] == names['rock']).all()
    assert (seg[BODY] == names['rover body']).all()
    assert (seg[LEG] == names['rover front left leg']).all()
    assert (seg[~np.isfinite(depth_at(2))] == names['sky']).all()
    assert len(set(names.values())) == len(names)
    right = np.load(labelled / 'seg_right/000001_right_seg.npy')
    assert np.array_equal(right, seg[:, ::-1])
    left, right = (np.load(labelled / f'depth_{side}/000001_{side}_depth.npy')
                   for side in ('left', 'right'))
    assert np.array_equal(right, left[:, ::-1])
    assert (labelled / 'depth_right_mm/000001_right_depth.png').is_file()
    calibration = yaml.safe_load((labelled / 'calibration.yaml').read_text())
    assert calibration['depth_right'] == calibration['depth_left']


def test_flow_leads_to_the_next_image(labelled: Path) -> None:
    """Ground lands where the next camera sees it; the body stands still; a leg turns."""
    assert sorted(p.name for p in (labelled / 'flow').iterdir()) == [
        f'{k:06d}_{k + 1:06d}_{kind}.npy' for k in (0, 1) for kind in ('flow', 'mask')]
    flow = np.load(labelled / 'flow/000000_000001_flow.npy')
    mask = np.load(labelled / 'flow/000000_000001_mask.npy')
    assert flow.dtype == np.float32 and mask.dtype == np.uint8
    rows, columns = (a.ravel() for a in np.mgrid[60:95:5, 5:155:10])
    expected = projected(inverse(camera_at(2)), points_of(1, rows, columns))
    found = flow[rows, columns] + np.stack([columns, rows], axis=1)
    assert np.abs(found - expected).max() < 0.01
    assert np.abs(flow[rows, columns]).max() > 1.0
    assert np.abs(flow[BODY]).max() < 1e-3
    # The legs of the analytic drive turn by 0.2 rad in a frame, about their axles.
    rows, columns = (a.ravel() for a in np.mgrid[LEG])
    base = [synthetic_bag.pose_at(k / 10) for k in (1, 2)]
    axle = RoverDescription().legs.axle_positions_m()[0]
    local = (points_of(1, rows, columns) - base[0][:3, 3]) @ base[0][:3, :3] - axle
    local = Rotation.from_euler('y', 0.2).apply(local) + axle
    expected = projected(inverse(camera_at(2)), local @ base[1][:3, :3].T + base[1][:3, 3])
    found = flow[rows, columns] + np.stack([columns, rows], axis=1)
    assert np.abs(found - expected).max() < 0.01


def test_mask_tells_what_the_next_image_shows(labelled: Path) -> None:
    """What leaves the image is outside; of the plane, all that stays inside is seen."""
    flow = np.load(labelled / 'flow/000000_000001_flow.npy')
    mask = np.load(labelled / 'flow/000000_000001_mask.npy')
    v, u = np.mgrid[:synthetic_bag.HEIGHT, :synthetic_bag.WIDTH]
    there = np.stack([u, v], axis=2) + flow
    inside = ((there > -0.5) & (there < (synthetic_bag.WIDTH - 0.5, synthetic_bag.HEIGHT - 0.5))
              ).all(axis=2)
    assert (mask[~inside] == 100).all() and (mask[inside] != 100).all() and (~inside).any()
    ground = inside & np.isfinite(depth_at(1))
    ground[BODY], ground[LEG] = False, False
    assert (mask[ground] == 0).mean() > 0.99
    # A wall in the right half, 1 m before what was at 3 m.
    depth = np.full((4, 6), 3.0, np.float32)
    wall = depth.copy()
    wall[:, 3:] = 2.0
    still = np.zeros((4, 6, 2), np.float32)
    assert seen_mask(still, depth, wall).tolist() == [[0, 0, 0, 1, 1, 1]] * 4
    assert (seen_mask(still, wall, depth) == 0).all()


def test_without_labels_it_is_said(sequence: Path) -> None:
    """There is neither segmentation nor flow, and no empty folder."""
    assert not (sequence / 'flow').exists() and not (sequence / 'seg_left').exists()
