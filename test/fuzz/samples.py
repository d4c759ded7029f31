"""Valid inputs of every reader, small: each is a folder that a case copies and mutates."""

import json
from pathlib import Path
import shutil

import cv2
from judge.evaluation.wandering import files_of_others
import numpy as np
import rasterio
import synthetic_bag
import trimesh
import yaml

from lunar_rover_sim.base.files.images import write_png
from lunar_rover_sim.base.files.paths import config_path
from lunar_rover_sim.campaign.campaign_file import load_campaign
from lunar_rover_sim.campaign.manifest import (CAMPAIGN_FILE, EPISODES, ERROR_FILE, FAILED,
                                               file_table, FORMAT, MANIFEST)
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.orbital_map import MappedCraters, OrbitalConfig, OrbitalMap
from lunar_rover_sim.ground.world.world_folder import save_world
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory
from lunar_rover_sim.judge.evaluation.trajectory_files import write_tum
from lunar_rover_sim.products.sequences.export import export
from lunar_rover_sim.run.scenario import Scenario

# The ground that elevation models and meshes must cover.
WINDOW_M, CELL_M = 3.2, 0.1
WORLD = {'size_m': WINDOW_M, 'cell_m': CELL_M,
         'surroundings': {'extent_m': 5.0, 'samples': 65}}
MOON = '+proj=stere +lat_0=-90 +lon_0=0 +k=1 +R=1737400 +units=m'


def scenario(folder: Path) -> None:
    """A packaged scenario, and all of its parameters."""
    shutil.copy(config_path('scenarios/baseline.yaml'), folder / 'short.yaml')
    (folder / 'resolved.yaml').write_text(Scenario.load('baseline').to_yaml())


def rover(folder: Path) -> None:
    """The packaged rover."""
    shutil.copy(config_path('rovers/quad.yaml'), folder / 'rover.yaml')


def campaign(folder: Path) -> None:
    """The packaged campaign, cut down to a few episodes."""
    text = config_path('campaigns/polar_suns.yaml').read_text()
    document = yaml.safe_load(text) | {'episodes': 8}
    (folder / 'campaign.yaml').write_text(yaml.safe_dump(document, sort_keys=False))


def gait(folder: Path) -> None:
    """The packaged gait table."""
    shutil.copy(config_path('gait_calibrations/rigid.yaml'), folder / 'table.yaml')


def published(folder: Path) -> None:
    """The packaged published numbers of SLAM systems."""
    shutil.copy(config_path('published_slam.yaml'), folder / 'published.yaml')


def trajectory(folder: Path) -> None:
    """One walk in all formats of trajectories."""
    t = np.arange(40)
    walk = Trajectory(1_000_000_000 + 50_000_000 * t, np.c_[0.01 * t, np.sin(0.1 * t), 0.0 * t],
                      np.c_[np.cos(0.02 * t), 0.0 * t, 0.0 * t, np.sin(0.02 * t)])
    write_tum(folder / 'walk.txt', walk)
    files_of_others(folder / 'walk.csv', folder / 'walk.kitti', folder / 'times.txt', walk)


def _heights(n: int = 48) -> np.ndarray:
    y, x = np.mgrid[:n, :n] * 0.1
    heights: np.ndarray = 0.1 * np.sin(x) * np.cos(0.7 * y)
    return heights.astype(np.float32)


def geotiff(folder: Path) -> None:
    """Elevation models: of floats, and of scaled integers in compressed tiles."""
    heights = _heights()
    place = {'crs': MOON, 'transform': rasterio.transform.from_origin(-2.4, 2.4, 0.1, 0.1),
             'width': 48, 'height': 48, 'count': 1}
    with rasterio.open(folder / 'float.tif', 'w', 'GTiff', dtype='float32', nodata=-9999.0,
                       **place) as file:
        file.write(heights, 1)
    with rasterio.open(folder / 'tiled.tif', 'w', 'GTiff', dtype='int16', compress='deflate',
                       tiled=True, blockxsize=16, blockysize=16, **place) as file:
        file.write(np.rint(heights * 1000.0).astype(np.int16), 1)
        file.scales = (0.001,)


def dem_folder(folder: Path) -> None:
    """Heights as an array beside their description."""
    np.save(folder / 'dem.npy', _heights())
    (folder / 'dem.yaml').write_text('size: [48, 48]\npixel_size: [0.1, -0.1]\n'
                                     'center_coordinates: [0.0, -90.0]\n')


def marked(folder: Path) -> None:
    """Elevation models larger than the window, into which blocks of markers are written."""
    heights = np.tile(_heights(100), (2, 2))[:160, :160]
    np.save(folder / 'dem.npy', heights)
    (folder / 'dem.yaml').write_text('size: [160, 160]\npixel_size: [0.1, -0.1]\n')


def mesh(folder: Path) -> None:
    """One surface in all formats of meshes."""
    heights = _heights(16)
    y, x = np.mgrid[:16, :16] * 0.3
    index = np.arange(256).reshape(16, 16)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:],
                                            index[1:, :-1]))
    surface = trimesh.Trimesh(np.c_[x.ravel(), y.ravel(), heights.ravel()],
                              np.r_[np.c_[a, b, c], np.c_[a, c, d]], process=False)
    for suffix in ('obj', 'stl', 'ply', 'off'):
        surface.export(folder / f'surface.{suffix}')
    surface.export(folder / 'text.stl', file_type='stl_ascii')
    surface.export(folder / 'text.ply', encoding='ascii')
    surface.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    surface.export(folder / 'surface.glb')


def world(folder: Path) -> None:
    """A small world."""
    save_world(build_world(WorldConfig.from_mapping(WORLD), 1), folder / 'world')


def orbital(folder: Path) -> None:
    """Maps of a site from orbit."""
    craters = MappedCraters(np.array([[3.0, -4.0], [-9.0, 8.0]]), np.array([6.0, 11.0]))
    OrbitalMap(_heights().astype(np.float32), (-47.0, -47.0), craters,
               _picture(1)[:24, :24].copy(), (-11.5, -11.5), OrbitalConfig(), {'seed': 1},
               'ground').save(folder / 'maps')


def _bag(folder: Path, storage: str = 'mcap', **options: str) -> None:
    items = synthetic_bag.drive(0.2, state_hz=50)
    synthetic_bag.WRITERS[storage](folder / 'bag', items, **options)


def mcap(folder: Path) -> None:
    """A drive of 0.2 s in MCAP."""
    _bag(folder)


def mcap_zstd(folder: Path) -> None:
    """The same, its chunks being compressed."""
    _bag(folder, compression='zstd')


def sqlite(folder: Path) -> None:
    """The same in SQLite."""
    _bag(folder, storage='sqlite3')


def cut_mcap(folder: Path) -> None:
    """A bag whose recording was killed: its end and its metadata are missing."""
    _bag(folder)
    (folder / 'bag' / 'metadata.yaml').unlink()
    file = next((folder / 'bag').glob('*.mcap'))
    file.write_bytes(file.read_bytes()[:-2000])


def cut_end(folder: Path) -> None:
    """A finished bag, of which the end of the file is lost: its metadata are intact."""
    _bag(folder)


def sequence(folder: Path) -> None:
    """An exported EuRoC sequence."""
    _bag(folder)
    export(folder / 'bag', folder / 'euroc', 'euroc')
    shutil.rmtree(folder / 'bag')


def _picture(seed: int, dtype: type = np.uint8, full: int = 255) -> np.ndarray:
    """Return an image with edges and a black sky."""
    rng = np.random.default_rng(seed)
    image = cv2.resize(rng.random((12, 16), np.float32), (64, 48), interpolation=cv2.INTER_CUBIC)
    image[:8] = 0.0
    return np.clip(image * full, 0, full).astype(dtype)


def images(folder: Path) -> None:
    """Pairs with true depth in TartanAir's layout, with our calibration."""
    for name in ('image_left', 'image_right', 'depth_left'):
        (folder / 'set' / name).mkdir(parents=True)
    for k in range(2):
        for side in ('left', 'right'):
            write_png(folder / 'set' / f'image_{side}' / f'{k:06d}_{side}.png', _picture(k))
        np.save(folder / 'set' / 'depth_left' / f'{k:06d}_left_depth.npy',
                np.full((48, 64), 2.0, np.float32))
    (folder / 'set' / 'calibration.yaml').write_text(
        'left: {fx_fy_cx_cy_px: [60.0, 60.0, 32.0, 24.0]}\nbaseline_m: 0.1\n')


def polar(folder: Path) -> None:
    """Two exposures of one scene of POLAR, and its calibration."""
    scene = folder / 'set' / 'Terrain01' / 'PosA_1500_Loff' / 'Sun_30'
    scene.mkdir(parents=True)
    for exposure, full in ((64, 2000), (128, 4095)):
        for side in 'LR':
            write_png(scene / f'Cam{side}_PosA_{exposure:04d}.png',
                      _picture(exposure, np.uint16, full))
    (folder / 'set' / 'Terrain01' / 'stereo.calibration').write_text(
        'CAMERA_MATRIX_LEFT: 100 0 32 0 100 24 0 0 1\n'
        'DISTORTION_COEFFICIENTS_LEFT: 0.1 -0.05 0 0 0\n'
        'CAMERA_MATRIX_RIGHT: 100 0 32 0 100 24 0 0 1\n'
        'DISTORTION_COEFFICIENTS_RIGHT: 0.1 -0.05 0 0 0\n'
        'ROTATION_MATRIX: 1 0 0 0 1 0 0 0 1\nTRANSLATION_VECTOR: -0.3 0 0\n')


def dataset(folder: Path) -> None:
    """A data set of one finished and one failed episode."""
    episode = folder / EPISODES / '0000'
    episode.mkdir(parents=True)
    (episode / 'scenario.yaml').write_text(Scenario.load('baseline').to_yaml())
    images = episode / 'kitti' / 'image_0'
    images.mkdir(parents=True)
    for k in range(2):
        cv2.imwrite(str(images / f'{k:06d}.png'), np.full((24, 32), 40 * k, np.uint8))
    manifest = {'format': FORMAT, 'files': file_table(episode), 'drawn': {'seed': 1},
                'bag_hash': 'ab' * 32, 'scenario_sha256': 'cd' * 32,
                'statistics': {'duration_s': 1.0, 'frames': 10, 'distance_m': 0.1, 'bytes': 10,
                               'imu_preset': 'adis16448', 'sgm_density': 0.8}}
    (episode / MANIFEST).write_text(json.dumps(manifest))
    failed = folder / FAILED / '0001'
    failed.mkdir(parents=True)
    (failed / ERROR_FILE).write_text(json.dumps({'error': 'no space'}))
    plain = load_campaign('polar_suns').to_mapping()
    (folder / CAMPAIGN_FILE).write_text(json.dumps({'campaign': plain, 'sha256': ''}))
