"""Lenses, image sensors, stereo matching and what is made of images and trajectories."""

from collections.abc import Callable

import numpy as np
from regression.conftest import DOUBLE, SINGLE
from regression.scenes import hilly_levels, stereo_pair, stony_world, waves
from scipy.spatial.transform import Rotation

from lunar_rover_sim.ground.world import albedo, far_rocks, fine_relief
from lunar_rover_sim.image.camera import distortion, miscalibration
from lunar_rover_sim.image.camera.config import CameraConfig, LensConfig, SensorConfig
from lunar_rover_sim.image.camera.development import AutoExposure, first_exposure_s
from lunar_rover_sim.image.camera.fisheye import FisheyeCamera
from lunar_rover_sim.image.camera.hazard import HazardCameraConfig
from lunar_rover_sim.image.camera.lens import Glare, Lens
from lunar_rover_sim.image.camera.rig import StereoRig
from lunar_rover_sim.image.camera.sensor import SensorModel
from lunar_rover_sim.image.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.image.stereo.config import SgmConfig
from lunar_rover_sim.image.stereo.error import stereo_errors
from lunar_rover_sim.image.stereo.sgm import refined, SgmMatcher
from lunar_rover_sim.judge.evaluation import statistics
from lunar_rover_sim.judge.evaluation.image_statistics import GreyPair, image_statistics, MEASURES
from lunar_rover_sim.judge.evaluation.trajectory import Trajectory, wxyz
from lunar_rover_sim.judge.evaluation.trajectory_evaluation import evaluate
from lunar_rover_sim.rover.description import RoverDescription

Unchanged = Callable[..., None]
# OpenCV interpolates between 32 places in a pixel; versions round to them differently.
REMAPPED = 1e-3
# Keypoints and matches are counted after floating-point arithmetic: a few may come or go.
COUNTED = 0.02


def test_lenses_and_their_glare(unchanged: Unchanged) -> None:
    camera = CameraConfig(width=96, height=60, horizontal_fov_deg=55.0)
    image = 10.0 * waves((5, 8)) + 300.0 * (np.indices((5, 8)).sum(axis=0) == 6)
    arrays = {}
    for name, config in (('default', LensConfig()), ('dusty', LensConfig(
            scatter_share=0.05, scatter_exponent=2.0, scatter_core_deg=0.7, veil_share=0.02,
            hood_deg=4.0))):
        lens = Lens(config, camera)
        arrays |= {f'{name}_shares': [lens.direct_share, lens.scatter_peak],
                   f'{name}_scatter': lens.scatter(np.linspace(0.0, 2.0, 20)),
                   f'{name}_hood': [lens.hood(np.array([np.sin(a), 0.0, np.cos(a)]))
                                    for a in np.linspace(0.0, 1.7, 60)],
                   f'{name}_glare': Glare(lens, (5, 8), 12, 96 * 60).of(
                       np.stack([image, image[::-1]]))}
    unchanged(SINGLE, **arrays)


def test_distorted_and_fisheye_pixels(unchanged: Unchanged) -> None:
    xy = np.random.default_rng(1).uniform(-0.8, 0.8, (120, 2))
    arrays = {}
    for k, lens in enumerate(((-0.1, 0.02, 0.001, -0.002, 0.003), (0.2, -0.05, 0.0, 0.01, 0.0))):
        camera = CameraConfig(width=67, height=45, horizontal_fov_deg=61.0, distortion=lens)
        arrays |= {f'distorted_{k}': distortion.distort(xy, lens),
                   f'back_{k}': distortion.undistort(0.9 * xy, lens),
                   f'source_{k}': miscalibration.source_pixels(camera)}
    made = FisheyeCamera(HazardCameraConfig(
        width=61, height=43, horizontal_fov_deg=150.0, image_circle_deg=170.0,
        fisheye_distortion=(0.03, -0.02, 0.006, -0.001)))
    pixels = made.pixels()
    unchanged(SINGLE, K=made.K, directions=made.directions(pixels), falloff=made.falloff(pixels),
              projected=made.project(np.random.default_rng(2).normal(size=(80, 3))), **arrays)


def test_electrons_and_exposures(unchanged: Unchanged) -> None:
    """Constants of image sensors, and exposures from light and from images."""
    radiance = (3.0 * waves((40, 50))**3).astype(np.float32)
    radiance[5, 7], radiance[:4] = 1e6, 0.0
    arrays = {}
    for name, config in (
            ('default', SensorConfig()),
            ('auto', SensorConfig(exposure_mode='auto', encoding='mono16', bits=10, f_number=2.8,
                                  psf_sigma_px=0.3, target_level=0.3, black_level=0.02)),
            ('fixed', SensorConfig(exposure_mode='fixed', companding='linear', encoding='rgb8',
                                   exposure_s=0.003, pixel_well=1.3, f_number=4.5355737))):
        sensor = SensorModel(CameraConfig(), config)
        image = np.clip(waves((30, 44)) * np.iinfo(sensor.output_type).max, 0, None).astype(
            sensor.output_type)
        auto = AutoExposure(sensor)
        auto.start(radiance)
        exposures = [auto.exposure_s]
        for factor in (1.0, 0.3, 0.01, 0.0, 1.0):
            auto.follow((factor * image).astype(image.dtype))
            exposures.append(auto.exposure_s)
        arrays |= {
            f'{name}_sensor': [sensor.electrons_per_radiance_second, sensor.well_e,
                               sensor.gain_dn_per_e, *sensor.output_scale,
                               sensor.neighbour_weight],
            f'{name}_linear': sensor.linear(image), f'{name}_exposures': exposures,
            f'{name}_first': [first_exposure_s(sensor, SunConfig(elevation_deg=e), lamp,
                                               ReflectanceConfig())
                              for e in (-0.9, 0.2, 8.0, 80.0)
                              for lamp in (LampConfig(), LampConfig(power_w=4.0))]}
    unchanged(SINGLE, **arrays)


def test_disparities_by_each_mode(unchanged: Unchanged) -> None:
    """Mean and samples of disparity, how much is valid, and the errors against truth."""
    left, right, truth, right_truth = stereo_pair()
    height, width = left.shape
    rig = StereoRig(RoverDescription(), CameraConfig(width=width, height=height))
    arrays = {}
    for name, config in (
            ('three_way', SgmConfig(num_disparities=32)),
            ('sgbm', SgmConfig(mode='sgbm', half_resolution=False, unexplained_percent=100,
                               num_disparities=16, min_disparity=3, block_size=5,
                               p1=90, p2=700, uniqueness_percent=15, dark_level=0,
                               min_contrast=0.0)),
            ('hh', SgmConfig(mode='hh', half_resolution=False, unexplained_percent=100,
                             num_disparities=32, block_size=3, min_disparity=-5,
                             speckle_window_px=0, left_right_max_px=-1, pre_filter_cap=10))):
        made = SgmMatcher(config, rig).match(left, right)
        errors = stereo_errors(made, truth, right_truth, left)
        arrays |= {f'{name}_disparity': np.where(made.valid, made.disparity_px, np.nan),
                   f'{name}_valid': [np.mean(made.valid)],
                   f'{name}_errors': list(errors.summary().values())}
    rough = np.round(truth) + 0.4 * (np.indices((height, width)).sum(axis=0) % 3 - 1.0)
    known = np.random.default_rng(1).random((height, width)) > 0.2
    unchanged(REMAPPED, refined=refined(rough.astype(np.float32), known, left, right), **arrays)


def test_statistics_of_images(unchanged: Unchanged) -> None:
    left, right, truth, _ = stereo_pair()
    scale = np.float32(1.0 / 255.0)
    alone = image_statistics(GreyPair('a', left * scale, right * scale), False)
    known = image_statistics(GreyPair('b', left * scale, right * scale, truth), True)
    unchanged(COUNTED, gradients=alone.log_gradients,
              **dict(zip(MEASURES, np.transpose([alone.values, known.values]))))


def test_intervals_of_a_series(unchanged: Unchanged) -> None:
    rng = np.random.default_rng(6)
    series = np.cumsum(rng.normal(size=50)) * 0.1 + 3.0
    mean, resamples = statistics.estimate(series, np.random.default_rng(2))
    first = rng.random((12, 20))
    unchanged(DOUBLE, lengths=[statistics.block_length(n) for n in (1, 2, 5, 27, 40, 900)],
              mean=list(np.ravel([mean.value, mean.low, mean.high])), resamples=resamples,
              chance=np.ravel(statistics.permutation_p(first, rng.random((9, 20)) ** 2,
                                                       np.random.default_rng(3), 150)))


def drifting(count: int, period_ns: int, start_ns: int, error: float) -> Trajectory:
    """Return a rolling curve; error: how far it drifts and turns away."""
    t = (np.arange(count) * period_ns + start_ns) * 1e-9
    rng = np.random.default_rng(3)
    positions = np.column_stack([0.4 * t + 0.02 * np.sin(7.0 * t), np.sin(0.5 * t),
                                 0.05 * np.cos(3.0 * t)])
    turns = Rotation.from_euler('ZYX', np.column_stack([
        0.3 * t, 0.1 * np.sin(5.0 * t), 0.05 * np.cos(4.0 * t)]))
    return Trajectory(np.arange(count) * period_ns + start_ns,
                      positions * (1.0 + error) + error * rng.normal(size=(count, 3)),
                      wxyz(turns * Rotation.from_rotvec(error * rng.normal(size=(count, 3)))))


def test_errors_of_a_trajectory(unchanged: Unchanged) -> None:
    """By three alignments, with an offset of the clocks and another frame."""
    truth = drifting(400, 20_000_000, 0, 0.0)
    estimate = drifting(150, 50_000_000, 7_000_001, 0.01).moved(
        Rotation.from_euler('xyz', [0.4, -0.2, 1.9]).as_matrix(), [3.0, -2.0, 0.5], 0.8)
    arrays = {}
    for mode in ('se3', 'sim3', 'yaw'):
        result = evaluate(truth, estimate, align=mode, tolerance_s=0.015, distance_m=0.7,
                          time_s=0.9).to_mapping()
        arrays[mode] = numbers_of(result)
    unchanged(DOUBLE, **arrays)


def numbers_of(value: object) -> list[float]:
    """Return all numbers of a nested mapping, in its order."""
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers_of(item)]
    if isinstance(value, (list, tuple)):
        return [number for item in value for number in numbers_of(item)]
    return [float(value)] if isinstance(value, (int, float)) else []


def test_ground_beyond_and_below_the_grid(unchanged: Unchanged) -> None:
    """Albedo and rocks of the coarse levels, and relief of millimetres for the shader."""
    world = stony_world(hilly_levels())
    recipe = fine_relief.TileRecipe(96, 0.4, 0.3, 0.05, 0.7, 0.2, (0.02, 0.09), 0.15, (0.01, 0.05))
    height = fine_relief.relief(recipe, np.random.default_rng(6))
    slope = fine_relief.slopes(height, recipe.period_m / recipe.n)
    horizon = fine_relief.horizon(height, recipe.period_m / recipe.n, 0.6,
                                  np.linspace(-0.2, 1.1, 14))
    made = fine_relief.mip_levels(slope, horizon, horizon, 3.0, 0.1, 0.5)
    rocks = far_rocks.far_rocks(world, 9.0)
    # Places of far rocks follow from exponentials in single precision, on no lattice.
    unchanged(1e-4, albedo_1=albedo.far_albedo(world, 1),
              albedo_2=albedo.far_albedo(world, 2), number=[len(rocks)],
              places=rocks.position_m, height=height, slope=slope, horizon=horizon,
              variance=np.concatenate([np.ravel(level) for level in made.slope_variance]))
