"""`lunar_rover_sim view`: physics alone in MuJoCo's viewer, for those who tune a gait."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import threading
import time
from typing import Any

import click

from lunar_rover_sim.base.errors import ConfigError
from lunar_rover_sim.base.frames import BASE_FRAME
from lunar_rover_sim.cli import options
from lunar_rover_sim.cli.terminal import Progress, say
from lunar_rover_sim.ground.world.cache import cached
from lunar_rover_sim.ground.world.world_folder import load_world
from lunar_rover_sim.rover.physics.simulation import Simulation
from lunar_rover_sim.run.scenario import Scenario

_FRAME_S = 1.0 / 60.0
_DISTANCE_M, _ELEVATION_DEG = 1.2, -20.0
_AMBIENT, _DIFFUSE = 0.3, 0.6       # of the headlight: the model has no other light
_CLOSE_S = 10.0


@options.command(scenarios=True)
@options.scenario('flat')
@click.option('--speed', type=float, default=0.12, metavar='M/S', help='commanded speed ahead')
@click.option('--turn', type=float, default=0.0, metavar='RAD/S',
              help='commanded turn rate, to the left')
@click.option('--duration', type=float, metavar='S',
              help='simulated time; by default until the window is closed')
@options.bounded('--rtf', 0.0, above=True, default=1.0, metavar='FACTOR',
                 help='simulated time per wall time')
@options.world()
@options.seed()
@options.overrides(help='set a parameter, such as gait_controller_node.duty_factor')
def view(scenario: str, speed: float, turn: float, duration: float | None, rtf: float,
         world: Path | None, seed: int | None, overrides: list[str]) -> int:
    """Walk in MuJoCo's viewer, until its window is closed.

    Physics and gait controller, no images, no ROS. The window shows contacts, forces and joints.
    """
    loaded = Scenario.load(scenario, overrides, seed=seed, world=world)
    if not os.environ.get('DISPLAY') and not os.environ.get('WAYLAND_DISPLAY'):
        raise ConfigError("view: there is no display (DISPLAY is not set) for MuJoCo's window")
    with Progress('building the world'):
        ground = load_world(world or cached(loaded.world, loaded.shared.seed))
    gait = loaded.gait_controller()
    gait.set_velocity(speed, turn)
    node = loaded.physics_node
    with loaded.simulation(ground) as simulation, contextlib.ExitStack() as shown:
        window = shown.enter_context(_window(simulation))
        model = simulation.model
        steps = node.state_period_ns // node.step_ns
        state, shown_s, start_s = simulation.state, 0.0, time.monotonic()
        while window.is_running():
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            with window.lock():
                state = simulation.advance(steps)
            if simulation.model is not model:   # the next window of the site
                shown.close()
                model = simulation.model
                window = shown.enter_context(_window(simulation))
            now_s = state.stamp_ns * 1e-9
            if duration is not None and now_s >= duration:
                break
            if now_s - shown_s >= _FRAME_S * rtf:
                shown_s = now_s
                window.sync()
                time.sleep(max(0.0, start_s + now_s / rtf - time.monotonic()))
    x, y = state.position_m[:2]
    say(f'{state.stamp_ns * 1e-9:.1f} s, at ({x:.2f}, {y:.2f}) m')
    return 0


@contextlib.contextmanager
def _window(simulation: Simulation) -> Iterator[Any]:
    """Open MuJoCo's viewer, which follows the rover and shows contacts; close it at the end."""
    # It loads GLFW, which the other commands can do without.
    import mujoco.viewer
    model = simulation.model
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = _AMBIENT, _DIFFUSE
    before = set(threading.enumerate())
    with mujoco.viewer.launch_passive(model, simulation.data) as window:
        threads = set(threading.enumerate()) - before
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BASE_FRAME)
        window.cam.distance, window.cam.elevation = _DISTANCE_M, _ELEVATION_DEG
        window.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
        try:
            yield window
        finally:
            # Its thread reads model and data until it has ended.
            window.close()
            for thread in threads:
                thread.join(_CLOSE_S)
