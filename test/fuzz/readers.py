"""What each reader is given, and what must hold of everything that it accepts.

`read` gets the folder with the mutated files, that with the valid ones, the name of the file that
was mutated, and a generator. It ends normally where the input is accepted and right, raises an
error of the package where it is refused, and `Contradiction` where something was accepted that the
documentation excludes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import dataclasses
import functools
import math
from pathlib import Path
import random
from typing import Any

import mutations
import numpy as np
import samples

from lunar_rover_sim import topics
from lunar_rover_sim.bag.content_hash import topic_hashes
from lunar_rover_sim.bag.reader import Bag, open_bag
from lunar_rover_sim.bag.recorded_scenario import recorded_scenario
from lunar_rover_sim.bag.recovery import recover
from lunar_rover_sim.bag.series import picture, read_calibration, read_imu, read_odometry
from lunar_rover_sim.campaign.campaign_file import parse_campaign
from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.episode_plans import draw, episode
from lunar_rover_sim.campaign.layout import EPISODES
from lunar_rover_sim.campaign.manifest import why_unfinished
from lunar_rover_sim.campaign.page import write_page
from lunar_rover_sim.errors import LunarRoverSimError
from lunar_rover_sim.evaluation.image_comparison import compare_images
from lunar_rover_sim.evaluation.image_layouts import open_images
from lunar_rover_sim.evaluation.trajectory_files import read_kitti, read_trajectory
from lunar_rover_sim.evaluation.trajectory_sources import load
from lunar_rover_sim.files.yaml_text import read_text
from lunar_rover_sim.gait.calibration import GaitCalibration
from lunar_rover_sim.gait.config import GaitConfig
from lunar_rover_sim.inspection.check import check
from lunar_rover_sim.inspection.report import Status
from lunar_rover_sim.parameters import Parameters, ParamInfo
from lunar_rover_sim.physics.config import PhysicsConfig
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.rover.visual import visual_parts
from lunar_rover_sim.run.scenario import Scenario
from lunar_rover_sim.slam import euroc_reader
from lunar_rover_sim.slam.table import read_paper
from lunar_rover_sim.studies.pitch import read_curve
from lunar_rover_sim.world.build import build_world
from lunar_rover_sim.world.config import WorldConfig
from lunar_rover_sim.world.dem import open_dem
from lunar_rover_sim.world.mesh import MeshSource
from lunar_rover_sim.world.model import World
from lunar_rover_sim.world.world_folder import content_hash, load_world


class Contradiction(AssertionError):
    """Something was accepted that the documentation excludes."""


@dataclasses.dataclass(frozen=True)
class Reader:
    """How a kind of input is made, mutated and read.

    make: fills the folder of a valid sample; mutate: pattern of files → mutation; weight: share of
    the cases
    """

    make: Callable[[Path], None]
    mutate: Mapping[str, mutations.Mutate]
    read: Callable[[Path, Path, Path, random.Random], None]
    weight: int = 4


def claim(holds: object, what: str) -> None:
    """Raise Contradiction if something does not hold."""
    if not holds:
        raise Contradiction(what)


def within_bounds(parameters: Parameters, where: str = '') -> None:
    """Every value has its declared type and is within its documented bounds."""
    for name, value, info, kind in parameters.flatten():
        for item in value if isinstance(value, tuple) else (value,):
            _within(f'{where}{name}', item, info)
        claim(isinstance(value, tuple) == str(kind).startswith('tuple'), f'{name}: {value!r}')
        claim(info.length in (None, len(value) if isinstance(value, tuple) else None),
              f'{name}: {value!r} has not {info.length} elements')


def _within(name: str, value: Any, info: ParamInfo) -> None:
    if isinstance(value, float):
        claim(math.isfinite(value), f'{name}: {value}')
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if info.low is not None:
            claim(value > info.low if info.open_low else value >= info.low, f'{name}: {value}')
        if info.high is not None:
            claim(value < info.high if info.open_high else value <= info.high, f'{name}: {value}')
    if info.choices:
        claim(value in info.choices, f'{name}: {value!r} is none of {info.choices}')


def _all_within_bounds(scenario: Scenario) -> None:
    for field in dataclasses.fields(scenario):
        part = getattr(scenario, field.name)
        if isinstance(part, Parameters):
            within_bounds(part, f'{field.name}.')


def read_scenario(folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Values are within their bounds, and written down they give the same scenario."""
    scenario = Scenario.load(str(file))
    _all_within_bounds(scenario)
    again = folder / 'again.yaml'
    again.write_text(scenario.to_yaml())
    claim(dataclasses.replace(Scenario.load(str(again)), name=scenario.name) == scenario,
          'written down it gives another scenario')


@functools.lru_cache(maxsize=1)
def _plane() -> World:
    return build_world(WorldConfig.from_mapping(
        {**samples.WORLD, 'relief': {'rms_slope_deg': 0.0, 'far_rms_slope_deg': 0.0},
         'craters': {'density': 0.0}, 'rocks': {'abundance': 0.0}}), 1)


def read_rover(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Values are within their bounds; it can be drawn, described, and stand and be stepped."""
    rover = load_rover(file)
    within_bounds(rover)
    urdf(rover)
    claim(all(np.isfinite(part.vertices).all() for part in visual_parts(rover)),
          'its mesh is not finite')
    with Simulation(_plane(), rover, PhysicsConfig()) as simulation:
        claim(np.isfinite(simulation.advance(20).position_m).all(), 'its position is not finite')


def read_campaign(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """The first and the last episode are scenarios within their bounds."""
    campaign = parse_campaign(read_text(file, 1 << 18), file)
    within_bounds(campaign.config)
    drawn = draw(campaign)
    for k in {0, len(drawn) - 1} if drawn else ():
        plan = episode(campaign, f'{k:04d}', drawn[k])
        again = file.with_name('episode.yaml')
        again.write_text(plan.scenario_yaml)
        _all_within_bounds(Scenario.load(str(again)))


def read_gait(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Every velocity has a finite stride within the limits of the gait."""
    table, config = GaitCalibration.load(file), GaitConfig()
    for forward in (-0.2, -1e-3, 0.0, 0.05, 0.2, 10.0):
        for yaw_rate in (-2.0, 0.0, 0.3, 10.0):
            stride, scale = table.stride(forward, yaw_rate, config)
            claim(all(math.isfinite(x) for x in dataclasses.astuple(stride)), f'{stride}')
            claim(0.0 <= stride.phase_rate_hz <= config.max_phase_rate_hz + 1e-9, f'{stride}')
            claim(0.0 <= scale <= 1.0, f'scaled by {scale}')


def read_published(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Published numbers are finite."""
    for scenario in read_paper(file).values():
        for numbers in scenario.values():
            claim(all(math.isfinite(x) for x in numbers.values()), f'{numbers}')


def read_trajectories(folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Stamps increase, positions are finite, quaternions have length 1."""
    if file.name in ('times.txt', 'walk.kitti'):
        walk = read_kitti(folder / 'walk.kitti', folder / 'times.txt')
    else:
        walk = read_trajectory(file)
    claim((np.diff(walk.stamps_ns) > 0).all(), 'stamps do not increase')
    claim(np.isfinite(walk.positions_m).all(), 'positions are not finite')
    claim(np.abs(np.linalg.norm(walk.orientations_wxyz, axis=1) - 1.0).max(initial=0.0) < 1e-9,
          'a quaternion has not length 1')


def read_pitch(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """Time increases in even steps, pitch is finite."""
    curve = read_curve(file)
    claim(np.isfinite(curve.pitch_deg).all() and (np.diff(curve.time_s) > 0.0).all(), f'{curve}')


def _config(**source: Any) -> WorldConfig:
    return WorldConfig.from_mapping({**samples.WORLD, **source})


def _ground(source: Any) -> None:
    """Heights are finite and those of the Moon, at fine and at coarse cells."""
    try:
        for half_m, cell_m in ((0.5 * samples.WINDOW_M, samples.CELL_M), (5.0, 0.8)):
            tile = source.tile(half_m, cell_m)
            if tile is not None:
                claim(np.isfinite(tile.heights_m).all(), 'heights are not finite')
                claim(np.abs(tile.heights_m).max() <= 2e5, 'heights beyond any on the Moon')
                claim((np.diff(tile.x_m) > 0.0).all() and (np.diff(tile.y_m) > 0.0).all(),
                      'pixels do not follow each other')
    finally:
        source.close()


def read_dem(folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """A GeoTIFF, or a folder of dem.npy and dem.yaml."""
    path = folder if file.name.startswith('dem.') else file
    _ground(open_dem(_config(source='dem', path=str(path), dem={'nodata': 'fill'})))


def read_mesh(_folder: Path, _valid: Path, file: Path, _rng: random.Random) -> None:
    """A mesh of any format."""
    _ground(MeshSource(_config(source='mesh', path=str(file), mesh={'holes': 'fill'})))


def read_world(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What is accepted has the content of the valid world."""
    world = load_world(folder / 'world')
    claim(world.hash == content_hash(world), 'the hash is not that of the content')
    claim(world.hash == _hash_of(valid / 'world'), 'the content is another one')


@functools.lru_cache(maxsize=1)
def _hash_of(folder: Path) -> str:
    return load_world(folder).hash


@functools.lru_cache(maxsize=8)
def _hashes_of(bag: Path) -> dict[str, str]:
    return topic_hashes(bag)


def _use(bag: Bag) -> None:
    """What the programs behind read from a bag; each part may be refused."""
    for part in (lambda: list(bag.messages()), lambda: recorded_scenario(bag),
                 lambda: read_odometry(bag), lambda: read_imu(bag),
                 lambda: read_calibration(bag, topics.LEFT_INFO.name),
                 lambda: picture(bag, bag.first(topics.LEFT_IMAGE.name)),
                 lambda: load(bag.path)):
        try:
            part()
        except LunarRoverSimError as error:
            one_line(error)


def read_bag(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What the bag check passes, its checksums fitting, has the content of the valid bag."""
    with open_bag(folder / 'bag') as bag:
        _use(bag)
    report = check(folder / 'bag')
    sealed = any(f.check == 'checksums' and f.status == Status.PASS for f in report.findings)
    if report.ok and sealed:
        claim(topic_hashes(folder / 'bag') == _hashes_of(valid / 'bag'),
              'the bag check passes another content')


def read_cut_bag(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """What is recovered can be read, stays marked, and has no message that was not there."""
    path = folder / 'bag'
    recover(path)
    with open_bag(path) as bag:
        claim(bag.incomplete, 'a recovered bag is not marked')
        _use(bag)
    claim(not check(path).ok, 'the bag check passes a recovered bag')


def read_sequence(folder: Path, _valid: Path, _file: Path, _rng: random.Random) -> None:
    """The calibration is finite, images are there."""
    camera = euroc_reader.read_camera(folder / 'euroc', True)
    claim(np.isfinite([*camera.focal_px, *camera.centre_px, camera.baseline_m]).all(), f'{camera}')
    for frame in euroc_reader.read_frames(folder / 'euroc', camera):
        claim(frame.left.ndim == 2, 'an image is not grey')


def read_images(folder: Path, valid: Path, _file: Path, _rng: random.Random) -> None:
    """Levels are from 0 to 1, sizes agree, truth is no negative number; all can be compared."""
    images = open_images(folder / 'set')
    for pair in images.read(2):
        claim(pair.left.ndim == 2 and pair.left.min() >= 0.0 and pair.left.max() <= 1.0,
              'levels are not from 0 to 1')
        for other in (pair.right, pair.truth_px):
            claim(other is None or other.shape == pair.left.shape, 'sizes do not agree')
        if pair.truth_px is not None:
            claim(not np.isinf(pair.truth_px).any() and not (pair.truth_px < 0.0).any(),
                  'a true disparity is no disparity')
    found = compare_images(folder / 'set', valid / 'set', frames=2)
    claim(not np.isinf(np.r_[found.first.values, found.second.values]).any(), 'infinite measures')


def read_dataset(folder: Path, valid: Path, file: Path, _rng: random.Random) -> None:
    """A changed episode is found; card and page can be written whatever it says."""
    episode_folder = folder / EPISODES / '0000'
    reason = why_unfinished(episode_folder)
    if reason is not None:
        one_line(reason)
    elif file.parent != folder and file.name != 'manifest.json' and EPISODES in file.parts:
        claim(not file.is_symlink() and file.read_bytes() == (
            valid / file.relative_to(folder)).read_bytes(), 'a changed file is not found')
    card = write_card(folder)
    write_page(folder, card, folder / 'page.html')


def one_line(error: LunarRoverSimError | str) -> None:
    """A message for people is one line, not a page of it."""
    text = str(error)
    claim(text and text.isprintable(), f'not one printable line: {text[:300]!r}')
    claim(len(text) < 2000, f'{len(text)} characters: {text[:300]!r}')


_BAG = {'bag/*.yaml': mutations.any_yaml, 'bag/*.mcap': mutations.any_bytes,
        'bag/*.db3': mutations.any_bytes}

READERS: dict[str, Reader] = {
    'scenario': Reader(samples.scenario, {'*.yaml': mutations.any_yaml}, read_scenario, 6),
    'rover': Reader(samples.rover, {'*.yaml': mutations.any_yaml}, read_rover, 6),
    'campaign': Reader(samples.campaign, {'*.yaml': mutations.any_yaml}, read_campaign),
    'gait': Reader(samples.gait, {'*.yaml': mutations.any_yaml}, read_gait, 6),
    'published': Reader(samples.published, {'*.yaml': mutations.any_yaml}, read_published, 2),
    'trajectory': Reader(samples.trajectory, {'*': mutations.any_text}, read_trajectories, 6),
    'pitch_curve': Reader(samples.pitch_curve, {'*': mutations.any_text}, read_pitch, 2),
    'geotiff': Reader(samples.geotiff, {'*.tif': mutations.any_bytes}, read_dem, 8),
    'dem_folder': Reader(samples.dem_folder, {'*.npy': mutations.any_npy,
                                              '*.yaml': mutations.any_yaml}, read_dem),
    'mesh': Reader(samples.mesh, {'*.obj': mutations.any_text, 'text.*': mutations.any_text,
                                  '*.off': mutations.any_text, 'surface.stl': mutations.any_bytes,
                                  'surface.ply': mutations.any_bytes,
                                  '*.glb': mutations.any_glb}, read_mesh, 10),
    'world': Reader(samples.world, {'world/*.npy': mutations.any_npy,
                                    'world/*.npz': mutations.any_npz,
                                    'world/*.yaml': mutations.any_yaml}, read_world, 6),
    'mcap': Reader(samples.mcap, _BAG, read_bag, 10),
    'mcap_zstd': Reader(samples.mcap_zstd, _BAG, read_bag),
    'sqlite': Reader(samples.sqlite, _BAG, read_bag, 8),
    'cut_mcap': Reader(samples.cut_mcap, _BAG, read_cut_bag),
    'cut_sqlite': Reader(samples.cut_sqlite, _BAG, read_cut_bag, 3),
    'sequence': Reader(samples.sequence, {'euroc/mav0/cam*/*.yaml': mutations.any_yaml,
                                          'euroc/times.txt': mutations.any_text,
                                          'euroc/mav0/cam*/data/*.png': mutations.any_bytes},
                       read_sequence, 3),
    'images': Reader(samples.images, {'set/*/*.png': mutations.any_bytes,
                                      'set/*/*.npy': mutations.any_npy,
                                      'set/*.yaml': mutations.any_yaml}, read_images),
    'polar': Reader(samples.polar, {'set/*/*/*/*.png': mutations.any_bytes,
                                    'set/*/*.calibration': mutations.any_text}, read_images),
    'dataset': Reader(samples.dataset, {'*.json': mutations.any_json,
                                        '*/*/*.json': mutations.any_json,
                                        '*/*/kitti/*/*.png': mutations.any_bytes}, read_dataset),
}

# Command lines that read the same input; {new} does not exist.
COMMANDS = {
    'scenario': 'render {file} -o {new}',
    'rover': 'calibrate gait --set rover={file} -o {new}',
    'campaign': 'campaign {file} --dry-run',
    'trajectory': 'evaluate {file} {file} --times {folder}/times.txt',
    'pitch_curve': 'validate locomotion --overlay {file} -o {new}',
    'geotiff': 'world build --dem {file} -o {new}',
    'dem_folder': 'world build --dem {folder} -o {new}',
    'mesh': 'world build --mesh {file} -o {new}',
    'world': 'world info {folder}/world',
    'mcap': 'bag check {folder}/bag',
    'mcap_zstd': 'bag hash {folder}/bag',
    'sqlite': 'bag info {folder}/bag',
    'cut_mcap': 'bag recover {folder}/bag',
    'cut_sqlite': 'bag recover {folder}/bag',
    'images': 'evaluate images {folder}/set {folder}/set',
    'polar': 'evaluate images {folder}/set {folder}/set',
    'dataset': 'dataset card {folder}',
}
