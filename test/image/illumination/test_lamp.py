"""The lamp: its beam makes the configured flux, and falls off with the square of the distance."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
from scipy import integrate

from lunar_rover_sim.image.illumination.config import LampConfig
from lunar_rover_sim.image.illumination.hapke import reflectance, SETS
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose


@pytest.mark.parametrize('cone_deg', [10.0, 60.0, 150.0])
@pytest.mark.parametrize('power_w', [1.0, 20.0])
def test_the_whole_beam_carries_the_flux(cone_deg, power_w):
    lamp = LampConfig(power_w=power_w, cone_deg=cone_deg)
    exponent, peak = lamp.beam_exponent, lamp.peak_intensity
    flux, _ = integrate.quad(lambda a: 2.0 * np.pi * np.sin(a) * peak * np.cos(a)**exponent,
                             0.0, np.pi / 2.0, points=[np.radians(cone_deg) / 2.0])
    assert flux == pytest.approx(power_w, rel=1e-6)
    # At half the full angle of the cone half of the intensity is left.
    assert np.cos(np.radians(cone_deg / 2.0))**exponent == pytest.approx(0.5)


@pytest.mark.parametrize('pitch_deg', [8.0, 20.0])
def test_lamplit_ground_is_as_bright_as_the_inverse_square_says(pitch_deg):
    """Level ground at night, 0.4 m to 3 m before the lamp, pixel by pixel against Hapke."""
    lamp = LampConfig(power_w=30.0, pitch_deg=pitch_deg, cone_deg=50.0,
                      position_m=(0.15, 0.02, 0.12))
    config = dataclasses.replace(scene.config(-1.0), lamp=lamp)
    T = scene.pose(0.0, 0.0, 0.1, 0.0)
    with Renderer(scene.plane(), scene.ROVER, config) as renderer:
        frame = renderer.render(RoverPose(T), 0, ('radiance', 'depth'))
        T_world_left = T @ renderer.rig.T_base_left
        depth = np.where(np.isfinite(frame.depth_m), frame.depth_m, 1e3)
        points = renderer.rig.rays() * depth[..., None] @ T_world_left[:3, :3].T
    points = points + T_world_left[:3, 3]
    position = T[:3, :3] @ lamp.position_m + T[:3, 3]
    axis = np.array([np.cos(np.radians(pitch_deg)), 0.0, -np.sin(np.radians(pitch_deg))])
    arm = position - points
    distance = np.linalg.norm(arm, axis=-1)
    to_lamp = arm / distance[..., None]
    view = T_world_left[:3, 3] - points
    view = view / np.linalg.norm(view, axis=-1, keepdims=True)
    cosine = -to_lamp @ axis
    ground = (np.abs(points[..., 2]) < 1e-3) & (cosine > 0.75)
    near = ground & (distance > 0.4) & (distance < 3.0)
    assert near.sum() > 4000 and np.ptp(distance[near]) > 2.0
    intensity = lamp.peak_intensity * cosine[near]**lamp.beam_exponent
    expected = intensity / distance[near]**2 * reflectance(
        to_lamp[near][:, 2], view[near][:, 2], (to_lamp[near] * view[near]).sum(axis=1),
        SETS['highland'])
    ratio = frame.radiance[near] / expected
    # In the shadow of a leg it is dark; elsewhere it is what the formula says. With the distance
    # more of the relief is left to the roughness of a pixel: up to 6 % less at a grazing angle.
    lit = ratio > 0.5
    assert lit.mean() > 0.85
    assert np.mean(np.abs(ratio[lit] - 1.0) < 0.06) > 0.97
