"""Small worlds whose pictures can be computed by hand."""

import numpy as np

from lunar_rover_sim.base.frames import matrix_from_wxyz, se3, wxyz_from_rpy
from lunar_rover_sim.ground.regolith.overlay import Overlay
from lunar_rover_sim.ground.regolith.tracks import press, relax
from lunar_rover_sim.ground.world.config import WorldConfig
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.image.camera.config import SensorConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import DetailConfig, RenderConfig
from lunar_rover_sim.rover.description import RoverDescription

ROVER = RoverDescription()
IDEAL = SensorConfig(shot_noise=False, read_noise=False, fixed_pattern=False, psf_sigma_px=0.0,
                     vignetting=0.0, black_level=0.0, dark_current_e_s=0.0)
SMOOTH = DetailConfig(relief_rms_slope=0.0, pebble_cover=0.0, pit_cover=0.0, bounce=False,
                      smooth_outlines=False)
# Of tests with relief below the grid for which any sun will do: what the relief looks like under
# it takes 1.3 s, and is still at hand for the next one.
RELIEF_SUN = SunConfig(azimuth_deg=20.0, elevation_deg=8.0)


def block(name='pole', half=(0.5, 0.5, 0.5)):
    """Return a box as a shape; its largest horizontal diameter is not scaled."""
    x, y, z = half
    corners = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
             [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return RockShape(name, corners.astype(np.float32), np.array(faces, np.int32))


def rocks(positions=(), diameter=1.0):
    """Return upright rocks of the first shape at (m, 3) centroids."""
    m = len(positions)
    return Rocks(np.zeros(m, np.int32), np.zeros(m, np.int32),
                 np.reshape(np.asarray(positions, float), (m, 3)),
                 np.tile([1.0, 0.0, 0.0, 0.0], (m, 1)), np.ones(m, np.float32),
                 np.array([diameter]))


def plane(n=513, cell_m=0.025, heights=None, stones=None, shape=None, far=True):
    """Return a flat world, or one with the given heights of the finest level."""
    z = np.zeros((n, n), np.float32) if heights is None else heights.astype(np.float32)
    levels = [HeightGrid(z, cell_m)]
    if far:
        levels.append(HeightGrid(np.zeros((n, n), np.float32), 8 * cell_m))
    return World(tuple(levels), np.ones((n, n), np.float32), stones or rocks(),
                 (shape or block(),), WorldConfig(), '0' * 32)


def config(elevation_deg=6.0, azimuth_deg=90.0, **groups):
    """Return a configuration without noise and without relief below the grid."""
    groups.setdefault('sensor', IDEAL)
    groups.setdefault('detail', SMOOTH)
    groups.setdefault('sun', SunConfig(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg))
    return RenderConfig(**groups)


def pose(x=0.0, y=0.0, z=0.1, yaw_deg=0.0, pitch_deg=0.0):
    """Return T_world_base."""
    turn = matrix_from_wxyz(wxyz_from_rpy(0.0, np.radians(pitch_deg), np.radians(yaw_deg)))
    return se3(turn, (x, y, z))


def hills(n=513, cell_m=0.025, rms_m=0.03, seed=0):
    """Return (n, n) gently rolling heights with a crater, zero at the border."""
    rng = np.random.default_rng(seed)
    k = np.fft.fftfreq(n, cell_m)
    radius = np.hypot(k[:, None], k[None])
    radius[0, 0] = 1.0
    amplitude = radius**-2.2 * (radius < 12.0) * (radius > 0.15)
    z = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * amplitude).real
    z *= rms_m / z.std()
    axis = (np.arange(n) - (n - 1) / 2) * cell_m
    edge = np.clip((axis[-1] - np.abs(axis)) / 0.5, 0.0, 1.0)
    return (z * edge[:, None] * edge).astype(np.float32)


def trodden(world, prints=8, x=0.45, seed=3):
    """Return an overlay with prints of 2 cm in front of the camera."""
    overlay, rng = Overlay(), np.random.default_rng(seed)
    for _ in range(prints):
        at = x + rng.uniform(-0.1, 0.3), rng.uniform(-0.15, 0.15)
        z = world.ground.height_at_point(*at)
        window = press(overlay, world.ground, (*at, z + 0.012), (*at, z - 0.008), 0.012, 0.5)
        relax(overlay, world.ground, window, 38.0)
    return overlay
