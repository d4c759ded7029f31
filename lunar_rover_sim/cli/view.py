"""`lunar_rover_sim view`: physics alone in MuJoCo's viewer, for those who tune a gait."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import os
import threading
import time
from typing import Any

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the command takes."""
    parser.description = ("Walk in MuJoCo's viewer: physics and gait controller, no images, no "
                          'ROS. Its window shows contacts, forces and joints.')
    options.add_scenario(parser, 'flat')
    parser.add_argument('--speed', type=float, default=0.12, metavar='M/S',
                        help='commanded speed ahead (default: 0.12)')
    parser.add_argument('--turn', type=float, default=0.0, metavar='RAD/S',
                        help='commanded turn rate, to the left (default: 0)')
    parser.add_argument('--duration', type=float, metavar='S',
                        help='simulated time; by default until the window is closed')
    options.add_number(parser, '--rtf', 0.0, above=True, default=1.0, metavar='FACTOR',
                       help='simulated time per wall time')
    options.add_world(parser)
    options.add_seed(parser)
    options.add_overrides(parser, help='set a parameter, such as gait_controller_node.duty_factor')


def run(args: argparse.Namespace) -> int:
    """Walk until the window is closed."""
    scenario = Scenario.load(args.scenario, args.overrides, seed=args.seed, world=args.world)
    if not os.environ.get('DISPLAY') and not os.environ.get('WAYLAND_DISPLAY'):
        raise ConfigError("view: there is no display (DISPLAY is not set) for MuJoCo's window")
    with Progress('building the world'):
        world = load_world(args.world or cached(scenario.world, scenario.shared.seed))
    gait = scenario.gait_controller()
    gait.set_velocity(args.speed, args.turn)
    node = scenario.physics_node
    with scenario.simulation(world) as simulation, _window(simulation) as window:
        steps = node.state_period_ns // node.step_ns
        state, shown_s, start_s = simulation.state, 0.0, time.monotonic()
        while window.is_running():
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            with window.lock():
                state = simulation.advance(steps)
            now_s = state.stamp_ns * 1e-9
            if args.duration is not None and now_s >= args.duration:
                break
            if now_s - shown_s >= _FRAME_S * args.rtf:
                shown_s = now_s
                window.sync()
                time.sleep(max(0.0, start_s + now_s / args.rtf - time.monotonic()))
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
