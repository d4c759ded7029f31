"""The skyline: its pixels are as bright as the share of them that is ground."""

import dataclasses

import camera_scene as scene
import numpy as np
import pytest
import worlds

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.world.build import build_world, MOON_RADIUS_M
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.rover.pose import RoverPose

FINER = 8


def rolled(roll_deg):
    """Return T_world_base of a rover that leans to the side."""
    return se3(matrix_from_wxyz(wxyz_from_rpy(np.radians(roll_deg), 0.0, 0.0)), (0.0, 0.0, 0.1))


def draw(world, pose, finer=1):
    """Return left radiance and depth, with so many pixels per pixel of 160 x 120."""
    camera = CameraConfig(width=160 * finer, height=120 * finer)
    with Renderer(world, scene.ROVER, scene.config(
            40.0, 180.0, camera=camera,
            detail=dataclasses.replace(scene.SMOOTH, smooth_outlines=True))) as renderer:
        frame = renderer.render(RoverPose(pose), layers=('radiance', 'depth'))
    return frame.radiance.astype(float), frame.depth_m


def hills():
    """Return a world whose skyline is a ridge of several slopes."""
    y = (np.arange(513) - 256)[:, None] * 0.025
    x = (np.arange(513) - 256)[None, :] * 0.025
    return scene.plane(heights=(0.25 * np.sin(1.3 * y) + 0.4) * np.exp(-(x - 4.0)**2), far=False)


@pytest.mark.parametrize(('world', 'roll_deg'), [
    (scene.plane(), 1.0), (scene.plane(), -25.0), (hills(), 0.0)])
def test_share_of_ground(world, roll_deg):
    radiance, depth = draw(world, rolled(roll_deg))
    _, fine = draw(world, rolled(roll_deg), FINER)
    share = (np.nan_to_num(fine, posinf=0.0) > 0.0).reshape(120, FINER, 160, FINER).mean((1, 3))
    ground = np.nan_to_num(depth, posinf=0.0) > 0.0
    row, column = np.nonzero((share > 0.0) & (share < 1.0))
    inside = (row > 3) & (row < 114) & (column > 3) & (column < 156)
    row, column = row[inside], column[inside]
    full = radiance[row + 3, column]            # ground of about the same brightness
    drawn = np.sqrt(np.mean((radiance[row, column] / full - share[row, column])**2))
    stepped = np.sqrt(np.mean((ground[row, column] - share[row, column])**2))
    assert len(row) > 100 and stepped > 0.2
    assert drawn < 0.45 * stepped


def test_the_horizon_is_that_of_the_sphere():
    """It lies sqrt(2 h / R) below the horizontal; that of a plane 3.3 km wide hardly does."""
    flat = {**worlds.BARE, 'size_m': 12.8, 'surroundings': {'extent_m': 3000.0, 'samples': 513}}
    world = build_world(WorldConfig.from_mapping(flat), 0)
    camera = CameraConfig(width=64, height=128, horizontal_fov_deg=1.0)
    with Renderer(world, scene.ROVER, scene.config(15.0, 180.0, camera=camera)) as renderer:
        # The cameras look 10 deg down.
        state = RoverPose(scene.pose(z=0.4, pitch_deg=-10.0))
        frame = renderer.render(state, layers=('depth',))
        T_world_left = state.T_world_base @ renderer.rig.T_base_left
        rays = renderer.rig.rays() @ T_world_left[:3, :3].T
    up = rays[:, 32, 2] / np.hypot(rays[:, 32, 0], rays[:, 32, 1])
    first = int(np.argmax(np.isfinite(frame.depth_m[:, 32])))
    pixel = abs(up[1] - up[0])
    dip = np.sqrt(2.0 * T_world_left[2, 3] / MOON_RADIUS_M)
    assert up[first] == pytest.approx(-dip - 0.5 * pixel, abs=pixel)
    # It has moved by two pixels.
    assert dip - T_world_left[2, 3] / world.levels[-1].half_extent_m > 2.0 * pixel


def test_nothing_but_the_skyline_is_touched():
    """Depth knows no half pixels, and the image of the ground does not depend on it."""
    radiance, depth = draw(hills(), rolled(0.0))
    ground = np.nan_to_num(depth, posinf=0.0) > 0.0
    edge = np.zeros_like(ground)
    edge[:-1] |= ground[1:] & ~ground[:-1]
    assert np.all(radiance[~ground & ~edge] == 0.0)
    assert 0 < np.count_nonzero(radiance[~ground & edge]) < 160
    assert np.all(radiance[ground] > 0.0)
