"""Labels, craters, shadow, normals and flow against ray casts, kinematics and the catalogue.

Longer than other files: one view, drawn and met by rays once, serves nearly all tests.
"""

import dataclasses
import json

import camera_scene as scene
import cv2
import numpy as np
import pytest
from ray_scene import RayScene
import scipy.ndimage
import worlds

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.base.frames import (inverse, matrix_from_wxyz, se3, sun_direction,
                                         wxyz_from_rpy)
from lunar_rover_sim.ground.world.craters import Craters
from lunar_rover_sim.ground.world.rocks import Rocks
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.camera.development import Development
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.rendering import canvas, crater_map
from lunar_rover_sim.image.rendering.frame import FLOWS, RIGHT_TRUTH, StereoFrame
from lunar_rover_sim.image.rendering.labels import (class_names, LABEL_FIRST_LEG, LABEL_FIRST_ROCK,
                                                    LABEL_GROUND, LABEL_ROVER, LABEL_SKY,
                                                    LAST_LABEL, rover_links, vocabulary)
from lunar_rover_sim.image.rendering.layer_pictures import flow_picture
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.image.rendering.world_passes import WorldPasses
from lunar_rover_sim.rover.pose import RoverPose

CAMERA = CameraConfig(width=320, height=240)
# A camera behind and above the rover: body, front legs, ground, rocks and sky are in view.
SEEN = dataclasses.replace(scene.ROVER, stereo=dataclasses.replace(
    scene.ROVER.stereo, position_m=(-0.3, 0.0, 0.42), pitch_deg=33.0))
LAYERS = ('depth', 'label', 'crater', 'shadow', 'normal', 'radiance', *FLOWS)
SUN = scene.SunConfig(azimuth_deg=-60.0, elevation_deg=6.0)
RAYS = 12000


@dataclasses.dataclass
class Shot:
    """A frame of a rover in a state, the state that it flows to, and ray casts of some pixels.

    frame, then: of both states; pixels: rows and columns; depth, rock, link, normal: as
    `RayScene.cast` has them; moved: where the points that are hit are in the other state;
    smooth: (2, h, w) radiance of both states, of 2 x 2 samples a pixel
    """

    rig: StereoRig
    rocks: Rocks
    other: RoverPose
    T_world_camera: np.ndarray
    frame: StereoFrame
    then: StereoFrame
    rays: RayScene
    pixels: tuple
    depth: np.ndarray
    rock: np.ndarray
    link: np.ndarray
    normal: np.ndarray
    moved: np.ndarray
    smooth: np.ndarray

    def seen(self):
        """Return the (h, w, 3) points of the world that are seen."""
        T = self.T_world_camera
        return (self.frame.depth_m[..., None] * (self.rig.rays() @ T[:3, :3].T)
                + T[:3, 3])


@pytest.fixture(scope='module')
def view():
    world = worlds.small()
    config = scene.config(SUN.elevation_deg, SUN.azimuth_deg, camera=CAMERA)
    state = RoverPose(standing(world, -1.5, 1.0, 40.0), np.array([0.1, 0.5, -0.3, 0.8]))
    step = se3(matrix_from_wxyz(wxyz_from_rpy(0.01, 0.03, 0.02)), (0.03, 0.005, -0.002))
    other = RoverPose(state.T_world_base @ step,
                      state.joint_angle_rad + np.radians([20.0, -15.0, 10.0, 25.0]))
    with Renderer(world, SEEN, config) as drawn:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(canvas.SurfaceTargets, 'face', property(refused))
            patch.setattr(WorldPasses, 'crater_lists', refused)
            assert drawn.render(state, 0, ('left', 'right', 'depth')).label is None
        with pytest.raises(RenderError, match="'optical_flow' is not valid without `other`"):
            drawn.render(state, 0, ('optical_flow',))
        with pytest.raises(RenderError, match="layer 'shadows' is not valid"):
            drawn.render(state, 0, ('shadows',))
        alone = drawn.render(state, 0, ('label',))
        of_right = drawn.render(state, 0, RIGHT_TRUTH)
        assert of_right.label is None and of_right.depth_m is None
        frame = drawn.render(state, 0, (*LAYERS, *RIGHT_TRUTH), other)
        assert np.array_equal(alone.label, frame.label)
        for name in RIGHT_TRUTH:    # alone as beside the left one
            assert np.array_equal(of_right.layer(name), frame.layer(name)), name
        then = drawn.render(other, 0, ('radiance', 'depth'))
    finer = dataclasses.replace(config, detail=dataclasses.replace(config.detail, supersampling=2))
    with Renderer(world, SEEN, finer) as drawn:
        smooth = np.stack([drawn.render(s, 0, ('radiance',)).radiance for s in (state, other)])
    rays = RayScene(world, SEEN)
    rays.place(state)
    T = state.T_world_base @ drawn.rig.T_base_left
    rng = np.random.default_rng(4)
    pixels = rng.integers(0, CAMERA.height, RAYS), rng.integers(0, CAMERA.width, RAYS)
    legs = np.nonzero(rover_links(frame.label) & (frame.label != LABEL_ROVER))
    pixels = tuple(np.concatenate(pair) for pair in zip(pixels, legs))
    along = drawn.rig.rays()[pixels] @ T[:3, :3].T
    depth, rock, link, normal = rays.cast(T[:3, 3], along)
    moved = depth[:, None] * along + T[:3, 3]
    before = [rays.T_world_link(k) for k in range(5)]
    rays.place(other)
    for k, T_before in enumerate(before):
        motion = rays.T_world_link(k) @ inverse(T_before)
        moved[link == k] = moved[link == k] @ motion[:3, :3].T + motion[:3, 3]
    rays.place(state)
    return Shot(drawn.rig, drawn.rocks, other, T, frame, then, rays, pixels, depth, rock, link,
                normal, moved, smooth)


def test_truth_of_the_other_camera_is_no_picture_of_it(monkeypatch):
    """Only the camera whose image is asked for is developed, and exposure follows that."""
    developed = []
    take = Development.take
    monkeypatch.setattr(Development, 'take', lambda self, lit, *rest: (
        developed.append(tuple(lit)), take(self, lit, *rest))[1])
    world = scene.plane(257, heights=scene.hills(257))
    config = scene.config(SUN.elevation_deg, SUN.azimuth_deg, camera=CAMERA,
                          sensor=SensorConfig(exposure_mode='auto'))
    state = RoverPose(standing(world, -1.5, 1.0, 40.0))
    left_truth = ('depth', 'label', 'shadow')
    for image, truth in (('left', RIGHT_TRUTH), ('right', left_truth)):
        frames = []
        developed.clear()
        for layers in ((image,), (image, *truth), ('left', 'right', *truth)):
            with Renderer(world, SEEN, config) as drawn:
                frames.append([drawn.render(state, k, layers) for k in range(3)])
        side = (0,) if image == 'left' else (1,)
        assert developed == [side] * 6 + [(0, 1)] * 3
        alone, beside, both = frames
        for k in range(3):
            assert alone[k].exposure_s == beside[k].exposure_s
            assert np.array_equal(alone[k].layer(image), beside[k].layer(image))
        for name in truth:
            assert np.array_equal(beside[0].layer(name), both[0].layer(name)), name


def refused(*args):
    raise AssertionError('nobody has asked for it')


def off_edges(label, size=3):
    """Return where all neighbours of a pixel have its label."""
    kernel, value = np.ones((size, size), np.uint8), label.astype(np.float32)
    return cv2.dilate(value, kernel) == cv2.erode(value, kernel)


def test_labels_are_what_rays_hit(view):
    expected = np.select(
        [view.link == 0, view.link > 0, view.rock >= 0, view.depth > 0.0],
        [LABEL_ROVER, LABEL_FIRST_LEG + view.link - 1, LABEL_FIRST_ROCK + view.rock,
         LABEL_GROUND], LABEL_SKY)
    label = view.frame.label
    # Beyond the ground of physics there are far levels and far rocks.
    near = np.abs(view.seen()[..., :2]).max(axis=-1) < 6.3
    compared = (off_edges(label) & (near | (label == LABEL_SKY)))[view.pixels]
    assert compared.mean() > 0.8
    assert (label[view.pixels] == expected)[compared].mean() > 0.999
    found = np.unique(label)
    legs = {LABEL_FIRST_LEG, LABEL_FIRST_LEG + 1}
    assert {LABEL_GROUND, LABEL_ROVER} | legs <= set(found)
    assert (found >= LABEL_FIRST_ROCK).sum() > 8


def test_the_right_camera_has_the_truth_of_its_own_rays(view):
    """Depth, labels and normals of what its rays hit; craters and shadow of the same points."""
    T = view.T_world_camera @ inverse(view.rig.T_base_left) @ view.rig.T_base_right
    pixels = tuple(axis[:4000] for axis in view.pixels)
    along = view.rig.rays()[pixels] @ T[:3, :3].T
    depth, rock, link, normal = view.rays.cast(T[:3, 3], along)
    expected = np.select([link == 0, link > 0, rock >= 0, depth > 0.0],
                         [LABEL_ROVER, LABEL_FIRST_LEG + link - 1, LABEL_FIRST_ROCK + rock,
                          LABEL_GROUND], LABEL_SKY)
    frame, (rows, columns) = view.frame, pixels
    label = frame.right_label
    points = frame.right_depth_m[..., None] * (view.rig.rays() @ T[:3, :3].T) + T[:3, 3]
    near = np.abs(points[..., :2]).max(axis=-1) < 6.3
    compared = (off_edges(label) & (near | (label == LABEL_SKY)))[pixels]
    assert compared.mean() > 0.8 and (label[pixels] == expected)[compared].mean() > 0.999
    ground = compared & (expected == LABEL_GROUND) & (depth < 3.0)
    np.testing.assert_allclose(frame.right_depth_m[pixels][ground], depth[ground], rtol=2e-3)
    # What both cameras see of the ground: its disparity is that of the rig.
    shift = view.rig.focal_px * view.rig.baseline_m / depth[ground]
    rows, columns = rows[ground], np.rint(columns[ground] + shift).astype(int)
    both = columns < CAMERA.width
    rows, columns = rows[both], columns[both]
    right = tuple(axis[ground][both] for axis in pixels)
    seen = (frame.label[rows, columns] == LABEL_GROUND) & (
        np.abs(frame.depth_m[rows, columns] / depth[ground][both] - 1.0) < 0.01)
    assert seen.sum() > 300
    for left, other, share in ((frame.crater, frame.right_crater, 0.98),
                               (frame.shadow, frame.right_shadow, 0.9)):
        apart = np.abs(left[rows, columns].astype(int) - other[right]).reshape(len(rows), -1)
        assert (apart.max(axis=1)[seen] < 10).mean() > share
    turn = angle_deg(frame.normal[rows, columns], frame.right_normal[right])
    assert np.median(turn[seen]) < 1.0


def test_normals_are_those_of_the_height_field_and_of_faces(view):
    ground = worlds.small().ground
    slopes = [np.gradient(ground.heights_m.astype(float), ground.cell_m, axis=axis)
              for axis in (1, 0)]
    points, normal = view.seen(), view.frame.normal
    chosen = (view.frame.label == LABEL_GROUND) & (np.abs(points[..., :2]).max(-1) < 6.2)
    place = (points[chosen][:, :2] / ground.cell_m + (ground.n - 1) / 2)
    fall = [scipy.ndimage.map_coordinates(slope, place.T[::-1], order=1) for slope in slopes]
    expected = np.column_stack([-fall[0], -fall[1], np.ones(len(fall[0]))])
    error = angle_deg(expected, normal[chosen])
    assert np.median(error) < 0.05 and np.percentile(error, 99) < 0.3
    lengths = np.linalg.norm(normal[view.frame.label > 0], axis=-1)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-5)
    # Faces of the rover, and of rocks of at least 300 pixels: others are drawn coarser.
    label = view.frame.label[view.pixels]
    large = np.bincount(view.frame.label.ravel(), minlength=LAST_LABEL + 1) > 300
    face = off_edges(view.frame.label)[view.pixels] & large[label] & (
        (view.link >= 0) | (view.rock >= 0))
    error = angle_deg(view.normal[face], normal[view.pixels][face])
    assert face.sum() > 100 and np.median(error) < 0.05 and np.percentile(error, 90) < 0.5


def angle_deg(a, b):
    a = a / np.linalg.norm(a, axis=-1, keepdims=True)
    return np.degrees(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


def test_shadow_is_that_of_rays_to_the_sun(view):
    """Ground in full light or full shadow, without relief; rays begin 1 mm above it."""
    sun = sun_direction(SUN.azimuth_deg, SUN.elevation_deg)
    rng = np.random.default_rng(0)
    points = view.seen()
    rows, columns = np.nonzero((view.frame.label == LABEL_GROUND)
                               & (view.frame.depth_m < 5.0))
    pick = rng.choice(len(rows), 3000, replace=False)
    shadow = view.frame.shadow[rows[pick], columns[pick]]
    hits = [view.rays.cast(p + [0.0, 0.0, 1e-3], sun[None])
            for p in points[rows[pick], columns[pick]]]
    dark = np.array([hit[0][0] > 0.0 for hit in hits])
    of_rover = np.array([hit[2][0] >= 0 for hit in hits])
    # Off edges: less than a tenth of half shadow, and none next to it.
    beside = off_edges(view.frame.shadow[..., 0] < 128, 5)
    clear = (shadow[:, 2] < 26) & beside[rows[pick], columns[pick]]
    assert dark.mean() > 0.02 and clear.mean() > 0.8
    assert ((shadow[:, 0] < 128) == dark)[clear].mean() > 0.995
    assert of_rover[(shadow[:, 1] > 200) & beside[rows[pick], columns[pick]]].mean() > 0.97
    assert (of_rover & (shadow[:, 1] > 200)).sum() > 50
    assert np.all(shadow[:, 0].astype(int) + shadow[:, 1] < 257)


def test_craters_are_the_youngest_of_the_catalogue(view):
    world = worlds.small()
    craters = world.craters
    ground = (view.frame.label == LABEL_GROUND)[view.pixels]
    xy = view.seen()[view.pixels][ground][:, :2]
    level = np.searchsorted([grid.half_extent_m for grid in world.levels],
                            np.abs(xy).max(axis=1))
    youngest, time = np.zeros(len(xy), int), np.full(len(xy), np.inf)
    for i, (centre, diameter) in enumerate(zip(craters.position_m, craters.diameter_m)):
        inside = np.hypot(*(xy - centre).T) < 0.5 * diameter
        inside &= (craters.level[i] >= level) & (craters.time[i] < time)
        youngest[inside], time[inside] = i + 1, craters.time[i]
    assert (view.frame.crater[view.pixels][ground] == youngest).mean() > 0.9995
    assert len(np.unique(youngest)) > 20
    assert not view.frame.crater[view.frame.label != LABEL_GROUND].any()


def test_the_youngest_of_overlapping_craters_counts():
    """Of two the smaller one is younger; a third is older, and covers all."""
    craters = Craters(np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.0]]), np.array([2.0, 1.0, 9.0]),
                      np.array([0.5, 0.1, 0.5]), np.zeros(3, np.int32))
    lists = crater_map.crater_lists(craters, [2.0], cells=4)
    first, after = lists.cells[0, 2, 2].astype(int)     # x and y from 0 to 1 m
    assert lists.entries[first:after, 3].tolist() == [2.0, 1.0, 3.0]
    # A list ends with a crater that covers the whole cell.
    wide = dataclasses.replace(craters, diameter_m=np.array([8.0, 1.0, 9.0]))
    lists = crater_map.crater_lists(wide, [2.0], cells=4)
    first, after = lists.cells[0, 2, 2].astype(int)
    assert lists.entries[first:after, 3].tolist() == [2.0, 1.0]


def test_flow_leads_to_where_kinematics_has_the_same_point(view):
    """Points that rays hit, moved with their link by MuJoCo; static ground and legs."""
    rig, frame = view.rig, view.frame
    T_then = view.other.T_world_base @ rig.T_base_left
    pixel, _ = rig.project(view.moved, view.other.T_world_base)
    shift = pixel - np.stack(view.pixels[::-1], axis=-1)
    along = rig.rays()[view.pixels] * view.depth[:, None]
    step = (view.moved - T_then[:3, 3]) @ T_then[:3, :3] - along
    hit = (view.depth > 0.0) & off_edges(frame.label)[view.pixels]
    error = np.linalg.norm(shift - frame.optical_flow[view.pixels], axis=-1)
    error_m = np.linalg.norm(step - frame.scene_flow[view.pixels], axis=-1)
    assert (hit & (view.link > 0)).sum() > 150
    for part in (view.link < 0, view.link > 0):
        part = part & hit
        if part.any():
            assert np.linalg.norm(shift[part], axis=-1).max() > 3.0
            assert np.percentile(error[part], 99) < 0.01 and error[part].max() < 0.5
            assert np.percentile(error_m[part], 99) < 1e-4
    sky = frame.label == LABEL_SKY
    assert np.isnan(frame.scene_flow[sky]).all()
    assert np.isfinite(frame.optical_flow[sky]).all()


def test_flow_warps_one_frame_onto_the_other(view):
    """What is left between patches of radiance, where both frames see the ground.

    Of several samples a pixel: edges that jump from pixel to pixel are not what flow tells.
    """
    flow, depth = view.frame.optical_flow, view.frame.depth_m
    v, u = np.indices(depth.shape, dtype=np.float32)
    x, y = u + flow[..., 0], v + flow[..., 1]
    warped = cv2.remap(view.smooth[1], x, y, cv2.INTER_CUBIC)
    known = cv2.remap(view.then.depth_m, x, y, cv2.INTER_LINEAR, borderValue=0.0)
    expected = depth + view.frame.scene_flow[..., 2]
    with np.errstate(invalid='ignore'):
        both = (np.abs(known - expected) < 0.02 * expected) & (view.frame.label == LABEL_GROUND)
    # The rover's shadow moves over the ground.
    own = view.frame.shadow[..., 1] > 0
    both &= cv2.dilate(own.astype(np.uint8), np.ones((31, 31), np.uint8)) == 0
    errors, side = [], 40
    for top in range(0, CAMERA.height - side, side):
        for left in range(0, CAMERA.width - side, side):
            patch = np.s_[top:top + side, left:left + side]
            if both[patch].mean() > 0.98:
                errors.append(apart_px(view.smooth[0][patch], warped[patch]))
    assert len(errors) >= 12
    assert np.linalg.norm(np.mean(errors, axis=0)) < 0.02
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.05


def apart_px(image, other):
    """Return the shift between two images, by least squares; their contrast may differ."""
    down, right = np.gradient(cv2.GaussianBlur(other, (0, 0), 1.0).astype(float))
    smooth = [cv2.GaussianBlur(i, (0, 0), 1.0).astype(float) for i in (image, other)]
    inside = np.s_[3:-3, 3:-3]
    columns = [right, down, smooth[1], np.ones(other.shape)]
    found = np.linalg.lstsq(np.column_stack([c[inside].ravel() for c in columns]),
                            smooth[0][inside].ravel(), rcond=None)[0]
    return found[:2] / found[2]


def test_vocabulary_names_every_label(view):
    world, rocks = worlds.small(), view.rocks
    info = json.loads(vocabulary(rocks, world.craters, world.hash, scene.ROVER.legs.names))
    names = {item['class_id']: item['class_name'] for item in info['class_map']}
    assert set(np.unique(view.frame.label)) <= set(names)
    assert len(rocks) > len(world.rocks)
    assert names[LABEL_SKY] == 'sky' and names[LABEL_FIRST_LEG] == 'rover front left leg'
    assert names[LABEL_FIRST_ROCK] == 'rock 0' and len(names) == 8 + len(rocks)
    np.testing.assert_allclose(info['rocks']['position_m'], rocks.position_m, atol=1e-4)
    assert info['rocks']['first_id'] == LABEL_FIRST_ROCK
    np.testing.assert_allclose(info['craters']['diameter_m'], world.craters.diameter_m, atol=1e-4)
    assert info['database_version'] == world.hash


def test_labels_beyond_16_bits_share_the_last_one():
    names = class_names(70000, ['left', 'right'])
    assert max(names) == LAST_LABEL and names[LAST_LABEL] == 'rock 65519 or any later one'


@pytest.mark.parametrize('flow,rgb', [
    ((32.0, 0.0), (255, 0, 0)), ((-32.0, 0.0), (0, 255, 255)), ((0.0, 32.0), (128, 255, 0)),
    ((0.0, -32.0), (128, 0, 255)), ((16.0, 0.0), (128, 0, 0)), ((500.0, 0.0), (255, 0, 0)),
    ((0.0, 0.0), (0, 0, 0)), ((np.nan, 1.0), (40, 40, 40))])
def test_flow_of_a_known_scale(flow: tuple[float, float], rgb: tuple[int, ...]) -> None:
    """Right red, down yellow-green, left cyan, up violet; 32 px are full, whatever is around."""
    image = np.full((4, 5, 2), 100.0, np.float32)
    image[1, 2] = flow
    assert np.abs(flow_picture(image, 32.0)[1, 2, ::-1].astype(int) - rgb).max() <= 3
