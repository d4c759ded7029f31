"""Small worlds and a plain trot for the tests of physics: no builder, no gait controller."""

from collections.abc import Callable
import dataclasses

import numpy as np
from scipy.optimize import brentq

from lunar_rover_sim.ground.regolith.config import GroundConfig
from lunar_rover_sim.ground.regolith.law import bearing_n
from lunar_rover_sim.ground.regolith.overlay import GroundChanges
from lunar_rover_sim.ground.world.grid import HeightGrid
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.rocks import Rocks, RockShape
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.illumination.sun_view import SeenSun, SunView
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.physics.config import PhysicsConfig
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.rover.physics.state import RoverState
from lunar_rover_sim.sensors.sun_from_rover import SkyRays

GRAVITY = 1.62
ROVER = RoverDescription()
WEIGHT_N = ROVER.total_mass_kg * GRAVITY
STATE_S = 0.005


def make_world(heights: np.ndarray | None = None, cell_m: float = 0.025,
               rocks: Rocks | None = None, shapes: tuple[RockShape, ...] = ()) -> World:
    """Return a world of one level; flat, 10 m wide, without rocks by default."""
    if heights is None:
        heights = np.zeros((401, 401))
    grid = HeightGrid(np.asarray(heights, dtype=np.float32), cell_m)
    if rocks is None:
        rocks = Rocks(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 3)),
                      np.zeros((0, 4)), np.zeros(0, np.float32), np.zeros(0))
    return World((grid,), np.ones_like(grid.heights_m), rocks, shapes, None, '')


def step_world() -> World:
    """Return a world with a step of 1 m, 2 m east of its middle."""
    heights = np.zeros((401, 401))
    heights[:, 200 + 80:] = 1.0
    return make_world(heights)


def sun_seen(simulation: Simulation, world: World, place: np.ndarray, azimuth_deg: float,
             elevation_deg: float) -> SeenSun | None:
    """Return what a place (3,) in base_link sees of a sun."""
    view = SunView(world, SunConfig(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg))
    T = simulation.state.T_world_base
    return view.seen_from(T[:3, :3] @ place + T[:3, 3], SkyRays(simulation).reached)


def plane_heights(slope_deg: float, n: int = 401, cell_m: float = 0.025) -> np.ndarray:
    """Return heights that rise towards +x."""
    x = (np.arange(n) - (n - 1) / 2) * cell_m
    return np.tile(np.tan(np.radians(slope_deg)) * x, (n, 1))


def rough_heights(seed: int = 1, n: int = 401, rms_m: float = 0.02) -> np.ndarray:
    """Return smooth hills with wavelengths of some decimetres, far below height 0."""
    spectrum = np.fft.rfft2(np.random.default_rng(seed).normal(size=(n, n)))
    fx, fy = np.meshgrid(np.fft.rfftfreq(n), np.fft.fftfreq(n))
    smooth = np.fft.irfft2(spectrum * np.exp(-(fx ** 2 + fy ** 2) * 2.0 * 80.0), (n, n))
    return smooth * rms_m / smooth.std() - 7.0


def trot(simulation: Simulation, duration_s: float, frequency_hz: float = 1.0, duty: float = 0.6,
         foot_width_rad: float = np.pi / 3,
         observe: Callable[[RoverState], None] = lambda state: None) -> RoverState:
    """Walk an open-loop diagonal trot with linear stance and flight, at 200 Hz."""
    pitch = simulation.rover.legs.spoke_pitch_rad
    phase = np.array([0.0, 0.5, 0.5, 0.0])
    steps = round(STATE_S / simulation.config.step_s)
    state = simulation.state
    for i in range(round(duration_s / STATE_S)):
        rate = frequency_hz * min(1.0, i * STATE_S / 0.5)
        cycle = phase % 1.0
        stance = cycle < duty
        angle = np.where(stance, foot_width_rad * (cycle / duty - 0.5), foot_width_rad / 2
                         + (pitch - foot_width_rad) * (cycle - duty) / (1.0 - duty))
        slope = np.where(stance, foot_width_rad / duty, (pitch - foot_width_rad) / (1.0 - duty))
        error = (angle - state.joint_angle_rad + pitch / 2) % pitch - pitch / 2
        simulation.command(slope * rate + np.clip(10.0 * error, -6.0, 6.0))
        state = simulation.advance(steps)
        observe(state)
        phase = phase + rate * STATE_S
    return state


def depth_m(force_n: float, zeta_npm3: float) -> float:
    """Return the depth at which the tip of the rover's spokes bears a force [m]."""
    radius = ROVER.legs.tip_radius_m
    return float(brentq(lambda z: bearing_n(z, radius, zeta_npm3) - force_n, 0.0, 1.0))


def simulate(world: World | None = None, rover: RoverDescription = ROVER,
             site: object = None, **config: object) -> Simulation:
    """Return a simulation with some physics parameters changed."""
    return Simulation(world or make_world(), rover, PhysicsConfig(**config), site)


def soft(preset: str = 'highland', **values: object) -> GroundConfig:
    """Return soft ground of a preset with some parameters changed."""
    return GroundConfig(model='regolith', preset=preset, **values)


def everything(simulation: Simulation) -> np.ndarray:
    """Return all numbers of the present state, of the feet and of the soil at the legs."""
    feet, contact = simulation.foot_motion, simulation.ground_contact
    values = [np.ravel(getattr(owner, field.name)) for owner in (simulation.state, feet)
              for field in dataclasses.fields(owner)]
    if contact is not None:
        values += [contact.sinkage_m, contact.slip_mps]
    return np.concatenate([*values, np.ravel(simulation.data.qacc_warmstart)]).astype(float)


def same(one: GroundChanges, other: GroundChanges) -> bool:
    """Return whether two overlays have changed alike."""
    return all(np.array_equal(getattr(one, name), getattr(other, name))
               for name in ('index', 'height_m', 'compaction_m'))
