"""The rolling map: planes stay planes, whatever the pitch; wrong matches stay out."""

import dataclasses

import numpy as np
import pytest

from lunar_rover_sim.autonomy.navigation.config import MapConfig
from lunar_rover_sim.autonomy.navigation.elevation_map import ElevationMap
from lunar_rover_sim.base.errors import ConfigError, NavigationError
from lunar_rover_sim.base.frames import matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy

K = np.array([[115.0, 0.0, 79.5], [0.0, 115.0, 59.5], [0.0, 0.0, 1.0]])
BASELINE_M = 0.4
TRUSTED = MapConfig(level_stddev_m=0.0, level_stddev_deg=0.0)


def camera(x=0.0, y=0.0, z=0.28, pitch_deg=10.0, roll_deg=0.0, yaw_deg=0.0):
    R = matrix_from_wxyz(wxyz_from_rpy(*np.radians([roll_deg, pitch_deg, yaw_deg])))
    return se3(R @ R_BODY_OPTICAL, (x, y, z))


def seen(T, height=lambda x, y: 0.0 * x, fine=1):
    """Return the depth of a surface that is nearly level, by a few rounds of intersection."""
    v, u = np.mgrid[0:120 * fine, 0:160 * fine] / fine
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
    rays = rays @ T[:3, :3].T
    depth = np.full(u.shape, np.nan)
    down = rays[..., 2] < -0.1 * np.hypot(rays[..., 0], rays[..., 1])
    z = np.zeros(u.shape)
    for _ in range(30):
        depth[down] = (z[down] - T[2, 3]) / rays[down][:, 2]
        point = T[:3, 3] + np.where(down, depth, 0.0)[..., None] * rays
        z = height(point[..., 0], point[..., 1])
    return depth.astype(np.float32)


def look(mapped, T, stamp_ns, height=lambda x, y: 0.0 * x, said=None):
    said = T if said is None else said
    return mapped.add_depth(stamp_ns, seen(T, height), K, BASELINE_M, said, said[:3, 3])


def test_a_slope_is_mapped_where_it_is():
    mapped = ElevationMap(TRUSTED)
    for k in range(3):
        look(mapped, camera(), k * 10**8, lambda x, y: 0.05 * x - 0.02 * y)
    found = mapped.elevation()
    x, y = np.meshgrid(*found.centres_m)
    known = np.isfinite(found.height_m) & (np.hypot(x, y) < 3.0)
    assert np.count_nonzero(known) > 500
    # Half a cell of 5 cm on a slope of 0.05 is 1.3 mm.
    assert np.abs(found.height_m - (0.05 * x - 0.02 * y))[known].max() < 3e-3
    assert not np.isfinite(found.height_m[:, x[0] < -0.1]).any()      # behind it nothing is known


def test_pitch_and_height_of_a_wrong_pose_are_taken_out():
    """A body that pitches by some degrees, with a pose that does not say so: the map is level."""
    rng, errors = np.random.default_rng(1), []
    for config in (TRUSTED, MapConfig()):
        mapped = ElevationMap(config)
        for k in range(40):
            true = camera(x=0.02 * k)
            said = true
            if k > 5:
                said = camera(x=0.02 * k, z=0.28 + 0.01 * rng.standard_normal(),
                              pitch_deg=10.0 + 0.8 * rng.standard_normal(),
                              roll_deg=0.8 * rng.standard_normal())
            look(mapped, true, k * 10**8, said=said)
        height = mapped.elevation().height_m
        errors.append(float(np.sqrt(np.nanmean(height ** 2))))
    assert errors[1] < 0.35 * errors[0]
    assert errors[1] < 0.01


def test_small_errors_of_each_frame_do_not_add_up():
    """A way of 40 m over a plain, seen a little bent: the map stays where the poses are."""
    mapped, rng = ElevationMap(MapConfig()), np.random.default_rng(2)
    for k in range(200):
        points = np.column_stack([rng.uniform(0.4, 4.0, 4000), rng.uniform(-1.5, 1.5, 4000),
                                  np.zeros(4000)])
        points[:, 2] = 0.004 * (points[:, 0]**2 + points[:, 1]**2) - 0.3
        T = np.eye(4)
        T[0, 3], T[2, 3] = 0.2 * k, 0.3
        mapped.add_points(2 * 10**9 * k, points, T, T[:3, 3])
    found = mapped.elevation()
    x, y = np.meshgrid(*found.centres_m)
    near = np.isfinite(found.height_m) & (np.hypot(x - 39.8, y) < 2.0)
    tilt = np.polyfit(x[near], found.height_m[near], 1)[0]
    assert near.sum() > 500
    assert abs(np.degrees(tilt)) < 1.5 and np.abs(found.height_m[near]).max() < 0.15


def test_wrong_matches_do_not_enter_a_known_cell_but_a_lasting_change_does():
    mapped = ElevationMap(TRUSTED)
    T = camera()
    for k in range(6):
        look(mapped, T, k * 10**8)
    depth = seen(T)
    # A patch of matches that are 40 % too near stands over the ground.
    depth[85:100, 60:90] *= 0.6
    mapped.add_depth(6 * 10**8, depth, K, BASELINE_M, T, T[:3, 3])
    assert np.nanmax(np.abs(mapped.elevation().height_m)) < 0.02     # the patch stands 0.11 m high
    raised = seen(T, lambda x, y: 0.12 + 0.0 * x)
    for k in range(7, 20):
        mapped.add_depth(k * 10**8, raised, K, BASELINE_M, T, T[:3, 3])
    near = mapped.elevation().height_m[128:130, 145:160]
    assert np.nanmedian(near) == pytest.approx(0.12, abs=0.01)


def test_depth_smeared_around_a_block_is_stated_as_doubtful():
    """A matcher gives the ground around a block its depth, half a window wide, in every frame."""
    mapped = ElevationMap(TRUSTED)
    for k in range(20):
        T = camera(x=0.01 * k)
        depth = seen(T)
        # A rock from 1.2 m on, 19 px to both sides, is matched 6 px wider.
        face = 1.2 - 0.01 * k + 0.02 * np.arange(16.0)[::-1, None]
        depth[52:68, 55:105] = np.fmin(depth[52:68, 55:105], face)
        mapped.add_depth(k * 10**8, depth, K, BASELINE_M, T, T[:3, 3])
    found = mapped.elevation()
    x, y = np.meshgrid(*found.centres_m)
    error = np.abs(found.height_m)      # of the ground beside the rock, which is level
    wrong = (error > 0.03) & (np.abs(y) > 0.18 * x)
    assert wrong.sum() >= 6
    # It is far beyond the errors of depth, which average out, and within those that do not.
    assert (error[wrong] > 3.0 * np.sqrt(found.variance_m2[wrong])).all()
    assert (error[wrong] < 3.0 * np.sqrt(found.doubt_m2[wrong])).all()
    # Level ground far from it has a share of the errors of depth.
    level = np.isfinite(found.height_m) & (np.abs(y) > 0.6) & (x < 2.0)
    assert 0.0 < np.sqrt(found.doubt_m2[level]).max() < 0.01
    assert np.all(found.stddev_m()[level] ** 2 > found.doubt_m2[level])


def test_a_cell_is_known_after_three_frames():
    """Two wrong matches in a shadow, where nothing contradicts them, agree now and then."""
    mapped = ElevationMap(TRUSTED)
    for k in range(2):
        look(mapped, camera(), k * 10**8)
        assert not np.isfinite(mapped.elevation().height_m).any()
    look(mapped, camera(), 2 * 10**8)
    assert np.isfinite(mapped.elevation().height_m).any()


def test_the_map_rolls_with_the_rover():
    mapped = ElevationMap(MapConfig(size_m=6.4, level_stddev_m=0.0, level_stddev_deg=0.0))

    def bump(x, y):
        return 0.05 * np.exp(-((x - 2.0) ** 2 + (y - 0.3) ** 2) / 0.3)

    for k in range(60):
        look(mapped, camera(x=0.025 * k, y=-0.01 * k), k * 10**8, bump)
    found = mapped.elevation()
    x, y = found.centres_m
    # It is around the rover, and the bump is where it was.
    assert np.abs(found.origin_m + 3.2 - [0.025 * 59, -0.59]).max() < 0.45
    row, column = np.unravel_index(np.nanargmax(found.height_m), found.height_m.shape)
    assert (x[column], y[row]) == pytest.approx((2.0, 0.3), abs=0.11)


def test_a_pose_that_jumps_begins_the_map_anew():
    mapped = ElevationMap(TRUSTED)
    for k in range(3):
        assert not look(mapped, camera(x=0.02 * k), k * 10**8)
    assert look(mapped, camera(x=1.2), 3 * 10**8)
    assert mapped.begun_anew == 1
    assert not np.isfinite(mapped.elevation().height_m).any()       # one frame only
    # So does time that goes back.
    assert look(mapped, camera(x=1.2), 0)


@pytest.mark.parametrize('hole_px, clean', [(8.0, True), (4.0, False), (0.0, False)])
def test_depth_beside_a_hole_of_the_matcher_is_not_used(hole_px, clean):
    """Around a shadow without depth two pixels, of 160, have the depth of its near side."""
    depth = seen(camera())
    depth[70:90, 60:100] = depth[90, 80]
    depth[72:88, 62:98] = np.nan
    mapped = ElevationMap(dataclasses.replace(TRUSTED, hole_px=hole_px))
    for k in range(3):
        mapped.add_depth(k * 10**8, depth, K, BASELINE_M, camera(), camera()[:3, 3])
    height = mapped.elevation().height_m
    assert np.count_nonzero(np.isfinite(height)) > 500
    assert (np.nanmax(np.abs(height)) < 3e-3) == clean


@pytest.mark.parametrize('baseline_m, clean', [(BASELINE_M, True), (0.0, False)])
def test_ground_behind_a_front_is_not_known_by_depth_that_bleeds_over_its_edge(baseline_m, clean):
    """Between the front and the hole that the matcher leaves beside it, depth slides to far.

    Depth that was not matched does not bleed: there it is what it is.
    """
    T, K2 = camera(), K * [[2.0], [2.0], [1.0]]
    ground = seen(T, fine=2)
    depth, hidden = ground.copy(), ground > 1.2
    edge = 120
    depth[:, edge:][hidden[:, edge:]] = 1.2
    for off in (1, 2, 3):
        behind = hidden[:, edge - off]
        share = off / 4.0
        depth[behind, edge - off] = 1.0 / (
            (1.0 - share) / 1.2 + share / ground[behind, edge - off])
    depth[:, edge - 14:edge - 3][hidden[:, edge - 14:edge - 3]] = np.nan
    mapped = ElevationMap(TRUSTED)
    for k in range(3):
        mapped.add_depth(k * 10**8, depth, K2, baseline_m, T, T[:3, 3])
    found = mapped.elevation()
    x, y = np.meshgrid(*found.centres_m)
    column = K2[0, 2] - K2[0, 0] * y / np.hypot(x, 0.28)
    hidden = (x > 1.35) & (column > edge - 10)
    assert (found.height_m[hidden & np.isfinite(found.height_m)] > 0.02).any() != clean
    assert not np.isfinite(found.height_m[hidden & (column > edge + 5)]).any()
    # Beside it the ground stays known, as far as before.
    beside = (x > 1.35) & (x < 1.8) & (column < edge - 24) & (column > 10)
    assert np.isfinite(found.height_m[beside]).mean() > 0.9
    assert np.nanmax(np.abs(found.height_m[beside])) < 3e-3


def test_points_of_a_lidar_give_the_same_map():
    mapped = ElevationMap(TRUSTED)
    x, y = np.meshgrid(np.arange(0.5, 3.0, 0.04), np.arange(-1.0, 1.0, 0.04))
    points = np.stack([x, y, np.full(x.shape, -0.3)], axis=-1)
    for k in range(3):
        mapped.add_points(k * 10**8, points, se3(np.eye(3), (0.0, 0.0, 0.3)), (0.0, 0.0, 0.1))
    height = mapped.elevation().height_m
    assert np.count_nonzero(np.isfinite(height)) > 1500
    assert np.nanmax(np.abs(height)) < 1e-4


@pytest.mark.parametrize('values, text', [
    ({'depth_m': np.zeros((4, 4))}, 'float64'),
    ({'T_map_camera': np.full((4, 4), np.nan)}, 'T_map_camera'),
    ({'position_m': (0.0, np.inf, 0.0)}, 'position_m')])
def test_what_is_no_depth_or_pose_is_refused(values, text):
    given = {'depth_m': np.ones((4, 4), np.float32), 'T_map_camera': np.eye(4),
             'position_m': (0.0, 0.0, 0.0), **values}
    with pytest.raises(NavigationError, match=text):
        ElevationMap(TRUSTED).add_depth(0, given['depth_m'], K, BASELINE_M,
                                        given['T_map_camera'], given['position_m'])


def test_a_map_before_its_first_frame_and_odd_sizes_are_refused():
    with pytest.raises(NavigationError, match='nothing yet'):
        ElevationMap(TRUSTED).elevation()
    with pytest.raises(ConfigError, match='even number'):
        MapConfig(size_m=12.83)
    with pytest.raises(ConfigError, match='min_range_m'):
        MapConfig(min_range_m=6.0)


def test_depth_without_anything_to_see_leaves_the_map_as_it_is():
    mapped = ElevationMap(TRUSTED)
    for k in range(3):
        look(mapped, camera(), k * 10**8)
    before = mapped.elevation().height_m
    for value in (np.nan, np.inf, 0.0, 100.0):
        mapped.add_depth(4 * 10**8, np.full((120, 160), value, np.float32), K, BASELINE_M,
                         camera(), camera()[:3, 3])
    np.testing.assert_array_equal(mapped.elevation().height_m, before)
