"""What each reader is given, and what must hold of everything that it accepts.

`read` gets the folder with the mutated files, that with the valid ones, the name of the file that
was mutated, and a generator. It ends normally where the input is accepted and right, raises an
error of the package where it is refused, and `Contradiction` where something was accepted that the
documentation excludes.
"""

from collections.abc import Callable, Mapping
import dataclasses
import functools
import math
from pathlib import Path
import random

from bag_readers import read_bag, read_cut_bag, read_cut_end
from claims import claim, one_line, within_bounds
import mutations
import numpy as np
import samples
from world_readers import read_dem, read_marked, read_mesh, read_orbital, read_placed, read_world

from lunar_rover_sim.base.files.yaml_text import read_text
from lunar_rover_sim.base.parameters import Parameters
from lunar_rover_sim.campaign.campaign_file import draw, episode, parse_campaign
from lunar_rover_sim.campaign.card import write_card
from lunar_rover_sim.campaign.manifest import EPISODES, why_unfinished
from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.judge.evaluation.image_comparison import compare_images
from lunar_rover_sim.judge.evaluation.image_layouts import open_images
from lunar_rover_sim.judge.evaluation.trajectory_files import read_kitti, read_trajectory
from lunar_rover_sim.judge.slam import euroc_reader
from lunar_rover_sim.judge.slam.table import read_paper
from lunar_rover_sim.rover.description import load_rover
from lunar_rover_sim.rover.gait.calibration import GaitCalibration
from lunar_rover_sim.rover.gait.config import GaitConfig
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.urdf import urdf
from lunar_rover_sim.rover.visual import visual_parts
from lunar_rover_sim.run.scenario import Scenario


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
    write_card(folder)


_BAG = {'bag/*.yaml': mutations.any_yaml, 'bag/*.mcap': mutations.any_bytes,
        'bag/*.db3': mutations.any_bytes}

READERS: dict[str, Reader] = {
    'scenario': Reader(samples.scenario, {'*.yaml': mutations.any_yaml}, read_scenario, 6),
    'rover': Reader(samples.rover, {'*.yaml': mutations.any_yaml}, read_rover, 6),
    'campaign': Reader(samples.campaign, {'*.yaml': mutations.any_yaml}, read_campaign),
    'gait': Reader(samples.gait, {'*.yaml': mutations.any_yaml}, read_gait, 6),
    'published': Reader(samples.published, {'*.yaml': mutations.any_yaml}, read_published, 2),
    'trajectory': Reader(samples.trajectory, {'*': mutations.any_text}, read_trajectories, 6),
    'geotiff': Reader(samples.geotiff, {'*.tif': mutations.any_bytes}, read_dem, 8),
    'dem_folder': Reader(samples.dem_folder, {'*.npy': mutations.any_npy,
                                              '*.yaml': mutations.any_yaml}, read_dem),
    'placed': Reader(samples.geotiff, {'*.tif': mutations.none}, read_placed, 4),
    'marked': Reader(samples.marked, {'dem.npy': mutations.none}, read_marked, 4),
    'mesh': Reader(samples.mesh, {'*.obj': mutations.any_text, 'text.*': mutations.any_text,
                                  '*.off': mutations.any_text, 'surface.stl': mutations.any_bytes,
                                  'surface.ply': mutations.any_bytes,
                                  '*.glb': mutations.any_glb}, read_mesh, 10),
    'world': Reader(samples.world, {'world/*.npy': mutations.any_npy,
                                    'world/*.npz': mutations.any_npz,
                                    'world/*.yaml': mutations.any_yaml}, read_world, 6),
    'orbital': Reader(samples.orbital, {'maps/*json': mutations.any_json,
                                        'maps/*.tif': mutations.any_bytes}, read_orbital, 6),
    'mcap': Reader(samples.mcap, _BAG, read_bag, 10),
    'mcap_zstd': Reader(samples.mcap_zstd, _BAG, read_bag),
    'sqlite': Reader(samples.sqlite, _BAG, read_bag, 8),
    'cut_mcap': Reader(samples.cut_mcap, _BAG, read_cut_bag),
    'cut_end': Reader(samples.cut_end, {'bag/*.mcap': mutations.cut}, read_cut_end, 4),
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
    'geotiff': 'world build --dem {file} -o {new}',
    'dem_folder': 'world build --dem {folder} -o {new}',
    'mesh': 'world build --mesh {file} -o {new}',
    'world': 'world info {folder}/world',
    'mcap': 'bag check {folder}/bag',
    'mcap_zstd': 'bag hash {folder}/bag',
    'sqlite': 'bag info {folder}/bag',
    'cut_mcap': 'bag recover {folder}/bag',
    'cut_end': 'bag recover {folder}/bag',
    'images': 'evaluate images {folder}/set {folder}/set',
    'polar': 'evaluate images {folder}/set {folder}/set',
    'dataset': 'dataset card {folder}',
}
