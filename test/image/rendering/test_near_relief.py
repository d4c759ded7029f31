"""Relief below the grid is shape near the cameras: one set of heights for depth and shadow."""

import dataclasses

import camera_scene as scene
import cv2
import numpy as np
import pytest
from relief_place import bilinear, places
from repetition import features, inliers

from lunar_rover_sim.base.frames import sun_direction
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.illumination import hapke
from lunar_rover_sim.image.illumination.config import LampConfig
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.image.rendering.relief_tiles import start_tiles
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

DETAIL = DetailConfig(relief_shape_m=2.5, bounce=False, smooth_outlines=False)
SUN = scene.SunConfig(azimuth_deg=0.0, elevation_deg=15.0)
YAWS_DEG = (180.0, 150.0)       # away from the sun
NEAR_M = 1.9                    # all relief is shape up to here


class Heights:
    """The relief below the grid, looked up in the tiles as relief_rows.py does."""

    def __init__(self, seed):
        sun = sun_direction(SUN.azimuth_deg, SUN.elevation_deg)
        tiles = start_tiles(DETAIL, seed, sun).result()
        self.tiles = tiles.coarse, tiles.fine
        self.top_m = sum(float(tile.heights.max()) for tile in self.tiles)
        self.salience = tiles.coarse.codes[0][..., 3].astype(np.float32) / 255.0

    def __call__(self, xy):
        """Return (n,) heights at (n, 2) places [m]."""
        p, own, next_one, lead = places(xy)
        period = [tile.period_m for tile in self.tiles]
        other = np.zeros(len(xy))
        k = np.flatnonzero(lead < 7.0 / 6.0)    # salience is 0 to 1: it changes nothing beyond
        lead = lead[k] + (bilinear(self.salience, p[k] / period[0] + own[k, :2])
                          - bilinear(self.salience, p[k] / period[0] + next_one[k, :2]))
        other[k] = np.clip(0.5 - 3.0 * lead, 0.0, 1.0)
        height = np.zeros(len(xy))
        for share, shift in ((1.0 - other, own), (other, next_one)):
            k = np.flatnonzero(share)
            for n, tile in enumerate(self.tiles):
                at = p[k] / period[n] + shift[k, 2 * n:2 * n + 2]
                height[k] += share[k] * bilinear(tile.heights, at)
        return height


@pytest.fixture(scope='module')
def views():
    """Return of some pixels of views: depth, that by rays, radiance and that of the law, phase,
    and whether rays to the sun are free."""
    config = scene.config(detail=DETAIL, sun=SUN, camera=CameraConfig(640, 480))
    result = []
    with Renderer(scene.plane(257, far=False), scene.ROVER, config, 1) as renderer:
        heights = Heights(1)
        for yaw_deg in YAWS_DEG:
            state = RoverPose(scene.pose(yaw_deg=yaw_deg))
            frame = renderer.render(state, 0, ('radiance', 'depth', 'shadow', 'normal'))
            T = state.T_world_base @ renderer.rig.T_base_left
            result.append(looked_up(frame, renderer.rig.rays(), T, heights, config))
    return result, renderer.rig


def looked_up(frame, rays, T, heights, config):
    """Return what is drawn of some pixels, and what rays against the heights find there."""
    rng = np.random.default_rng(0)
    points = frame.depth_m[..., None] * (rays @ T[:3, :3].T) + T[:3, 3]
    away = np.hypot(*(points[..., :2] - T[:2, 3]).transpose(2, 0, 1))
    # Shadow of the relief within that of the rover is marked as the relief's own.
    of_rover = cv2.dilate((frame.shadow[..., 1] > 0).astype(np.uint8),
                          np.ones((13, 13), np.uint8))
    chosen = np.nonzero((away < NEAR_M) & (of_rover == 0))
    pick = rng.choice(len(chosen[0]), 24000, replace=False)
    chosen = chosen[0][pick], chosen[1][pick]
    ray, depth = (rays @ T[:3, :3].T)[chosen], frame.depth_m[chosen]
    # From above all relief on, in steps of 1 mm of height and less than 4 mm along the ground.
    step = np.minimum(0.001 / -ray[:, 2], 0.004 / np.hypot(*ray[:, :2].T))
    t = (heights.top_m - T[2, 3]) / ray[:, 2]
    met = np.full(len(t), np.nan)
    active = np.arange(len(t))
    for _ in range(600):
        place = T[:3, 3] + t[active, None] * ray[active]
        hit = place[:, 2] <= heights(place[:, :2])
        met[active[hit]] = t[active[hit]]
        active = active[~hit]
        t[active] += step[active]
    above = met - step
    for _ in range(16):
        middle = 0.5 * (above + met)
        place = T[:3, 3] + middle[:, None] * ray
        inside = place[:, 2] <= heights(place[:, :2])
        above, met = np.where(inside, above, middle), np.where(inside, middle, met)
    met = above                 # halved until what is left of the step casts no shadow
    sun = sun_direction(SUN.azimuth_deg, SUN.elevation_deg)
    free = np.ones(len(t), bool)
    place = T[:3, 3] + met[:, None] * ray
    for along in np.arange(0.001, 0.16, 0.001):
        k = np.flatnonzero(free & (place[:, 2] + along * sun[2] < heights.top_m))
        q = place[k] + along * sun
        free[k] = q[:, 2] > heights(q[:, :2])
    view = -ray / np.linalg.norm(ray, axis=1, keepdims=True)
    law = brightness(np.array([[0.0, 0.0]]), view, sun, config)
    lit = free * brightness(slopes(heights, place), view, sun, config)
    slope = slopes(heights, T[:3, 3] + depth[:, None] * ray)
    phase_deg = np.degrees(np.arccos(np.clip(view @ sun, -1.0, 1.0)))
    return dict(depth=depth, met=met, lit=lit, radiance=frame.radiance[chosen], law=law,
                phase_deg=phase_deg, height=place[:, 2], normal=frame.normal[chosen], slope=slope)


def slopes(heights, place):
    """Return the (n, 2) slopes at (n, 3) places, over 6 mm."""
    return np.column_stack([heights(place[:, :2] + apart) - heights(place[:, :2] - apart)
                            for apart in (0.003 * np.eye(2))]) / 0.006


def brightness(slope, view, sun, config):
    """Return the (n,) radiance in sunlight of (n, 2) slopes seen from (n, 3) unit vectors."""
    normal = np.column_stack([-slope, np.ones(len(slope))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mu_0, mu = normal @ sun, (normal * view).sum(axis=1)
    return (mu_0 > 0.0) * config.sun.irradiance * hapke.reflectance(
        np.maximum(mu_0, 1e-6), np.maximum(mu, 1e-3), view @ sun,
        hapke.parameter_set(config.reflectance.ground), albedo=config.reflectance.albedo_scale)


def joined(views, name):
    return np.concatenate([view[name] for view in views[0]])


def test_disparity_is_that_of_the_heights(views):
    """At 640 x 480, of three quarters of the pixels, and of those on pebbles.

    At silhouettes, on the far rims of pits above all, a pixel shows one of two places.
    """
    _, rig = views
    met, height = joined(views, 'met'), joined(views, 'height')
    error = rig.focal_px * rig.baseline_m * np.abs(1.0 / joined(views, 'depth') - 1.0 / met)
    pebbles, pits = height > 0.006, height < -0.005
    for some in (np.ones(len(met), bool), pebbles):
        assert np.percentile(error[some], 75) < 0.1
    assert np.median(error[pits]) < 0.1 and pits.sum() > 500 and pebbles.sum() > 150


def test_normals_are_those_of_the_heights(views):
    """Slopes over 6 mm: of the map that is drawn, whose texels are of 3 mm."""
    normal, slope = joined(views, 'normal'), joined(views, 'slope')
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0, abs=1e-3)
    error = np.linalg.norm(-normal[:, :2] / normal[:, 2:] - slope, axis=1)
    assert np.median(error) < 0.4 * np.median(np.linalg.norm(slope, axis=1))
    for axis in range(2):
        assert np.corrcoef(-normal[:, axis] / normal[:, 2], slope[:, axis])[0, 1] > 0.93


def test_ground_hides_its_shadows_away_from_the_sun(views):
    """Dark ground by phase angle is what rays and slopes find, within 1.5 points (0.1 to 1.0).

    Texels of shadow are means. Without shape 8 % were dark at 1.5 to 3 deg. The mean is that of
    the law without a factor.
    """
    phase_deg, lit = joined(views, 'phase_deg'), joined(views, 'lit')
    radiance, law = joined(views, 'radiance'), joined(views, 'law')
    dark, found = radiance < 0.25 * law, lit < 0.25 * law
    for low, high in ((1, 3), (3, 6), (6, 10), (10, 15), (15, 20), (20, 25)):
        some = (phase_deg >= low) & (phase_deg < high)
        assert some.sum() > 100
        assert abs(dark[some].mean() - found[some].mean()) < 0.015
        assert radiance[some].mean() / law[some].mean() == pytest.approx(1.0, abs=0.08)


LAMP = LampConfig(power_w=20.0, position_m=(0.15, 0.08, 0.08), pitch_deg=0.0, cone_deg=60.0)
NO_SUN = scene.SunConfig(irradiance=0.0)


def under_the_lamp(shape_m):
    """Return world points of near pixels of level ground, their radiance, and the lamp's place."""
    detail = dataclasses.replace(DETAIL, relief_shape_m=shape_m)
    config = scene.config(detail=detail, sun=NO_SUN, lamp=LAMP, camera=CameraConfig(640, 480))
    with Renderer(scene.plane(257, far=False), scene.ROVER, config, 1) as renderer:
        state = RoverPose(scene.pose(yaw_deg=180.0))
        frame = renderer.render(state, 0, ('radiance', 'depth'))
        T = state.T_world_base @ renderer.rig.T_base_left
        points = frame.depth_m[..., None] * (renderer.rig.rays() @ T[:3, :3].T) + T[:3, 3]
    lamp = state.T_world_base[:3, :3] @ np.array(LAMP.position_m) + state.T_world_base[:3, 3]
    return points, frame.radiance, lamp


def test_pebbles_cast_shadows_under_the_lamp():
    """Behind the highest pebbles, away from the lamp, it is dark as far as rays say, not before
    them; rays to a lamp beside it say otherwise, and so do shadows of half the length."""
    place, light, lamp, heights = near_the_lamp(2.5)
    ground = heights(place[:, :2])
    beside, higher = lamp + (0.0, 1.5, 0.0), lamp + (0.0, 0.0, 0.15)
    said, turned, shorter = (free_of_relief(place[:, :2], ground, at, heights)
                             for at in (lamp, beside, higher))
    dark = light < 0.1 * np.median(light)
    assert (~said).mean() > 0.01
    hit = dark[~said].mean()
    assert hit > 0.75 and dark[~turned].mean() < 0.5
    # Slopes that face away, and edges; before the lamp's map had the relief, pits were black.
    assert dark[said].mean() < 0.035
    # Under a lamp of twice the height shadows would be shorter: their ends are dark, too.
    assert dark[shorter & ~said].mean() > 0.7


def test_painted_relief_casts_none_under_the_lamp():
    """The lit faces before them cannot be seen, so black spots would stand alone."""
    place, light, lamp, heights = near_the_lamp(0.0)
    said = free_of_relief(place[:, :2], heights(place[:, :2]), lamp, heights)
    assert (light[~said] < 0.1 * np.median(light)).mean() < 0.5


def near_the_lamp(shape_m):
    """Return points near the lamp, light that is about even on level ground, lamp and relief."""
    points, radiance, lamp = under_the_lamp(shape_m)
    away = np.hypot(*(points[..., :2] - lamp[:2]).transpose(2, 0, 1))
    near = tuple(axis[::7] for axis in np.nonzero((away > 0.6) & (away < 1.4)))
    return points[near], radiance[near] * away[near]**3, lamp, Heights(1)


def free_of_relief(xy, height, lamp, heights):
    """Return which of (n, 2) places on the relief a ray from the lamp reaches."""
    arm = lamp - np.column_stack([xy, height])
    far = np.hypot(arm[:, 0], arm[:, 1])
    free = np.ones(len(xy), bool)
    for along in np.arange(0.004, 0.16, 0.001):
        ray = height + along / far * arm[:, 2]
        k = np.flatnonzero(free & (ray < heights.top_m))
        share = (along / far[k])[:, None]
        free[k] = ray[k] > heights(xy[k] + share * arm[k, :2]) - 1e-3
    return free


ELEVATION_DEG = 12.0


def ground(**covers):
    """Return the radiance over the median of level ground with these, before the rover.

    The sun stands behind the upper edge of the image.
    """
    detail = DetailConfig(**{'relief_rms_slope': 0.0, 'pebble_cover': 0.0, 'pit_cover': 0.0,
                             'bounce': False, 'smooth_outlines': False, **covers})
    config = scene.config(ELEVATION_DEG, 0.0, detail=detail, camera=CameraConfig(480, 360, 45.0))
    with Renderer(scene.plane(257, far=False), scene.ROVER, config) as renderer:
        frame = renderer.render(RoverPose(scene.pose(z=0.5, pitch_deg=40.0)), 0, ('radiance',))
    return frame.radiance / np.median(frame.radiance)


def around_shadows(picture, away=3):
    """Return the mean radiance before and behind shadows, seen from the sun, and their share.

    Before and behind are so many pixels beyond their upper and lower edges.
    """
    dark = picture < 0.3
    inner = dark[away + 1:-away - 1]
    first = inner & ~dark[away:-away - 2]
    last = inner & ~dark[away + 2:-away]
    before = picture[1:-2 * away - 1][first]
    behind = picture[2 * away + 1:-1][last]
    return before.mean(), behind.mean(), dark.mean()


def test_level_ground_has_neither_and_rough_ground_has_shadows_too():
    assert np.all(np.abs(ground() - 1.0) < 0.35)
    assert np.mean(ground(relief_rms_slope=0.16) < 0.3) > 0.05


def test_pits_are_lit_on_the_side_away_from_the_sun():
    """The wall towards the sun is in shadow, the one that faces it is bright.

    Most pits are old, too shallow for a shadow: the bright walls of the fresh are soft, too.
    """
    before, behind, share = around_shadows(ground(pit_cover=0.16))
    assert 0.003 < share < 0.1
    assert behind > 1.15 * before and behind > 1.0


def test_pebbles_are_lit_on_the_side_towards_the_sun():
    """They cover half their cover or more, and their shadows are some times as long."""
    before, behind, share = around_shadows(ground(pebble_cover=0.035))
    assert 0.02 < share < 0.2
    assert before > 1.1 * behind and behind == pytest.approx(1.0, abs=0.15)


def test_ground_that_turns_away_has_no_specks():
    """Seen at 2 to 4 degrees, it is as bright as the mean of 4 x 4 times the pixels says, and as
    rich in contrast.
    """
    axis = (np.arange(513) - 256) * 0.05
    falling = np.tile(-np.tan(np.radians(10.0)) * np.maximum(axis - 0.5, 0.0), (513, 1))
    world = scene.plane(cell_m=0.05, heights=falling, far=False)

    def layers(times):
        config = scene.config(25.0, azimuth_deg=20.0, detail=DetailConfig(),
                              camera=CameraConfig(width=160 * times, height=120 * times))
        with Renderer(world, scene.ROVER, config) as renderer:
            frame = renderer.render(RoverPose(scene.pose()), 0, ('radiance', 'depth'))
        return frame.radiance.astype(float), frame.depth_m

    (drawn, depth), (fine, _) = layers(1), layers(4)
    mean = fine.reshape(120, 4, 160, 4).mean(axis=(1, 3))
    seen = (depth > 2.0) & (depth < 6.0)
    assert seen.sum() > 1000
    assert np.corrcoef(drawn[seen], mean[seen])[0, 1] > 0.7
    assert drawn[seen].std() == pytest.approx(mean[seen].std(), rel=0.2)
    assert drawn[seen].max() < 1.1 * mean[seen].max()
    rows = np.flatnonzero(seen.all(axis=1))[:8]
    one, other = (image[rows].reshape(8, 20, 8).mean(axis=(0, 2)) for image in (drawn, mean))
    np.testing.assert_allclose(one, other, rtol=0.05)


@pytest.mark.parametrize('elevation_deg, detail', [
    (2.0, DetailConfig(relief_rms_slope=0.02, pebble_cover=0.001, pit_cover=0.01)),
    (6.0, DetailConfig())])
def test_ground_that_the_sun_grazes_is_as_bright_as_with_finer_pixels(elevation_deg, detail):
    """On a slope where the sun stands 0.3 times as high as over level ground, within 10 %.

    With a factor that knew the sun from half its height over level ground on: 0.72 and 0.75 in
    the nearest band.
    """
    axis = (np.arange(513) - 256) * 0.05
    share = 0.3
    slope = (1.0 - share) * np.tan(np.radians(elevation_deg))
    world = scene.plane(cell_m=0.05, heights=np.tile(slope * axis, (513, 1)), far=False)

    def layers(times):
        config = scene.config(elevation_deg, azimuth_deg=0.0, detail=detail,
                              camera=CameraConfig(width=320 * times, height=240 * times))
        with Renderer(world, scene.ROVER, config) as renderer:
            frame = renderer.render(RoverPose(scene.pose(yaw_deg=90.0)), 0, ('radiance', 'depth'))
        return frame.radiance.astype(float), frame.depth_m

    (drawn, depth), (fine, _) = layers(1), layers(4)
    mean = fine.reshape(240, 4, 320, 4).mean(axis=(1, 3))
    for near, far in ((0.5, 1.0), (1.0, 2.0), (2.0, 4.0)):
        seen = (depth > near) & (depth < far)
        assert seen.sum() > 1000
        assert abs(drawn[seen].mean() / mean[seen].mean() - 1.0) < 0.1


AWAY_M = [(6.4, 0.0), (0.0, 6.4), (5.1, 0.0), (0.0, 5.1), (1.6, 0.0), (0.0, -3.2), (1.0, 0.0),
          (0.5, 0.866025), (12.8, 0.0), (-9.3, 14.1)]


def test_distant_views_match_no_better_than_other_worlds():
    """The same place 0.1 m further on shows that the matcher would find a repetition."""
    config = RenderConfig(sun=scene.SunConfig(azimuth_deg=60.0, elevation_deg=6.0),
                          sensor=SensorConfig(exposure_mode='auto'))
    world = scene.plane(n=513, cell_m=0.1)

    def pictures(seed):
        with Renderer(world, scene.ROVER, config, seed) as renderer:
            return [features(renderer.render(RoverPose(scene.pose(x, y, 0.09)), 0, ('left',)).left)
                    for x, y in [(0.0, 0.0), (0.0, 0.0), (0.1, 0.0), *AWAY_M]]
    here, there = pictures(1), pictures(2)
    assert inliers(here[1], here[2]) > 100
    same = [inliers(here[1], picture) for picture in here[3:]]
    other = [inliers(here[1], picture) for picture in there[3:]]
    assert max(same) <= max(max(other) + 4, 20), (same, other)
    assert np.mean(same) <= np.mean(other) + 4
