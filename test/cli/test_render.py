"""The commands `render`, `validate stereo` and `world preview`, as a user types them."""

import functools
import json

import camera_scene as scene
from command_line import unfolded
from conftest import PLAIN
import cv2
import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.cli import world as cli_world
from lunar_rover_sim.cli.main import main
from lunar_rover_sim.ground.world import world_folder
from lunar_rover_sim.image.camera.config import CameraConfig, SensorConfig
from lunar_rover_sim.image.rendering import snapshot
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import four_views, settle, standing
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose

LAYERS = ('left.png', 'right.png', 'preview.png', 'depth_m.npy', 'normal.npy', 'label.npy',
          'radiance.npy', 'disparity_px.npy')
SMALL = ('--set', 'render_node.camera.width=320', '--set', 'render_node.camera.height=240')
TINY = ('--set', 'render_node.camera.width=160', '--set', 'render_node.camera.height=120')
BARE = tuple(word for setting in PLAIN for word in ('--set', setting))


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return the folder of a small world."""
    path = tmp_path_factory.mktemp('worlds') / 'small'
    world_folder.save_world(worlds.small(), path)
    return path


def test_render_writes_all_layers(folder, tmp_path, capsys):
    out = tmp_path / 'frames'
    assert main(['render', 'baseline', '--world', str(folder), *SMALL, *BARE, '--pose',
                 '-1,0.5,-120', '--pose', '1,1,0,3', '-o', str(out)]) == 0
    for k in range(2):
        for name in LAYERS:
            assert (out / f'{k:03d}_{name}').is_file()
    left = cv2.imread(str(out / '000_left.png'), cv2.IMREAD_UNCHANGED)
    depth, label = (np.load(out / f'000_{name}.npy') for name in ('depth_m', 'label'))
    assert left.shape == depth.shape == label.shape == (240, 320)
    assert np.array_equal(np.isinf(depth), label == 0)
    # From 3 m the same ground is farther away.
    assert np.load(out / '001_depth_m.npy')[235].min() > 5 * depth[235].min()
    assert main(['render', 'baseline', '--world', str(folder), '-o', str(out)]) == 1
    assert 'exists; name a new folder' in unfolded(capsys.readouterr().err)


def test_a_twist_blurs_the_images_and_nothing_else(folder, tmp_path):
    clean = [word for name in ('shot_noise', 'read_noise', 'fixed_pattern')
             for word in ('--set', f'render_node.sensor.{name}=false')]
    options = ['render', 'baseline', '--world', str(folder), *TINY, *BARE, *clean]
    assert main([*options, '-o', str(tmp_path / 'still')]) == 0
    assert main([*options, '--twist', '-0.1,0,0,0,0,20', '-o', str(tmp_path / 'turning')]) == 0
    images, depths = ([read(str(tmp_path / name / f'000_{layer}')) for name in
                       ('still', 'turning')] for read, layer in ((cv2.imread, 'left.png'),
                                                                 (np.load, 'depth_m.npy')))
    still, turning = (np.abs(np.diff(image[..., 0].astype(float), axis=1)).mean()
                      for image in images)
    assert turning < 0.8 * still
    np.testing.assert_array_equal(*depths)


def test_validate_stereo(tmp_path, capsys):
    out = tmp_path / 'study'
    small = ['world.size_m=12.8', 'world.surroundings.samples=257',
             'render_node.camera.width=320', 'render_node.camera.height=240',
             'render_node.sgm.num_disparities=64']
    sets = [word for item in small for word in ('--set', item)]
    assert main(['validate', 'stereo', 'baseline', '-n', '2', '-o', str(out), *sets]) == 0
    summary = json.loads((out / 'stereo.json').read_text())['baseline']
    assert summary['density on lit ground'] > 0.5
    assert summary['end-point error [px]'] < 1.0
    assert abs(summary['median signed error [px]']) < 0.05
    causes = [summary[key] for key in summary if key.startswith('invalid')]
    assert sum(causes) == pytest.approx(1.0)
    assert len(list(out.glob('*.png'))) == 2
    printed = capsys.readouterr().out
    assert 'bad-1' in printed and 'median signed error' in printed
    assert main(['validate', 'stereo', 'baseline', '-n', '0', '-o', str(tmp_path / 'x')]) == 1
    assert '--frames: 0 is not valid; valid is >= 1' in unfolded(capsys.readouterr().err)


def test_a_lens_that_folds_the_image_is_refused(folder, tmp_path, capsys):
    out = tmp_path / 'frames'
    assert main(['render', 'baseline', '--world', str(folder), '-o', str(out), '--set',
                 'render_node.camera.distortion=[-1.5, 0, 0, 0, 0]']) == 1
    said = unfolded(capsys.readouterr().err).strip()
    assert 'distortion: [-1.5, 0.0,' in said and '\n' not in said
    assert not out.exists() or not list(out.iterdir())


def test_exposure_of_a_still_is_at_rest():
    world = worlds.small()
    config = RenderConfig(camera=CameraConfig(width=160, height=120), detail=scene.SMOOTH,
                          sensor=SensorConfig(exposure_mode='auto'))
    with Renderer(world, RoverDescription(), config) as renderer:
        at, away = standing(world, 0.0, 0.0, 60.0), standing(world, 0.0, 0.0, 240.0)
        renderer.render(RoverPose(at), 0, ('left',))
        settle(renderer, RoverPose(away))
        one, two = (renderer.render(RoverPose(away), k, ('left',)) for k in (0, 1))
    assert one.exposure_s == pytest.approx(two.exposure_s, rel=0.02)
    assert np.mean(one.left == 255) < 0.1


def test_standing_is_square_to_the_slope():
    world = worlds.small()
    pose = standing(world, 1.0, -1.0, 30.0, 0.1)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    ground = float(world.height_at((1.0, -1.0)))
    assert np.linalg.norm(pose[:3, 3] - [1.0, -1.0, ground]) == pytest.approx(0.1)
    assert pose[2, 2] > 0.8
    with pytest.raises(ConfigError, match='outside the world'):
        standing(world, np.inf, 0.0, 0.0)


def test_preview_has_the_views_which_the_lamp_lights_without_sun(tmp_path, monkeypatch):
    # Without rocks and relief there is less to draw.
    folder = world_folder.save_world(worlds.small(**worlds.BARE), tmp_path / 'bare')
    views = []
    monkeypatch.setattr(snapshot, 'RenderConfig',
                        functools.partial(RenderConfig, detail=scene.SMOOTH))

    def watched(*arguments):
        views.extend(four_views(*arguments))
        return views

    monkeypatch.setattr(cli_world, 'four_views', watched)
    output = tmp_path / 'a.png'
    assert main(['world', 'preview', str(folder), '-o', str(output), '--sun', '60', '-1']) == 0
    assert len(views) == 4
    for title, image in views[:3]:
        assert image.shape == (480, 640) and image.max() > 100, title
    height, width = cv2.imread(str(output)).shape[:2]
    assert height > 0.7 * width         # 0.52 without views
