"""The reference odometry on what the renderer draws: the image itself must be metric."""

import runpy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import worlds

from lunar_rover_sim.base.files.paths import config_folder
from lunar_rover_sim.base.frames import se3
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.judge.slam.euroc_reader import Camera, Frame
from lunar_rover_sim.judge.slam.protocol import FrameSet
from lunar_rover_sim.judge.slam.reference.odometry import VisualOdometry
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

PERIOD_NS = 100_000_000


@pytest.fixture(scope='module')
def drive() -> tuple[list[Frame], Trajectory, StereoRig]:
    """Give 30 frames of 1.5 cm along a curve over `baseline`, nodding, noise and shadows on."""
    scenario = Scenario.load('baseline')
    world = worlds.small()
    frames, poses = [], []
    with Renderer(world, scenario.rover, scenario.render_node, seed=1) as renderer:
        rig = renderer.rig
        for k in range(30):
            turn = 0.012 * k
            pose = standing(world, 0.015 * k, 0.015 * k * turn / 2, np.degrees(turn))
            nod = Rotation.from_euler('Y', 2.0 * np.sin(1.3 * k), degrees=True).as_matrix()
            frame = renderer.render(RoverPose(pose @ se3(nod, np.zeros(3))), k,
                                    ('left', 'right'))
            frames.append(Frame((k + 1) * PERIOD_NS, frame.left, frame.right))
            poses.append(pose @ se3(nod, np.zeros(3)) @ rig.T_base_left)
    T = np.array(poses)
    truth = Trajectory(np.array([f.stamp_ns for f in frames]), T[:, :3, 3],
                       wxyz(Rotation.from_matrix(T[:, :3, :3])))
    return frames, truth, rig


def of(rig: StereoRig, baseline_m: float) -> Camera:
    return Camera((rig.focal_px, rig.focal_px), (rig.K[0, 2], rig.K[1, 2]), baseline_m)


def test_stereo_scale_and_error(drive) -> None:
    """Scale within 1 % of 1 and an error below 2 % of the way, as a whole drive must have."""
    frames, truth, rig = drive
    odometry = VisualOdometry.of_rig(rig)
    assert all([odometry.add(*frame) for frame in frames])
    result = evaluate(truth, odometry.trajectory())
    assert result.scale == pytest.approx(1.0, abs=0.01)
    assert result.ate_m.rmse < 0.02 * truth.length_m


def test_a_wrong_baseline_is_noticed(drive) -> None:
    """A rig that is 5 % off in its calibration shows in the scale."""
    frames, truth, rig = drive
    odometry = VisualOdometry(of(rig, 1.05 * rig.baseline_m))
    for frame in frames[:15]:
        odometry.add(*frame)
    assert abs(evaluate(truth, odometry.trajectory()).scale - 1.0) > 0.03


def test_mono_shape(drive) -> None:
    """Within 0.5 % of the way: an adjustment that lets the scale go leaves jumps of 2 %."""
    frames, truth, rig = drive
    odometry = VisualOdometry(of(rig, 0.0))
    located = [odometry.add(*frame) for frame in frames]
    # It starts once parallax allows, and is not lost then.
    assert all(located[located.index(True):]) and sum(located) > 15
    result = evaluate(truth, odometry.trajectory(), align='sim3')
    assert result.ate_m.rmse < 0.005 * truth.length_m


def test_the_opencv_example_answers_frame_by_frame(drive) -> None:
    """The pose that each frame is answered with, not what is known at the end."""
    frames, truth, rig = drive
    f, cx, cy = rig.focal_px, rig.K[0, 2], rig.K[1, 2]
    begin = runpy.run_path(str(config_folder() / 'templates' / 'slam_opencv.py'))['begin']
    track = begin({'fx': f, 'fy': f, 'cx': cx, 'cy': cy, 'baseline_m': rig.baseline_m})
    poses = np.array([track(FrameSet(frame.stamp_ns, (frame.left, frame.right)), [])
                      for frame in frames])
    estimate = Trajectory(truth.stamps_ns, poses[:, :3, 3],
                          wxyz(Rotation.from_matrix(poses[:, :3, :3])))
    result = evaluate(truth, estimate)
    assert result.ate_m.rmse < 0.05 * truth.length_m
    assert result.scale == pytest.approx(1.0, abs=0.05)
