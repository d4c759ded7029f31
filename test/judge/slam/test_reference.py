"""The reference odometry on views of a textured plane, computed exactly."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.base.frames import inverse, R_BODY_OPTICAL, se3
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.slam.client import reference
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Frame
from lunar_rover_sim.judge.slam.protocol import FrameSet
from lunar_rover_sim.judge.slam.reference.geometry import (detect, disparities, from_disparity,
                                                           locate, project, track, triangulate,
                                                           two_views)
from lunar_rover_sim.judge.slam.reference.odometry import Problem, residuals, VisualOdometry

CAMERA = Camera((300.0, 300.0), (159.5, 119.5), 0.1)
MONO = Camera(CAMERA.focal_px, CAMERA.centre_px)
TEXEL_M = 0.004


@pytest.fixture(scope='module')
def ground() -> np.ndarray:
    """Return a texture with structure of 1 to 10 cm."""
    rng = np.random.default_rng(3)
    texture = np.zeros((1500, 1500))
    for sigma in (1.5, 4.0, 10.0):
        noise = cv2.GaussianBlur(rng.normal(size=texture.shape), (0, 0), sigma)
        texture += noise / noise.std()
    return np.asarray(np.clip(120 + 35 * texture, 0, 255), np.uint8)


def view(texture: np.ndarray, T_world_camera: np.ndarray) -> np.ndarray:
    """Return the image of the plane z = 0 textured about the origin; the sky is black."""
    T = inverse(T_world_camera)
    plane = CAMERA.matrix @ T[:3, [0, 1, 3]]
    middle = 0.5 * texture.shape[0] * TEXEL_M
    to_plane = np.array([[TEXEL_M, 0, -middle], [0, TEXEL_M, -middle], [0, 0, 1.0]])
    finer = np.array([[4.0, 0.0, 1.5], [0.0, 4.0, 1.5], [0.0, 0.0, 1.0]])   # no aliasing far away
    image = cv2.resize(cv2.warpPerspective(texture, finer @ plane @ to_plane, (1280, 960)),
                       (320, 240), interpolation=cv2.INTER_AREA)
    v, u = np.mgrid[:240, :320]
    rays = np.linalg.inv(CAMERA.matrix) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    down = (T_world_camera[:3, :3] @ rays)[2].reshape(u.shape)
    image[down > -0.05] = 0
    return np.asarray(image, np.uint8)


def poses(count: int = 30) -> np.ndarray:
    """Return T_world_camera of a rover that nods by 3 degrees and turns slowly."""
    T = []
    for k in range(count):
        body = Rotation.from_euler('ZYX', [0.01 * k, 0.35 + 0.05 * np.sin(1.3 * k), 0.0])
        at = [0.015 * k - 1.0, 0.001 * k**1.5, 0.3 + 0.004 * np.sin(1.3 * k)]
        T.append(se3(body.as_matrix() @ R_BODY_OPTICAL, at))
    return np.array(T)


def shifted(T: np.ndarray) -> np.ndarray:
    return T @ se3(np.eye(3), [CAMERA.baseline_m, 0.0, 0.0])


@pytest.fixture(scope='module')
def drive(ground) -> tuple[list[Frame], Trajectory]:
    T = poses()
    made = [Frame((k + 1) * 100_000_000, view(ground, at), view(ground, shifted(at)))
            for k, at in enumerate(T)]
    truth = Trajectory(np.array([f.stamp_ns for f in made]), T[:, :3, 3],
                       wxyz(Rotation.from_matrix(T[:, :3, :3])))
    return made, truth


def test_stereo_is_metric(drive) -> None:
    """Scale within 1 %, as disparities of 0.1 px at 20 px and more would have it."""
    frames, truth = drive
    odometry = VisualOdometry(CAMERA)
    assert all([odometry.add(*frame) for frame in frames])
    result = evaluate(truth, odometry.trajectory())
    assert result.scale == pytest.approx(1.0, abs=0.01)
    assert result.ate_m.rmse < 0.01 * truth.length_m
    # A path this straight leaves the roll of the alignment open; turns from pose to pose do not.
    assert result.rpe_time_deg.rmse < 0.15


def test_moving_shadow_is_left_out(drive) -> None:
    """A dark patch that stays in the image, as the rover's own shadow does, moves nothing."""
    frames, truth = drive
    odometry = VisualOdometry(CAMERA)
    for frame in frames:
        images = [frame.left.copy(), frame.right.copy()]
        for image, shift in zip(images, (0, 25)):
            image[170:, 100 - shift:200 - shift] //= 8
        odometry.add(frame.stamp_ns, *images)
    result = evaluate(truth, odometry.trajectory())
    assert result.tracked_share == 1.0
    assert result.scale == pytest.approx(1.0, abs=0.02)


def test_darkness_is_lost() -> None:
    odometry = VisualOdometry(CAMERA)
    black = np.zeros((240, 320), np.uint8)
    assert not any(odometry.add(k, black, black) for k in range(1, 5))


def test_light_that_goes_out_ends_the_track(drive) -> None:
    frames, _ = drive
    odometry = VisualOdometry(CAMERA)
    black = np.zeros_like(frames[0].left)
    for frame in frames[:8]:
        odometry.add(*frame)
    for k in range(12):
        odometry.add(frames[8].stamp_ns + k, black, black)
    assert odometry.lost_ns is not None
    assert len(odometry.trajectory()) == 8


def test_a_live_pair_goes_on_where_its_track_was_lost(drive) -> None:
    frames, truth = drive
    track = reference({'sensor': 'stereo', 'fx': 300.0, 'fy': 300.0, 'cx': 159.5, 'cy': 119.5,
                       'baseline_m': CAMERA.baseline_m, 'distortion': [0.0] * 5})
    black = np.zeros_like(frames[0].left)
    sent = [(f.left, f.right) for f in frames[:10]] + 12 * [(black, black)] \
        + [(f.left, f.right) for f in frames[9:20]]
    found = [track(FrameSet(k, images), []) for k, images in enumerate(sent)]
    assert [T is None for T in found] == 10 * [False] + 12 * [True] + 11 * [False]
    true = inverse(poses()[9]) @ poses()[19]
    off = inverse(inverse(found[9]) @ found[-1]) @ true
    assert np.linalg.norm(off[:3, 3]) < 0.02 * np.linalg.norm(true[:3, 3])


def test_disparity_of_sheared_ground(drive) -> None:
    """Ground seen from low is sheared between the images; a tenth of a pixel is left."""
    frames, _ = drive
    frame, T = frames[0], poses()[0]
    px = detect(frame.left, np.zeros((0, 2)), 200)
    found = disparities(frame.left, frame.right, px)
    seen = np.isfinite(found)
    assert seen.mean() > 0.6
    rays = np.column_stack([(px - CAMERA.centre_px) / CAMERA.focal_px, np.ones(len(px))])
    depth = -T[2, 3] / (rays @ T[:3, :3].T)[:, 2]
    true = CAMERA.focal_px[0] * CAMERA.baseline_m / depth
    error = found[seen] - true[seen]
    assert abs(np.median(error)) < 0.05
    assert np.median(np.abs(error)) < 0.1


def test_tracks_come_home(drive) -> None:
    frames, _ = drive
    image = frames[0].left
    px = detect(image, np.zeros((0, 2)), 100)
    moved = cv2.warpAffine(image, np.array([[1.0, 0.0, 3.3], [0.0, 1.0, -2.6]]), (320, 240),
                           flags=cv2.INTER_CUBIC)
    there, found = track(image, moved, px)
    assert found.mean() > 0.8
    assert np.median(np.abs(there[found] - px[found] - (3.3, -2.6))) < 0.05


@pytest.mark.parametrize('gain', [0.9, 1.0, 1.1])
def test_exposure_may_change(ground, gain: float) -> None:
    """Ground with little texture is tracked while automatic exposure settles."""
    faint = np.asarray(120 + 0.12 * (ground.astype(float) - 120), np.uint8)
    first = view(faint, poses(1)[0])
    nodded = poses(1)[0] @ se3(Rotation.from_rotvec([0.01, 0.0, 0.0]).as_matrix(), [0.0] * 3)
    second = view(faint, nodded)
    second = np.asarray(np.clip(np.rint(gain * second.astype(float)), 0, 255), np.uint8)
    corners = detect(first, np.zeros((0, 2)), 200)
    there, found = track(first, second, corners)
    assert len(corners) > 100 and found.mean() > 0.8


def test_bundle_finds_poses_and_points() -> None:
    """From poses 3 cm and 1 degree off, back to 1e-4 on exact observations."""
    rng = np.random.default_rng(1)
    points = rng.uniform([-1, -0.5, 1.0], [1, 0.5, 3.0], (80, 3))
    true = np.array([se3(Rotation.from_rotvec([0, 0.02 * k, 0]).as_matrix(), [-0.1 * k, 0, 0])
                     for k in range(5)])
    camera_of, point_of = (a.ravel() for a in np.meshgrid(np.arange(5), np.arange(80),
                                                          indexing='ij'))
    seen = np.zeros((400, 3))
    seen = residuals(CAMERA, true[camera_of], points[point_of], seen)
    start = true.copy()
    for k in (2, 3, 4):
        start[k] = se3(Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix(),
                       rng.normal(0, 0.02, 3)) @ start[k]
    seen[::7, 2] = np.nan
    problem = Problem(start, np.arange(5) < 2, points + rng.normal(0, 0.02, points.shape),
                      camera_of, point_of, seen)
    left = problem.solve(CAMERA)
    assert np.median(np.linalg.norm(left, axis=1)) < 0.02
    assert np.abs(problem.T_camera_world - true).max() < 1e-3
    assert np.abs(start[:2] - true[:2]).max() == 0.0


def test_two_views_and_depth() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([-1, -0.5, 1.5], [1, 0.5, 3.0], (100, 3))
    T = se3(Rotation.from_rotvec([0.02, -0.05, 0.01]).as_matrix(), [0.2, 0.02, -0.2])
    a, b = project(MONO, np.eye(4), points), project(MONO, T, points)
    assert triangulate(MONO, np.eye(4), T, a, b) == pytest.approx(points, abs=1e-6)
    views = two_views(MONO, a, b)
    assert views is not None
    scale = np.linalg.norm(T[:3, 3]) / np.linalg.norm(views[0][:3, 3])
    assert views[0][:3, :3] == pytest.approx(T[:3, :3], abs=1e-3)
    assert views[1][views[2]] * scale == pytest.approx(points[views[2]], rel=0.05, abs=0.05)
    turned = se3(T[:3, :3], [0.0, 0.0, 0.0])
    assert two_views(MONO, a, project(MONO, turned, points)) is None   # no parallax
    right = project(CAMERA, se3(np.eye(3), [-CAMERA.baseline_m, 0, 0]), points)
    assert from_disparity(CAMERA, a, a[:, 0] - right[:, 0]) == pytest.approx(points)


@pytest.mark.parametrize('seed', range(8))
def test_points_at_the_horizon_do_not_move_the_camera(seed: int) -> None:
    """Six of 200 points are kilometres away, as near the horizon; the rest says where it is."""
    rng = np.random.default_rng(seed)
    px = np.column_stack([rng.uniform(0.0, 640.0, 200), rng.uniform(120.0, 480.0, 200)])
    depth_m = 0.3 / np.maximum((px[:, 1] - 118.0) / 448.0, 0.003)
    depth_m[:6] = rng.uniform(1000.0, 5000.0, 6)
    camera = Camera((448.0, 448.0), (320.0, 240.0), 0.12)
    points = np.column_stack([(px - camera.centre_px) / 448.0 * depth_m[:, None], depth_m])
    T = se3(Rotation.from_rotvec([0.01, 0.04, 0.07]).as_matrix(), [0.02, 0.03, -0.16])
    seen = project(camera, T, points) + rng.normal(0.0, 0.3, px.shape)
    found, agree = locate(camera, points, seen, 15)
    assert found is not None and agree.sum() > 190
    assert np.linalg.norm(found[:3, 3] - T[:3, 3]) < 0.005
