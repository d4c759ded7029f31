"""Sunlight: shadows where geometry puts them, penumbrae as wide as the disc makes them."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lunar_rover_sim.ground.world import fine_relief
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination import rock_shadow
from lunar_rover_sim.image.illumination.hapke import reflectance, SETS
from lunar_rover_sim.image.illumination.horizon import shadow_levels, ShadowLevel, SunGeometry
from lunar_rover_sim.image.illumination.sunlight import indirect_light
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

RADIUS = np.radians(0.533 / 2)
SMALL = CameraConfig(width=320, height=240)


def sun(azimuth_deg, elevation_deg):
    return SunGeometry(np.radians(azimuth_deg), np.radians(elevation_deg))


def visibility_along(grid, clearance, occluder, start, heading, reach):
    """Return distances and the share of the disc seen along a line on the ground."""
    r = np.arange(0.1, reach, 0.002)
    xy = np.asarray(start) + r[:, None] * heading
    rows = (xy / grid.cell_m + 0.5 * (grid.n - 1))[:, ::-1].T
    c = map_coordinates(clearance, rows, order=1)
    t = map_coordinates(occluder, rows, order=1)
    x = np.clip(c / t / RADIUS, -1.0, 1.0)      # the area of a disc above a chord
    return r, 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi


@pytest.mark.parametrize('azimuth_deg', [0.0, 37.0, 90.0, 200.0, 333.0])
@pytest.mark.parametrize('elevation_deg', [2.0, 6.0, 20.0])
def test_shadow_of_a_pole_in_the_grid(azimuth_deg, elevation_deg):
    n, cell, height, half = 1025, 0.025, 0.3, 2
    z = np.zeros((n, n), np.float32)
    z[512 - half:513 + half, 512 - half:513 + half] = height
    grid = HeightGrid(z, cell)
    s = sun(azimuth_deg, elevation_deg)
    clearance, occluder = ShadowLevel(grid, s, None).clearance()
    # The last edge on the way: half the pole, seen along the sun's azimuth.
    edge = half * cell / np.abs(s.direction_xy).max()
    e = np.radians(elevation_deg)
    length = height / np.tan(e)
    r, seen = visibility_along(grid, clearance, occluder, (0.0, 0.0), -s.direction_xy,
                               min(height / np.tan(e - RADIUS) + 0.4, 12.4))
    assert r[np.argmax(seen > 0.5)] == pytest.approx(length - edge, abs=cell) or \
        r[np.argmax(seen > 0.5)] == pytest.approx(length + edge, abs=cell)
    begin, end = r[np.argmax(seen > 0.02)], r[np.argmax(seen > 0.98)]
    wide = height / np.tan(e - RADIUS) - height / np.tan(e + RADIUS)
    # 2 % to 98 % of the light is 91 % of the disc's diameter.
    assert end - begin == pytest.approx(0.91 * wide, rel=0.1, abs=1.5 * cell)


@pytest.mark.parametrize('azimuth_deg', [10.0, 45.0, 120.0, 260.0])
def test_shadow_of_a_wall_at_any_azimuth(azimuth_deg):
    n, cell, height, e = 1025, 0.025, 0.4, 5.0
    axis = (np.arange(n) - 512) * cell
    s = sun(azimuth_deg, e)
    along = axis[None] * s.direction_xy[0] + axis[:, None] * s.direction_xy[1]
    grid = HeightGrid((height * np.clip(1.6 - np.abs(along) / 0.1, 0, 1)).astype(np.float32), cell)
    clearance, occluder = ShadowLevel(grid, s, None).clearance()
    length = height / np.tan(np.radians(e))
    r, seen = visibility_along(grid, clearance, occluder, (0.0, 0.0), -s.direction_xy,
                               length + 0.5)
    # The crest, 6 cm from the middle, may lie between samples on the way.
    assert r[(r > 1.0)][np.argmax(seen[r > 1.0] > 0.5)] == pytest.approx(length + 0.06,
                                                                         abs=3 * cell)


def test_far_relief_blocks_a_low_sun():
    n = 257
    far = np.zeros((n, n), np.float32)
    far[:, 240] = 40.0                       # a ridge 180 m east of the middle, 40 m high
    levels = [HeightGrid(np.zeros((n, n), np.float32), 0.05),
              HeightGrid(far, 180.0 / 112)]
    for elevation_deg, dark in ((10.0, True), (15.0, False)):
        clearance, _ = shadow_levels(levels, sun(0.0, elevation_deg))[0].clearance()
        assert np.all((clearance < 0.0) == dark)


@pytest.mark.parametrize('azimuth_deg', [0.0, 25.0, 140.0])
def test_edge_of_a_rock_shadow_is_analytic(azimuth_deg):
    """The side of the shadow of a pole, between samples, to a fraction of a millimetre."""
    s = sun(azimuth_deg, 8.0)
    half = 0.1
    shape = scene.block(half=(half, half, 0.4))
    grid = HeightGrid(np.zeros((401, 401), np.float32), 0.025)
    outline = rock_shadow.silhouettes(scene.rocks([(0.0, 0.0, 0.3)]), (shape,), s)
    clearance, occluder = ShadowLevel(grid, s, None).clearance()
    rock_shadow.stamp(clearance, occluder, grid, outline, s)
    side = np.array([-s.direction_xy[1], s.direction_xy[0]])
    width = half * (abs(side[0]) + abs(side[1]))
    for back in np.arange(0.6, 3.0, 0.037):
        offset = np.arange(width - 0.03, width + 0.03, 0.0005)
        xy = -back * s.direction_xy + offset[:, None] * side
        rows = (xy / 0.025 + 200)[:, ::-1].T
        angle = map_coordinates(clearance, rows, order=1) / map_coordinates(occluder, rows,
                                                                            order=1)
        edge = offset[np.argmax(angle > 0.0)]
        assert edge == pytest.approx(width, abs=0.0015)


@pytest.mark.parametrize('elevation_deg', [3.0, 6.0, 20.0])
def test_shadow_of_a_pole_ends_where_it_must(elevation_deg):
    """A pole of height h: at h / tan e within a cell, with the penumbra of the sun's disc."""
    cell, height, half = 0.025, 0.3, 0.05
    s = sun(25.0, elevation_deg)
    grid = HeightGrid(np.zeros((801, 801), np.float32), cell)
    pole = scene.block(half=(half, half, 0.5 * height + 0.05))
    outline = rock_shadow.silhouettes(scene.rocks([(0.0, 0.0, 0.5 * height - 0.05)]), (pole,), s)
    clearance, occluder = ShadowLevel(grid, s, None).clearance()
    rock_shadow.stamp(clearance, occluder, grid, outline, s)
    e = np.radians(elevation_deg)
    # The shadow of the top face, a square, on the line through its centre.
    edge = half / np.abs(s.direction_xy).max()
    r, seen = visibility_along(grid, clearance, occluder, (0.0, 0.0), -s.direction_xy, 9.0)
    end = r[np.flatnonzero(seen < 0.5)[-1]]
    assert end == pytest.approx(height / np.tan(e) + edge, abs=cell)
    tip = r[np.flatnonzero(seen < 0.98)[-1]] - r[np.flatnonzero(seen < 0.02)[-1]]
    wide = height / np.tan(e - RADIUS) - height / np.tan(e + RADIUS)
    assert tip == pytest.approx(0.91 * wide, rel=0.1, abs=1.5 * cell)


def pole_picture(elevation_deg, back):
    """Return the picture of a pole's shadow seen from 0.5 m, and the rig."""
    shape = scene.block(half=(0.03, 0.03, 0.4))
    world = scene.plane(stones=scene.rocks([(0.0, 0.0, 0.35)]), shape=shape)
    cfg = scene.config(elevation_deg, azimuth_deg=70.0)
    pose = scene.pose(-0.8, back, 0.5 - 0.18, pitch_deg=45.0)
    with Renderer(world, scene.ROVER, cfg) as renderer:
        frame = renderer.render(RoverPose(pose), 0, ('left', 'depth', 'radiance'))
        return frame, renderer.rig, pose, renderer.sun_direction


@pytest.mark.parametrize('elevation_deg', [5.0, 12.0])
def test_drawn_shadow_edge_follows_the_line(elevation_deg):
    """Seen from 0.5 m, within 2 px and without steps at the pitch of the grid (20 px here)."""
    frame, rig, pose, to_sun = pole_picture(elevation_deg, -0.9)
    heading = to_sun[:2] / np.linalg.norm(to_sun[:2])
    side = np.array([-heading[1], heading[0]])
    width = 0.03 * (abs(side[0]) + abs(side[1]))
    errors: dict[int, list[float]] = {-1: [], 1: []}
    for sign in (-1, 1):
        for back in np.arange(0.5, 1.6, 0.005):
            line = -back * heading + sign * side * width
            pixel = rig.project([*line, 0.0], pose)[0]
            inner = rig.project([*(line - sign * side * 0.02), 0.0], pose)[0]
            outer = rig.project([*(line + sign * side * 0.02), 0.0], pose)[0]
            if not np.all(np.isfinite(pixel)) or np.any(np.array([inner, outer]) < 2) or \
                    max(inner[0], outer[0]) > 637 or max(inner[1], outer[1]) > 477:
                continue
            steps = np.linspace(inner, outer, 200)
            value = map_coordinates(frame.radiance.astype(float), steps[:, ::-1].T, order=1)
            if value[-1] < 4.0 * value[0] + 1e-3:
                continue
            crossing = steps[np.argmax(value > 0.5 * value[-1])]
            across = (outer - inner) / np.linalg.norm(outer - inner)
            errors[sign].append(float((crossing - pixel) @ across))
    assert min(len(side) for side in errors.values()) > 60
    for side in errors.values():
        assert np.abs(side).max() < 2.0
        # Steps would move the edge by pixels within a few samples of 5 mm.
        assert np.abs(np.diff(side)).max() < 1.0
        smooth = np.convolve(side, np.ones(15) / 15, mode='valid')
        assert np.std(np.array(side)[7:-7] - smooth) < 0.25


@pytest.mark.parametrize('elevation_deg', [2.0, 10.0])
def test_plane_has_no_speckle(elevation_deg):
    with Renderer(scene.plane(), scene.ROVER, scene.config(elevation_deg)) as renderer:
        frame = renderer.render(RoverPose(scene.pose(yaw_deg=0.0)), 0,
                                ('left', 'radiance', 'depth'))
    ground = np.isfinite(frame.depth_m) & (frame.depth_m < 5.0)
    ground[:, :2] = ground[:, -2:] = False
    r = frame.radiance
    # Radiance is smooth: second differences along a row stay below a quantum of 12 bits.
    inner = ground[:, 2:] & ground[:, 1:-1] & ground[:, :-2]
    curve = np.abs(r[:, 2:] - 2 * r[:, 1:-1] + r[:, :-2])[inner]
    assert (r[ground] > 0.0).all()
    assert curve.max() < r[ground].max() / 4095


@pytest.mark.parametrize('elevation_deg', [2.0, 10.0])
def test_plane_looks_the_same_from_everywhere(elevation_deg):
    """Pixels of the same geometry are equal, wherever on the plane and its grid they fall."""
    sensor = dataclasses.replace(scene.IDEAL, encoding='mono16', companding='linear')
    with Renderer(scene.plane(), scene.ROVER,
                  scene.config(elevation_deg, sensor=sensor)) as renderer:
        frames = [renderer.render(RoverPose(scene.pose(x, y, 0.1, 20.0)), 0, ('left', 'depth'))
                  for x, y in ((0.0, 0.0), (0.0113, -0.0071), (1.3037, 0.4519), (-0.77, 2.2222))]
    near = frames[0].depth_m < 1.5
    first = frames[0].left.astype(int) >> 4
    assert first[near].min() > 0
    for frame in frames[1:]:
        assert np.abs((frame.left.astype(int) >> 4) - first)[near].max() <= 1


def test_full_shadow_is_black():
    """Far behind high walls, far from lit ground, nothing is left."""
    n = 513
    z = np.zeros((n, n), np.float32)
    # Tops too narrow to be lit: behind wider ones scattered light leaks, see the limits.
    z[:, 506:] = z[506:] = 30.0
    world = scene.plane(heights=z, far=False)
    cfg = scene.config(sun=scene.RELIEF_SUN, detail=scene.DetailConfig(bounce=True))
    with Renderer(world, scene.ROVER, cfg) as renderer:
        frame = renderer.render(RoverPose(scene.pose(yaw_deg=180.0)), 0,
                                ('left', 'radiance', 'depth'))
    assert np.isfinite(frame.depth_m).any()
    assert frame.radiance.max() < 1e-6
    assert frame.left.max() == 0


def test_tile_horizon_of_a_ridge():
    n, texel, height = 256, 0.002, 0.01
    z = np.zeros((n, n), np.float32)
    z[:, 128] = height
    tangents = np.linspace(0.0, 0.4, 9)
    tangent = fine_relief.horizon(z, texel, 0.0, tangents)
    for back in (20, 40, 70, 100):
        assert tangent[10, 128 - back] == pytest.approx(height / (back * texel), abs=0.005)
    turned = fine_relief.horizon(np.ascontiguousarray(z.T), texel, np.pi / 2, tangents)
    np.testing.assert_allclose(turned.T, tangent, atol=1e-6)


def test_bounce_of_a_lit_slope():
    """Ground before an endless lit slope receives M (1 - cos a) / 2 of its exitance M.

    a is the angle under which the top of the slope appears.
    """
    n, cell = 257, 0.1
    x = (np.arange(n) - 160) * cell
    z = np.tile(np.clip(x, 0.0, 3.0).astype(np.float32), (n, 1))
    lit = np.ones((n, n), np.float32)
    direction = np.array([-np.cos(0.1), 0.0, np.sin(0.1)])
    lit[:, 190:] = 0.0
    lit[:, :160] = 0.0
    irradiance, _ = indirect_light(z, cell, lit, direction, 0.1)
    exitance = 0.1 * np.sin(np.radians(45.0) + 0.1)
    for distance in (0.5, 1.5, 3.0):
        column = 160 - int(distance / cell)
        angle = np.arctan2(3.0, distance + 3.0)
        expected = exitance * 0.5 * (1.0 - np.cos(angle))
        # Distances in steps of 1.26 cut the dark edges of the slope off: a fifth or so.
        assert irradiance[128, column] == pytest.approx(expected, rel=0.25)
    flat, _ = indirect_light(np.zeros((n, n), np.float32), cell, lit, direction, 0.1)
    assert flat.max() == 0.0


def test_plane_is_as_bright_as_hapke_says_at_any_elevation():
    with Renderer(scene.plane(257), scene.ROVER, scene.config(6.0, camera=SMALL)) as renderer:
        T = scene.pose(0.0, 0.0, 0.1, 20.0)
        eye = -(T @ renderer.rig.T_base_left)[:3, :3] @ renderer.rig.rays()[..., None]
        eye = eye[..., 0] / np.linalg.norm(eye[..., 0], axis=2, keepdims=True)
        for elevation_deg in (-1.0, 0.0, 1.0, 30.0, 85.0, 90.0):
            renderer.set_sun(100.0, elevation_deg)
            frame = renderer.render(RoverPose(T), 0, ('radiance', 'depth'))
            near = (frame.depth_m < 0.8) & (frame.depth_m > 0.45)
            drawn = frame.radiance[near]
            assert np.all(np.isfinite(drawn)) and drawn.min() >= 0.0
            if elevation_deg < -RADIUS:
                assert drawn.max() == 0.0
            if elevation_deg < 1.0:
                continue
            to_sun = renderer.sun_direction
            expected = 1361.0 * reflectance(to_sun[2], eye[near][:, 2], eye[near] @ to_sun,
                                            SETS['highland'])
            ratio = drawn / expected
            # Some pixels lie in the shadow of the rover, a few in its penumbra.
            assert np.mean(ratio > 0.5) > 0.5
            assert np.mean(np.abs(ratio[ratio > 0.5] - 1.0) < 0.02) > 0.97
            assert ratio.max() < 1.02
