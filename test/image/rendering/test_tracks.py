"""Tracks in the picture: their depth, shadows and labels; what is pressed has no old relief."""

import math

from camera_scene import config, plane, pose, RELIEF_SUN, ROVER, SMOOTH, trodden
import numpy as np
import pytest

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.ground.regolith.overlay import CELL_M, Overlay
from lunar_rover_sim.ground.regolith.tracks import press
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.rendering.config import DetailConfig
from lunar_rover_sim.image.rendering.labels import LABEL_DISTURBED, LABEL_GROUND
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

SMALL = CameraConfig(width=320, height=240)
LAYERS = ('left', 'depth', 'normal', 'label', 'radiance')
LOW = RoverPose(pose(z=0.15, pitch_deg=25.0))


def renderer(world, elevation_deg=6.0, azimuth_deg=90.0, **groups):
    groups.setdefault('camera', SMALL)
    return Renderer(world, ROVER, config(elevation_deg, azimuth_deg, **groups))


def surface_points(frame, state=LOW, camera=SMALL):
    """Return (h, w, 3) points [m] of the world that the left image shows."""
    rig = StereoRig(ROVER, camera)
    v, u = np.indices(frame.depth_m.shape)
    K = rig.K
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    T = state.T_world_base @ rig.T_base_left
    return frame.depth_m[..., None] * (rays @ T[:3, :3].T) + T[:3, 3]


@pytest.fixture(scope='module')
def scene():
    """Return a rough world, its overlay, and a frame of the tracks."""
    n = 257
    y, x = np.indices((n, n)) * 0.025
    world = plane(n, heights=0.02 * np.sin(3.0 * x) * np.cos(2.0 * y), far=False)
    overlay = trodden(world)
    with renderer(world) as drawn:
        drawn.follow(overlay)
        frame = drawn.render(LOW, 0, LAYERS)
    return world, overlay, frame


def test_depth_of_prints_is_that_of_the_overlay(scene):
    world, overlay, frame = scene
    points = surface_points(frame)
    near = np.isfinite(frame.depth_m) & (frame.depth_m < 1.2)
    xy = points[near][:, :2]
    change = overlay.height_change(xy)
    error = points[near][:, 2] - world.ground.height_at(xy) - change
    assert (change < -0.006).sum() > 150     # the prints are in view
    # Between samples the overlay is bilinear, the mesh two triangles: they differ in hollow cells.
    inside = np.abs(error[np.abs(change) > 1e-5])
    assert np.percentile(inside, 99.5) < 1e-3
    assert np.median(inside) < 1e-4
    assert inside.max() < 2e-3


def test_labels_and_normals_are_those_of_disturbed_ground(scene):
    world, overlay, frame = scene
    near = np.isfinite(frame.depth_m) & (frame.depth_m < 1.2)
    xy = surface_points(frame)[near][:, :2]
    disturbed = np.abs(overlay.height_change(xy)) > 2e-3
    untouched = np.abs(overlay.height_change(xy)) < 1e-5
    label = frame.label[near]
    assert (label[disturbed] == LABEL_DISTURBED).mean() > 0.99
    assert (label[untouched] == LABEL_GROUND).mean() > 0.99
    d = CELL_M
    slope = np.stack([(overlay.height_change(xy + e) - overlay.height_change(xy - e)
                       + world.ground.height_at(xy + e) - world.ground.height_at(xy - e))
                      / (2.0 * d) for e in (np.array([d, 0.0]), np.array([0.0, d]))], axis=-1)
    normal = np.concatenate([-slope, np.ones((len(xy), 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(np.sum(normal * frame.normal[near], -1), -1, 1)))
    assert np.median(angle[disturbed]) < 3.0


def test_a_ridge_casts_its_shadow():
    """A ridge of 1 cm under a sun of 6 degrees throws a shadow of 1 cm / tan 6 deg = 9.5 cm."""
    world, overlay = plane(257, far=False), Overlay()
    height = np.zeros((60, 6))
    height[:, 2:4] = 0.01
    overlay.put(100, -30, height, np.zeros_like(height))
    with renderer(world, azimuth_deg=0.0) as drawn:      # the sun stands in +x
        drawn.follow(overlay)
        frame = drawn.render(LOW, 0, LAYERS)
    xyz = surface_points(frame)
    row = (np.abs(xyz[..., 1]) < 0.05) & (xyz[..., 0] > 0.35) & (xyz[..., 0] < 0.505)
    dark = frame.radiance[row] < 0.2 * np.median(frame.radiance[frame.label == LABEL_GROUND])
    ends = xyz[row][dark][:, 0].min()
    length = 0.51 - ends
    assert length == pytest.approx(0.01 / math.tan(math.radians(6.0)), abs=0.008)


def test_relief_below_the_grid_is_pressed_flat():
    """A trodden square of soil has no contrast, the ground around it has."""
    world, overlay = plane(257, far=False), Overlay()
    size = 60
    overlay.put(90, -30, np.full((size, size), -0.01), np.full((size, size), 0.01))
    with renderer(world, sun=RELIEF_SUN, detail=DetailConfig(bounce=False)) as drawn:
        before = drawn.render(LOW, 0, LAYERS).radiance
        drawn.follow(overlay)
        frame = drawn.render(LOW, 0, LAYERS)
    xyz = surface_points(frame)
    inside = ((np.abs(xyz[..., 0] - 0.6) < 0.1) & (np.abs(xyz[..., 1]) < 0.1)
              & (frame.label == LABEL_DISTURBED))[:, 1:]
    assert inside.sum() > 500
    contrast = np.abs(np.diff(frame.radiance))[inside].mean()
    assert contrast < 0.05 * np.abs(np.diff(before))[inside].mean()


def test_untouched_ground_is_drawn_as_rigid_ground_bit_by_bit():
    world = plane(257)
    with renderer(world, sun=RELIEF_SUN, detail=DetailConfig()) as drawn:
        rigid = drawn.render(LOW, 0, LAYERS)
        drawn.follow(Overlay())
        empty = drawn.render(LOW, 0, LAYERS)
    for layer in ('left', 'depth_m', 'label', 'normal', 'radiance'):
        np.testing.assert_array_equal(getattr(rigid, layer), getattr(empty, layer))


def test_who_comes_late_draws_the_same_and_the_sun_may_move():
    """New prints are drawn in the next frame; another renderer draws them as well."""
    world = plane(257, far=False)
    overlay = trodden(world, 4)
    with renderer(world, 10.0, 40.0) as early:
        early.follow(overlay)
        early.render(LOW, 0, LAYERS)
        more = trodden(world, 4, 0.55, seed=5)
        overlay.apply(more.snapshot())
        early.set_sun(200.0, 5.0)
        first = early.render(LOW, 1, LAYERS)
        with pytest.raises(RenderError, match='follows an overlay already'):
            early.follow(overlay)
    with renderer(world, 5.0, 200.0) as late:
        late.follow(overlay)
        second = late.render(LOW, 1, LAYERS)
    for layer in ('depth_m', 'label', 'normal', 'radiance'):
        np.testing.assert_array_equal(getattr(first, layer), getattr(second, layer))


def test_tracks_stay_where_they_are_as_the_rover_drives_on():
    """The windows wrap around: prints 8 m away do not appear here, and old ones come back."""
    world = plane(513)
    overlay = trodden(world, 4)
    far = RoverPose(pose(x=4.0, z=0.15, pitch_deg=25.0))
    with renderer(world, detail=SMOOTH) as drawn:
        drawn.follow(overlay)
        here = drawn.render(LOW, 0, LAYERS)
        there = drawn.render(far, 0, LAYERS)
        again = drawn.render(LOW, 0, LAYERS)
        assert not (there.label == LABEL_DISTURBED).any()
        back = drawn.render(RoverPose(pose(x=-4.0, z=0.15, pitch_deg=25.0)), 0, LAYERS)
        assert not ((back.label == LABEL_DISTURBED) & (back.depth_m < 3.0)).any()
    np.testing.assert_array_equal(here.radiance, again.radiance)


def test_tracks_that_were_seen_before_change_nothing(scene):
    """Rays pass above prints that are below the image, and were drawn when they were in it."""
    world, overlay = scene[0], Overlay()
    for x, y in np.stack(np.meshgrid(np.arange(0.1, 0.6, 0.03), np.arange(-0.3, 0.4, 0.05)),
                         axis=-1).reshape(-1, 2):
        z = world.ground.height_at_point(x, y)
        press(overlay, world.ground, (x, y, z + 0.012), (x, y, z - 0.01), 0.012, 0.5)
    behind = RoverPose(pose(x=-0.5, z=0.15, pitch_deg=15.0))
    states = [RoverPose(pose(x=x, y=0.04, z=0.088)) for x in np.arange(0.0, 0.2, 0.02)]
    found = []
    for before in ([behind], []):
        with renderer(world) as drawn:
            drawn.follow(overlay)
            for state in before:
                drawn.render(state, 0, ('depth',))
            found.append([drawn.render(state, 0, ('depth',)).layer('depth') for state in states])
    np.testing.assert_array_equal(*found)
