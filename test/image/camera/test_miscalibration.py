"""The right camera that differs from its CameraInfo: geometry, brightness, what is told of it."""

import dataclasses
import json
from pathlib import Path

import camera_scene as scene
import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import synthetic_bag as synthetic

from lunar_rover_sim.base import topics
from lunar_rover_sim.image.camera.config import CameraConfig, MiscalibrationConfig
from lunar_rover_sim.image.camera.miscalibration import margin, Miscalibration
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.products.inspection.check import check
from lunar_rover_sim.products.sequences.export import export, MISCALIBRATION_FILE
from lunar_rover_sim.rover.pose import RoverPose

CAMERA = CameraConfig(320, 240)
BOUNDS = MiscalibrationConfig(rotation_deg=0.4, focal_percent=1.0, gain_percent=10.0)
SEED = 5


def drawn_pair(**groups: object) -> tuple[np.ndarray, np.ndarray, float]:
    """Return linear images of the ground from some height, and the focal length [px]."""
    sensor = dataclasses.replace(scene.IDEAL, exposure_mode='fixed', exposure_s=5e-4,
                                 encoding='mono16')
    config = scene.config(camera=CAMERA, sensor=sensor, sun=scene.RELIEF_SUN, detail=DetailConfig(
        bounce=False, smooth_outlines=False), **groups)
    with Renderer(scene.plane(257, far=False), scene.ROVER, config, SEED) as renderer:
        frame = renderer.render(RoverPose(scene.pose(z=0.6, pitch_deg=30.0)), 0, ('left', 'right'))
        return frame.left, frame.right, renderer.rig.focal_px


def test_geometry_and_brightness_of_the_right_image_are_those_told() -> None:
    """Points lie where projection by the true camera puts them, to 0.1 px; the left stays."""
    left, right, focal = drawn_pair()
    same, moved, _ = drawn_pair(miscalibration=BOUNDS)
    # The drawn image is larger: its veil, and the rounding of depth, are those of another one.
    lit = left > 2000
    assert np.percentile(np.abs(same[lit] / left[lit].astype(float) - 1.0), 99.0) < 0.02
    wrong = Miscalibration.drawn(BOUNDS, SEED)
    shown = [np.clip(image / np.percentile(right, 98) * 200, 0, 255).astype(np.uint8)
             for image in (right, moved)]
    points = cv2.goodFeaturesToTrack(shown[0], 400, 0.01, 8)
    there, found, _ = cv2.calcOpticalFlowPyrLK(*shown, points, None, winSize=(21, 21))
    inside = (found[:, 0] == 1) & (np.abs(points[:, 0] - [160, 120]) < [140, 100]).all(axis=1)
    places, there = points[inside, 0], there[inside, 0]
    centre = np.array([159.5, 119.5])
    # Into the true camera: turn the ray back, project with its focal length.
    rays = np.column_stack([(places - centre) / focal, np.ones(len(places))])
    rays = Rotation.from_rotvec(wrong.rotation_rad).inv().apply(rays)
    theory = rays[:, :2] / rays[:, 2:] * focal * wrong.focal_ratio + centre
    assert len(places) > 60
    assert np.abs(theory - places)[:, 1].max() > 0.5         # the epipolar error that is meant
    assert np.median(np.linalg.norm(there - theory, axis=1)) < 0.1
    assert np.abs(np.median(there - theory, axis=0)).max() < 0.03
    ratio = cv2.blur(moved.astype(float), (41, 41))[110:130, 150:170] / cv2.blur(
        right.astype(float), (41, 41))[110:130, 150:170]
    assert np.mean(ratio) == pytest.approx(wrong.gain, rel=0.01)


@pytest.mark.parametrize('distortion', [(0.0,) * 5, (-0.2, 0.05, 1e-3, -1e-3, 0.0)])
def test_the_margin_holds_all_that_is_shown(distortion: tuple[float, ...]) -> None:
    camera = CameraConfig(320, 240, distortion=distortion)
    pad = np.array(margin(camera, BOUNDS))
    for seed in range(40):
        wrong = Miscalibration.drawn(BOUNDS, seed)
        source = wrong.source(camera)
        # It turns and magnifies about the middle of the image.
        still = dataclasses.replace(wrong, rotation_rad=(0.0, 0.0, 0.01)).source(CAMERA)
        assert np.abs(still + still[::-1, ::-1] - [319.0, 239.0]).max() < 1e-3
        assert (source.min(axis=(0, 1)) >= -pad).all()
        assert (source.max(axis=(0, 1)) < [320, 240] + pad - 1).all()


@pytest.mark.parametrize('percent', [0.5, 2.0, 4.0])
def test_the_margin_of_a_focal_length_is_its_share_of_half_the_image(percent: float) -> None:
    """A shorter one by a part p shows p / (1 - p) of half the image beyond, and two pixels."""
    bounds = dataclasses.replace(BOUNDS, rotation_deg=0.0, focal_percent=percent)
    part = 0.01 * percent
    beyond = part / (1.0 - part) * 0.5 * np.array([80.0, 60.0])
    assert margin(CameraConfig(80, 60), bounds) == pytest.approx(beyond + 2.5, abs=0.6)


def test_each_seed_draws_one_within_the_bounds_and_none_is_perfect_by_default() -> None:
    found = [Miscalibration.drawn(BOUNDS, seed) for seed in range(200)]
    assert len({each.gain for each in found}) == 200
    turns = np.degrees([each.rotation_rad for each in found])
    assert 0.35 < np.abs(turns).max() <= 0.4 and abs(turns.mean()) < 0.05
    assert 1.005 < max(each.focal_ratio for each in found) <= 1.01
    assert 0.9 <= min(each.gain for each in found) < 0.92
    assert Miscalibration.drawn(RenderConfig().miscalibration, 3) == Miscalibration()
    assert RenderConfig().miscalibration.perfect and margin(CAMERA, MiscalibrationConfig()) == (
        0, 0)


def test_truth_is_exported_and_camera_info_does_not_know_it(tmp_path: Path) -> None:
    told = Miscalibration.drawn(BOUNDS, SEED).told(CAMERA)
    bag = synthetic.write(tmp_path / 'bag', [*synthetic.drive(0.3), synthetic.text(
        topics.MISCALIBRATION, json.dumps(told))])
    assert check(bag).ok
    export(bag, tmp_path / 'out', 'kitti')
    assert json.loads((tmp_path / 'out' / MISCALIBRATION_FILE).read_text()) == told
    assert 'gain' not in (tmp_path / 'out' / 'calibration.yaml').read_text()
