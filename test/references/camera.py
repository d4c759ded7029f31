"""Cameras: lenses, fisheyes, sensors, exposures, mounts, flow."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from references.cases import reference
from references.scenes import hills, stony_world, waves

from lunar_rover_sim.camera import distorted_image, distortion, equidistant
from lunar_rover_sim.camera.blooming import bloom
from lunar_rover_sim.camera.chase import ChaseConfig, ChaseMount, looking_at
from lunar_rover_sim.camera.compression import compressed
from lunar_rover_sim.camera.compression_config import CompressionConfig
from lunar_rover_sim.camera.config import (CameraConfig, FurtherCameraConfig, LensConfig,
                                           SensorConfig)
from lunar_rover_sim.camera.encoding import encoding_of
from lunar_rover_sim.camera.exposure import (AutoExposure, first_exposure_s, lamplit_radiance,
                                             sunlit_radiance)
from lunar_rover_sim.camera.fisheye import FisheyeCamera, FisheyeLens
from lunar_rover_sim.camera.flow import FlowModel, Moved
from lunar_rover_sim.camera.hazard import fixed_frames, HazardMount, HazardRig, sides
from lunar_rover_sim.camera.hazard_config import HazardCameraConfig, HazardConfig
from lunar_rover_sim.camera.lens import Glare, Lens
from lunar_rover_sim.camera.models import geometry_of
from lunar_rover_sim.camera.mount import BodyMount, MovingMount, TurnedMount
from lunar_rover_sim.camera.prediction import prediction_miss
from lunar_rover_sim.camera.rig import PinholeCamera, StereoRig
from lunar_rover_sim.camera.sensor import SensorModel
from lunar_rover_sim.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.illumination.config import LampConfig, ReflectanceConfig, SunConfig
from lunar_rover_sim.physics.state import RoverState
from lunar_rover_sim.rover.description import RoverDescription, StereoMount

_ROVER = RoverDescription(stereo=StereoMount(position_m=(0.1, 0.02, 0.2), pitch_deg=17.0))
_LENSES = ((0.0,) * 5, (-0.1, 0.02, 0.001, -0.002, 0.003), (0.2, -0.05, 0.0, 0.01, 0.0),
           (-0.25, 0.07, 0.004, 0.002, -0.01))


def _pose(k: float) -> np.ndarray:
    return se3(matrix_from_wxyz(wxyz_from_rpy(0.03 * math.sin(k), 0.05 * math.cos(2.0 * k),
                                              0.2 * k)),
               np.array([0.1 * k, 0.02 * k * k, 0.15 + 0.01 * math.sin(3.0 * k)]))


def _state(k: float) -> RoverState:
    rng = np.random.default_rng(int(10.0 * k) + 1)
    return RoverState(
        0, _pose(k)[:3, 3], wxyz_from_rpy(0.03, -0.1, 0.2 * k), *rng.normal(size=(2, 3)),
        *rng.normal(size=(4, 4)), *rng.normal(size=(2, 4, 3)), *rng.normal(size=(2, 3)))


@reference
def distortions() -> dict[str, Any]:
    """Coordinates there and back, what can be inverted, margins of pinhole images."""
    xy = np.random.default_rng(1).uniform(-0.8, 0.8, (120, 2))
    found: dict[str, Any] = {}
    for k, lens in enumerate(_LENSES):
        camera = CameraConfig(width=67, height=45, horizontal_fov_deg=61.0, distortion=lens)
        found[f'{k}'] = {'distorted': distortion.distort(xy, lens),
                         'back': distortion.undistort(0.9 * xy, lens),
                         'margin': str(distorted_image.padding(camera)),
                         'source': np.array(distorted_image.source_pixels(camera)),
                         'focal': camera.focal_px, 'is': camera.distorted}
    found['invertible'] = [distortion.is_invertible((k1, k2, p1, 0.0, k3), 0.7, 0.5)
                           for k1 in (-0.9, -0.6, -0.45, -0.3, 0.5, 1.9) for k2 in (-0.3, 0.0, 0.2)
                           for p1 in (0.0, 0.2) for k3 in (-0.2, 0.0)]
    found['lost'] = distortion.undistort(4.0 * xy, (-0.4, 0.0, 0.0, 0.0, 0.0))
    return found


@reference
def fisheyes() -> dict[str, Any]:
    """Radii, directions, falloff and hoods of fisheyes."""
    found: dict[str, Any] = {}
    points = np.random.default_rng(2).normal(size=(80, 3))
    angles = np.linspace(0.0, 1.6, 33)
    for name, k in (('ideal', (0.0,) * 4), ('real', (0.03, -0.02, 0.006, -0.001))):
        camera = HazardCameraConfig(width=61, height=43, horizontal_fov_deg=150.0,
                                    image_circle_deg=170.0, fisheye_distortion=k)
        made = FisheyeCamera(camera)
        pixels = made.pixels()
        lens = FisheyeLens(LensConfig(hood_deg=12.0), camera)
        found[name] = {
            'radius': equidistant.radius(angles, k), 'slope': equidistant.radius_slope(angles, k),
            'angle': equidistant.angle(np.linspace(0.0, 2.0, 33), k, 1.5),
            'K': made.K, 'P': made.P_left, 'D': made.D, 'R': made.R, 'focal': made.focal_px,
            'limit': made.limit_rad, 'projected': made.project(points),
            'directions': made.directions(pixels), 'angles': made.angles(pixels),
            'falloff': made.falloff(pixels), 'reach': lens.reach, 'corner': lens.corner_rad,
            'hood': np.array([lens.hood(a) for a in np.linspace(0.0, 2.6, 40)]),
            'peak': lens.scatter_peak, 'logarithm': FisheyeLens(LensConfig(
                scatter_exponent=2.0), camera).scatter_peak}
    found['grows'] = [equidistant.grows((a, b, 0.0, 0.0), 1.5) for a in (-0.3, -0.14, -0.1, 0.1)
                      for b in (-0.05, 0.0, 0.01)]
    kinds = [FurtherCameraConfig(), HazardConfig(), HazardConfig(camera=HazardCameraConfig(
        model='pinhole', horizontal_fov_deg=90.0))]
    found['kinds'] = [f'{type(geometry_of(kind)).__name__} {geometry_of(kind).width} '
                      f'{kind.camera.focal_px:.6f}' for kind in kinds]
    return found


@reference
def lenses() -> dict[str, Any]:
    """Scattered light, veils, hoods, glare."""
    found: dict[str, Any] = {}
    camera = CameraConfig(width=96, height=60, horizontal_fov_deg=55.0)
    image = 10.0 * waves((5, 8)) + 300.0 * (np.indices((5, 8)).sum(axis=0) == 6)
    for name, config in (('default', LensConfig()), ('perfect', LensConfig(
            scatter_share=0.0, veil_share=0.0)), ('dusty', LensConfig(
                scatter_share=0.05, scatter_exponent=2.0, scatter_core_deg=0.7, veil_share=0.02,
                hood_deg=4.0)), ('veil', LensConfig(scatter_share=0.0, hood_deg=0.0))):
        lens = Lens(config, camera)
        rays = np.random.default_rng(3).normal(size=(40, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        found[name] = {
            'perfect': lens.perfect, 'direct': lens.direct_share, 'peak': lens.scatter_peak,
            'scatter': lens.scatter(np.linspace(0.0, 2.0, 20)), 'corner': lens.corner_rad,
            'hood': np.array([lens.hood(a) for a in np.linspace(0.0, 1.7, 60)]),
            'strays': np.array([lens.strays(ray) for ray in rays]),
            'glare': Glare(lens, (5, 8), 12, 96 * 60).of(np.stack([image, image[::-1]]))}
    return found


@reference
def sensors() -> dict[str, Any]:
    """Constants of sensors, exposures from light and from images, blooming."""
    found: dict[str, Any] = {}
    camera = CameraConfig()
    radiance = (3.0 * waves((40, 50))**3).astype(np.float32)
    radiance[5, 7], radiance[:4] = 1e6, 0.0
    for name, config in (
            ('default', SensorConfig()),
            ('auto', SensorConfig(exposure_mode='auto', encoding='mono16', bits=10, f_number=2.8,
                                  psf_sigma_px=0.3, target_level=0.3, black_level=0.02)),
            ('fixed', SensorConfig(exposure_mode='fixed', companding='linear', encoding='rgb8',
                                   exposure_s=0.003, pixel_well=1.3, auto_lag=0.2, auto_max_s=0.5,
                                   transmission=0.7, target_level=0.6))):
        sensor = SensorModel(camera, config)
        image = np.clip(waves((30, 44)) * np.iinfo(sensor.output_type).max, 0, None).astype(
            sensor.output_type)
        auto, rows = AutoExposure(sensor), []
        auto.start(radiance)
        rows.append(auto.exposure_s)
        for factor in (1.0, 0.3, 0.01, 0.0, 1.0):
            auto.follow((factor * image).astype(image.dtype))
            rows.append(auto.exposure_s)
        found[name] = {
            'per second': sensor.electrons_per_radiance_second, 'well': sensor.well_e,
            'largest': sensor.largest_number, 'gain': sensor.gain_dn_per_e,
            'scale': list(sensor.output_scale), 'root': sensor.companded,
            'neighbour': sensor.neighbour_weight, 'linear': sensor.linear(image),
            'for': [sensor.exposure_for(r) for r in (0.0, 0.1, 7.0, 1e7)], 'exposures': rows,
            'aim': auto.aim, 'first': [first_exposure_s(sensor, SunConfig(elevation_deg=e), lamp,
                                                        ReflectanceConfig())
                                       for e in (-0.9, 0.2, 8.0, 80.0)
                                       for lamp in (LampConfig(), LampConfig(power_w=4.0))]}
    found['sunlit'] = [sunlit_radiance(SunConfig(elevation_deg=e), ReflectanceConfig('mare'))
                       for e in (-1.0, 0.1, 6.0, 89.0)]
    found['lamplit'] = lamplit_radiance(LampConfig(power_w=2.0), ReflectanceConfig('basalt'))
    charge = 900.0 * waves((23, 9))**2
    charge[7, 3] = charge[20, 5] = 9000.0
    found['bloomed'] = [bloom(charge, 500.0, share) for share in (0.0, 0.4, 1.0)]
    return found


@reference
def compressed_images() -> dict[str, Any]:
    """Formats, and what of the pixels is left."""
    found: dict[str, Any] = {}
    grey = (255.0 * waves((33, 47))).astype(np.uint8)
    colour = np.stack([grey, grey[::-1], 255 - grey], axis=-1)
    for name, pixels in (('grey', grey), ('deep', grey.astype(np.uint16) * 257), ('rgb', colour)):
        for config in (CompressionConfig(), CompressionConfig('png'),
                       CompressionConfig('jpeg', 40)):
            text, data = compressed(pixels, config)
            back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            # Decoders of JPEG differ by a level or so.
            mean = [f'{float(level):.0f}' for level in np.atleast_1d(back.mean(axis=(0, 1)))]
            found[f'{name} {config.format} {config.jpeg_quality}'] = [
                text, ' '.join(mean), str(back.dtype), len(data) < 9 * grey.size // 10]
    found['encodings'] = [encoding_of(pixels) for pixels in (
        grey, colour, grey.astype(np.uint16), grey.astype(np.float32),
        np.zeros((2, 3, 3), np.float32))]
    return found


@reference
def rigs() -> dict[str, Any]:
    """Where cameras are, what they see of points, and how they move."""
    camera = CameraConfig(width=81, height=57, horizontal_fov_deg=66.0)
    rig, pinhole = StereoRig(_ROVER, camera), PinholeCamera(camera)
    points = np.random.default_rng(4).uniform(-3.0, 3.0, (60, 3)) + [2.0, 0.0, 0.0]
    pair = HazardConfig(stereo_baseline_m=0.13, orientation_rpy_deg=(4.0, 25.0, 170.0))
    state = _state(0.7)
    found: dict[str, Any] = {
        'K': rig.K, 'P': [rig.P_left, rig.P_right], 'T': [rig.T_base_left, rig.T_base_right],
        'projected': list(rig.project(points, _pose(0.4))), 'rays': pinhole.rays(),
        'falloff': pinhole.falloff(points[:, :2] * 20.0), 'focal': rig.focal_px,
        'links': list(HazardRig(pair).link_poses()), 'sides': [list(sides('front', pair)), list(
            sides('rear', HazardConfig()))],
        'frames': [f'{parent} {child}' for parent, child, _ in fixed_frames('front', pair)],
        'poses': [pose for *_, pose in fixed_frames('front', pair)]}
    moving = MovingMount()
    moving.place(looking_at(np.array([2.0, 1.0, 0.8]), np.array([0.0, 0.1, 0.0])),
                 np.array([0.1, 0.2, -0.1]), np.array([0.0, 0.1, 0.3]))
    turned = matrix_from_wxyz(wxyz_from_rpy(0.2, 1.0, 0.0))
    for name, mount in (('body', BodyMount(rig)), ('hazard', HazardMount(pair)),
                        ('beside', moving)):
        twists = [mount.ground_twist(state, 1), *mount.link_twists(state, 1, _ROVER)]
        rays = np.column_stack([points[:, :2], np.ones(60)])
        found[name] = {'poses': mount.poses(state), 'twists': twists, 'on body': mount.on_body,
                       'speeds': np.array([t.image_speed(rays, np.linspace(0.0, 2.0, 60))
                                           for t in twists]),
                       'turned': TurnedMount(mount, turned).poses(state)}
    return found


@reference
def chase_cameras() -> dict[str, Any]:
    """A camera that follows, from sides and above rocks, and one that stands."""
    found: dict[str, Any] = {}
    world = stony_world((hills(97, 0.05, 0.1),), 14)
    for name, config in (
            ('sun', ChaseConfig()), ('heading', ChaseConfig(
                reference='heading', azimuth_deg=150.0, distance_m=0.9, elevation_deg=-5.0)),
            ('east', ChaseConfig(reference='east', smoothing_s=0.0, aim_m=0.2, distance_m=2.2,
                                 elevation_deg=2.0)),
            ('tripod', ChaseConfig(mode='tripod', position_m=(0.8, -0.5, 0.3)))):
        mount, rows = ChaseMount(config, 75.0, world), []
        for k, stamp in ((0, 0), (1, 10**8), (2, 3 * 10**8), (2, 3 * 10**8), (3, 6 * 10**8),
                         (40, 7 * 10**8), (4, 10**8)):
            mount.follow(_state(float(k) / 2.0), stamp)
            rows.append([*mount.T_world_camera.ravel(), *mount.ground_twist(
                _state(0.0), 0).linear_velocity_mps, *mount.ground_twist(
                    _state(0.0), 0).angular_velocity_radps])
        found[name] = np.array(rows)
    found['down'] = looking_at(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    return found


@reference
def predictions() -> dict[str, Any]:
    """How far a prediction by constant velocity misses."""
    found: dict[str, Any] = {}
    poses = np.array([_pose(0.3 * k) for k in range(25)])
    for pitch in (17.0, -40.0, 60.0):
        rover = dataclasses.replace(_ROVER, stereo=dataclasses.replace(_ROVER.stereo,
                                                                       pitch_deg=pitch))
        rig = StereoRig(rover, CameraConfig(width=161, height=119))
        miss = prediction_miss(poses, rig, 0.09, 7.0)
        found[f'{pitch}'] = miss
        found[f'text {pitch}'] = str(miss)
        found[f'few {pitch}'] = prediction_miss(poses[:2], rig, 0.09, 7.0) is None
    return found


@reference
def flows() -> dict[str, Any]:
    """Optical flow and scene flow, forward and back, with a body that moves."""
    K = PinholeCamera(CameraConfig(width=43, height=31)).K
    depth = (1.0 + 4.0 * waves((31, 43))).astype(np.float32)
    depth[:5] = np.inf
    mask = np.zeros((31, 43), bool)
    mask[12:20, 9:30] = True
    camera = se3(matrix_from_wxyz(wxyz_from_rpy(-1.7, 0.1, 0.2)), np.array([0.1, 0.2, 0.5]))
    found = {}
    for name, other, body in (('near', _pose(0.2), _pose(0.5)), ('far', _pose(9.0), _pose(-3.0))):
        model = FlowModel(K, depth, camera, other @ camera, [Moved(mask, _pose(0.1), body)])
        found[name] = {'optical': model.optical_flow(), 'scene': model.scene_flow()}
    return found
