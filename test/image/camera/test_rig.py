"""The stereo pair, and cameras that are entries of a list like it."""

import dataclasses
import math

import numpy as np
import pytest

from lunar_rover_sim.base.frames import inverse, matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.run.scenario import Scenario

POSE = se3(matrix_from_wxyz(wxyz_from_rpy(0.1, -0.2, 2.0)), (3.0, -7.0, 0.4))


def rig(pitch_deg=12.0, **camera):
    rover = RoverDescription()
    mount = dataclasses.replace(rover.stereo, pitch_deg=pitch_deg)
    return StereoRig(dataclasses.replace(rover, stereo=mount), CameraConfig(**camera))


@pytest.mark.parametrize('width,height,fov_deg', [(640, 480, 70.0), (320, 256, 100.0)])
def test_the_field_of_view_reaches_from_edge_to_edge(width, height, fov_deg):
    """Half a pixel beyond the centres of the outer pixels, in the middle row."""
    camera = rig(width=width, height=height, horizontal_fov_deg=fov_deg)
    left, right = -0.5, width - 0.5
    angle = [math.degrees(math.atan((u - camera.K[0, 2]) / camera.K[0, 0])) for u in (left, right)]
    assert angle == pytest.approx([-fov_deg / 2.0, fov_deg / 2.0])
    assert camera.K[1, 1] == camera.K[0, 0] == camera.focal_px
    assert camera.K[1, 2] == (height - 1) / 2.0
    assert camera.rays().shape == (height, width, 3)


@pytest.mark.parametrize('pitch_deg', [0.0, 15.0])
def test_a_point_on_the_ray_of_a_pixel_is_seen_in_that_pixel(pitch_deg):
    camera = rig(pitch_deg, width=64, height=48)
    depth = np.random.default_rng(0).uniform(0.3, 40.0, (48, 64))
    T_world_left = POSE @ camera.T_base_left
    points = camera.rays() * depth[..., None] @ T_world_left[:3, :3].T + T_world_left[:3, 3]
    left, right = camera.project(points, POSE)
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    np.testing.assert_allclose(left, np.stack([u, v], axis=-1), atol=1e-8)
    # In the right image it lies on the same row, f b / z to the left.
    np.testing.assert_allclose(right[..., 1], v, atol=1e-8)
    np.testing.assert_allclose(left[..., 0] - right[..., 0],
                               camera.focal_px * camera.baseline_m / depth, rtol=1e-9)


def test_what_lies_behind_the_cameras_has_no_pixel():
    camera = rig(0.0)
    ahead, behind = camera.project([[5.0, 0.0, 0.2], [-5.0, 0.0, 0.2]], np.eye(4))[0]
    assert np.isfinite(ahead).all() and np.isnan(behind).all()


def test_the_cameras_sit_on_either_side_of_the_mount_and_look_down_by_its_pitch():
    camera, mount = rig(20.0), RoverDescription().stereo
    left, right = camera.T_base_left, camera.T_base_right
    np.testing.assert_allclose((left[:3, 3] + right[:3, 3]) / 2.0, mount.position_m, atol=1e-12)
    np.testing.assert_allclose(left[:3, 3] - right[:3, 3], [0.0, camera.baseline_m, 0.0],
                               atol=1e-12)
    np.testing.assert_allclose(left[:3, :3], right[:3, :3])
    # The optical axis points ahead and down; x of the image points to the right, which is -y.
    np.testing.assert_allclose(left[:3, 2], [math.cos(math.radians(20.0)), 0.0,
                                             -math.sin(math.radians(20.0))], atol=1e-12)
    np.testing.assert_allclose(left[:3, 0], [0.0, -1.0, 0.0], atol=1e-12)


def test_projection_matrices_say_the_same():
    """P of the left image times a point in its optical frame; of the right one, b farther."""
    camera = rig()
    point = np.array([0.4, -0.2, 3.0, 1.0])
    world = POSE @ camera.T_base_left @ point
    left, right = camera.project(world[:3], POSE)
    for pixel, P in ((left, camera.P_left), (right, camera.P_right)):
        u, v, w = P @ point
        np.testing.assert_allclose(pixel, [u / w, v / w])
    # The right camera's own frame sees it at the same place.
    own = inverse(camera.T_base_right) @ camera.T_base_left @ point
    u, v, w = camera.K @ own[:3]
    np.testing.assert_allclose(right, [u / w, v / w])


BACK = {'render_node.hazard.back.rate_hz': 4, 'render_node.hazard.back.stereo_baseline_m': 0.1,
        'render_node.chase.enabled': True}


def test_its_noise_is_its_own() -> None:
    """The noise of a camera does not depend on which others there are."""
    pair, back, chase = Scenario.load('flat', BACK).render_node.cameras
    alone = Scenario.load('flat', {'render_node.hazard.back.rate_hz': 4}).render_node.cameras[1]
    other = Scenario.load('flat', {'render_node.hazard.front.rate_hz': 4}).render_node.cameras[1]
    seeds = [entry.noise_seed(7) for entry in (pair, back, chase, other)]
    assert len(set(seeds)) == 4 and alone.noise_seed(7) == back.noise_seed(7)
    assert all(0 <= back.noise_seed(k) < 2**31 for k in range(9)), 'a whole number of 32 bits'


@pytest.mark.ros
def test_an_image_is_due_in_the_first_frame_of_each_of_its_periods() -> None:
    """Frames at 20 Hz, images at 10 and 5 Hz: in lockstep after the first whole period."""
    pytest.importorskip('rclpy')
    from lunar_rover_sim.nodes.camera_publisher import Periods
    ten, five = 100_000_000, 200_000_000
    frames_ns = [50_000_000 * k for k in range(1, 9)]
    due = Periods([ten, five], lockstep=True)
    found = [due.begun(stamp) for stamp in frames_ns]
    assert [stamp for stamp, begun in zip(frames_ns, found) if ten in begun] == frames_ns[1::2]
    assert [stamp for stamp, begun in zip(frames_ns, found) if five in begun] == frames_ns[3::4]
    due.restart()
    assert due.begun(frames_ns[0]) == frozenset() and due.begun(frames_ns[1]) == {ten}
    # In real time the first frame has all; where frames are lost, the next one has them.
    live = Periods([ten, five], lockstep=False)
    assert not live.has_begun and live.begun(frames_ns[0]) == {ten, five} and live.has_begun
    assert live.begun(frames_ns[4]) == {ten, five} and live.begun(frames_ns[4]) == frozenset()
