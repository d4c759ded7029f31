"""Optical flow and scene flow against points that are followed one by one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lunar_rover_sim.camera.flow import FlowModel, Moved

K = np.array([[50.0, 0.0, 15.5], [0.0, 55.0, 11.5], [0.0, 0.0, 1.0]])
HEIGHT, WIDTH = 24, 32


def pose(angles_deg, position_m):
    result = np.eye(4)
    result[:3, :3] = Rotation.from_euler('ZYX', angles_deg, degrees=True).as_matrix()
    result[:3, 3] = position_m
    return result


CAMERA = pose((70.0, 5.0, -95.0), (3.0, -1.0, 0.4))
OTHER = pose((74.0, 3.0, -93.0), (3.2, -0.7, 0.5))
BODY = pose((10.0, 0.0, 0.0), (2.0, 1.0, 0.0))
BODY_OTHER = pose((25.0, 4.0, 0.0), (2.2, 1.1, 0.1))


@pytest.fixture(scope='module')
def scene():
    """Return depths of 2 m to 5 m, some of them sky, and where the body is seen."""
    rng = np.random.default_rng(4)
    depth = rng.uniform(2.0, 5.0, (HEIGHT, WIDTH)).astype(np.float32)
    depth[:3] = np.inf
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:20, 5:18] = True
    return depth, mask


def followed(depth, v, u, moves):
    """Return where the point of a pixel is in either camera [m]."""
    here = depth * np.linalg.inv(K) @ [u, v, 1.0]
    in_world = CAMERA @ np.append(here, 1.0)
    if moves:
        in_world = BODY_OTHER @ np.linalg.inv(BODY) @ in_world
    return here, (np.linalg.inv(OTHER) @ in_world)[:3]


def test_flow_is_where_each_point_has_gone(scene):
    depth, mask = scene
    model = FlowModel(K, depth, CAMERA, OTHER, [Moved(mask, BODY, BODY_OTHER)])
    optical, moved = model.optical_flow(), model.scene_flow()
    assert optical.shape == (HEIGHT, WIDTH, 2) and moved.shape == (HEIGHT, WIDTH, 3)
    assert optical.dtype == moved.dtype == np.float32
    for v, u in [(5, 0), (5, 31), (23, 0), (10, 5), (15, 9), (19, 17), (20, 17), (9, 5)]:
        here, there = followed(float(depth[v, u]), v, u, mask[v, u])
        pixel = K @ there / there[2]
        assert optical[v, u] == pytest.approx(pixel[:2] - [u, v], abs=1e-3)
        assert moved[v, u] == pytest.approx(there - here, abs=1e-5)


def test_the_sky_turns_with_the_camera_and_has_no_place(scene):
    depth, _ = scene
    model = FlowModel(K, depth, CAMERA, OTHER)
    turn = OTHER[:3, :3].T @ CAMERA[:3, :3]
    for v, u in [(0, 0), (2, 31)]:
        pixel = K @ turn @ np.linalg.inv(K) @ [u, v, 1.0]
        assert model.optical_flow()[v, u] == pytest.approx(pixel[:2] / pixel[2] - [u, v], abs=1e-3)
    assert np.isnan(model.scene_flow()[:3]).all() and np.isfinite(model.scene_flow()[3:]).all()


def test_a_point_behind_the_other_camera_has_no_flow():
    """1 m ahead of the camera, which then stands 2 m farther on; the next point is at 4 m."""
    depth = np.array([[1.0, 4.0]], np.float32)
    ahead = np.eye(4)
    ahead[2, 3] = 2.0
    model = FlowModel(K, depth, np.eye(4), ahead)
    flow = model.optical_flow()
    assert np.isnan(flow[0, 0]).all()
    # Half the depth: twice as far from the principal point.
    assert flow[0, 1] == pytest.approx([1.0 - 15.5, 0.0 - 11.5], abs=1e-4)
    assert model.scene_flow()[0, 0] == pytest.approx([0.0, 0.0, -2.0])
