"""Stereo pairs per second.

    python test/benchmarks/bench_render.py [--width 640 --height 480] [--pairs 20] [--area]
    python test/benchmarks/bench_render.py --against CLONE [--rounds 5] [--scenario baseline]
        [--set render_node.sun.elevation_deg=2]
    python test/benchmarks/bench_render.py --with render_node.sensor.encoding=rgb8 [--with ...]

Prints a table; asserts nothing. With --against, it prints what the passes of a pair of a scenario
take on a walk, the driver waiting for each, and the ratio to another checkout: both draw the same
states, as high above their own ground, frame by frame in turn. With --with, the ratio is that of a
pair with this parameter to one without. CPU time counts all threads: on a machine that is busy
with other things it tells more than the wall clock.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import importlib
import json
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

from lunar_rover_sim.ground.world.build import build_world
from lunar_rover_sim.ground.world.config import RockConfig, WorldConfig
from lunar_rover_sim.image.camera.config import CameraConfig
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.rover.description import RoverDescription
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario


def poses(world, count):
    """Return poses along a slow curve."""
    angles = np.linspace(0.0, 0.5 * np.pi, count)
    return [standing(world, 3.0 * np.sin(a), 3.0 - 3.0 * np.cos(a), float(np.degrees(a)))
            for a in angles]


def ours(world, config, track, layers=('left', 'right', 'depth'), ahead=True):
    """Return (ms of wall, ms of CPU) per pair, setup time [s], device.

    ahead: each pose is known while the one before is drawn, as in a recorded run
    """
    states = [RoverPose(pose, np.full(4, 0.1 * k)) for k, pose in enumerate(track)]
    start = time.perf_counter()
    with Renderer(world, RoverDescription(), config, 1) as renderer:
        setup = time.perf_counter() - start
        for k in range(3):
            renderer.render(RoverPose(track[k]), k, layers)
        wall, cpu = time.perf_counter(), time.process_time()
        for k, state in enumerate(states):
            if k == 0 or not ahead:
                renderer.begin(state, k, layers)
            if ahead and k + 1 < len(states):
                renderer.begin(states[k + 1], k + 1, layers)
            renderer.finish()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        device = renderer.device
    return 1e3 * wall / len(track), 1e3 * cpu / len(track), setup, device


# Module, class ('' for none), function: what belongs to a pass.
PASSES = {
    'choice of rocks': (('rock_pass', 'RockPass', 'choose'),),
    "rover's shadow map": (('rover_shadow', 'RoverShadow', 'silhouette'),),
    'ground depth': (('ground', 'Ground', 'depths'),),
    'ground light': (('ground_picture', 'GroundPicture', 'make'), ('scene_passes', '', 'cover')),
    'rocks and rover': (('rock_pass', 'RockPass', 'draw'), ('rover_pass', 'RoverPass', 'draw')),
    'light of rocks and rover': (('object_light', 'Surfaces', 'light'),),
    'reading': (('scene_passes', 'ScenePasses', 'read'),),
    'outlines': (('scene_passes', '', 'smooth_outlines'),),
    'motion': (('camera.motion_blur', 'MotionBlur', 'mean'),),
    'lens': (('camera.stray_light', 'StrayLight', 'passed_on'),),
    'sensor': (('camera.sensor', 'ImageSensor', 'pixels'),)}


def walk(scenario, count=40, period_s=0.05):
    """Return states of a rover that walks."""
    gait, states = scenario.gait_controller(), []
    gait.set_velocity(0.12, 0.0)
    with scenario.simulation() as simulation:
        state = simulation.state
        steps = round(200 * period_s)
        for k in range(200 + steps * count):
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
            if k >= 200 and (k + 1 - 200) % steps == 0:
                states.append(RoverPose(*(np.array(getattr(state, field.name))
                                          for field in dataclasses.fields(RoverPose))))
    return states


@contextlib.contextmanager
def timed(renderer, spent):
    """Add the CPU time of each pass to `spent` [s]; the driver has finished before and after."""
    stack = [0.0]

    def wrapped(name, function):
        def call(*args, **kwargs):
            renderer._context.finish()
            stack.append(0.0)
            start = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                renderer._context.finish()
                took = time.process_time() - start
                spent[name] += took - stack.pop()   # less what passes within have taken
                stack[-1] += took
        return call
    with contextlib.ExitStack() as restored:
        for name, functions in PASSES.items():
            for module, owner, function in functions:
                room = 'image.' if '.' in module else 'image.rendering.'
                place = importlib.import_module(f'lunar_rover_sim.{room}{module}')
                place = getattr(place, owner) if owner else place
                before = getattr(place, function)
                restored.callback(setattr, place, function, before)
                setattr(place, function, wrapped(name, before))
        yield


def print_passes(scenario, settings):
    """Print what passes of a pair take in this checkout."""
    loaded = Scenario.load(scenario, settings)
    states = walk(loaded)
    with loaded.renderer() as renderer:
        for k, state in enumerate(states[:4]):
            renderer.render(state, k)
        spent = collections.Counter()
        with timed(renderer, spent):
            start = time.process_time()
            for k, state in enumerate(states):
                renderer.render(state, k)
            spent['rest'] = time.process_time() - start - sum(spent.values())
        print(f'{renderer.device}, {" ".join([scenario, *settings])}, a pair with depth, '
              'pass by pass')
    for name, seconds in spent.most_common():
        print(f'{name:28s} {1e3 * seconds / len(states):6.1f} ms CPU')


def print_ratios(scenario, kinds, rounds):
    """Print a pair's CPU of kinds (name, checkout, settings) over that of the first of them."""
    loaded = Scenario.load(scenario, kinds[0][2])
    states = walk(loaded)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'states.npz')
        place = np.array([state.T_world_base[:3, 3] for state in states])
        np.savez(path, clearance_m=place[:, 2] - loaded.load_world().height_at(place[:, :2]),
                 **{field.name: [getattr(state, field.name) for state in states]
                    for field in dataclasses.fields(RoverPose)})
        workers = []
        for name, clone, settings in kinds:
            workers.append(subprocess.Popen(
                [sys.executable, Path(__file__).with_name('render_worker.py'), scenario,
                 *settings], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                env={**os.environ, 'PYTHONPATH': str(clone)}))
            workers[-1].stdin.write(f'{path}\n')
            workers[-1].stdin.flush()
            if workers[-1].stdout.readline().strip() != 'ready':
                raise SystemExit(f'{name} draws nothing')
        ms = np.zeros((len(kinds), rounds, len(states)))
        for r in range(rounds):
            for k in range(len(states)):
                for i in sorted(range(len(kinds)), reverse=bool((r + k) % 2)):
                    workers[i].stdin.write(f'{k}\n')
                    workers[i].stdin.flush()
                    ms[i, r, k] = float(workers[i].stdout.readline())
        for worker in workers:
            worker.stdin.close()
            worker.wait()
    print(f'{scenario}, {rounds} x {len(states)} states, load {os.getloadavg()[0]:.0f}')
    print('| | CPU of a pair [ms] | over the first | of rounds |\n|---|---|---|---|')
    for (name, *_), times in zip(kinds, ms):
        of_rounds = np.median(times / ms[0], axis=1)
        print(f'| {name} | {np.median(times):.1f} | {np.median(times / ms[0]):.3f} | '
              f'{of_rounds.min():.3f} to {of_rounds.max():.3f} |')


def main():
    if os.environ.get('MUJOCO_GL') != 'egl':
        # MuJoCo chooses its GL when it is imported.
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, 'MUJOCO_GL': 'egl'})
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--width', type=int, default=640)
    parser.add_argument('--height', type=int, default=480)
    parser.add_argument('--pairs', type=int, default=20)
    parser.add_argument('--area', action='store_true',
                        help='a world of 16 times the area too: minutes, and 8 GiB of memory')
    parser.add_argument('--against', type=Path, help='folder of another clone, the one before')
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--scenario', default='baseline')
    parser.add_argument('--set', action='append', default=[], help='a parameter of the scenario')
    parser.add_argument('--with', action='append', default=[], dest='more', metavar='PARAMETER',
                        help='compare a pair with this parameter, too, with one without')
    parser.add_argument('--json', type=Path, help='file of what a pair with depth takes')
    args = parser.parse_args()
    here = Path(__file__).resolve().parents[2]
    if args.against is not None:
        print_passes(args.scenario, args.set)
        print_ratios(args.scenario, [(path.name, path, args.set)
                                     for path in (args.against.resolve(), here)], args.rounds)
        return
    if args.more:
        print_ratios(args.scenario, [('default', here, args.set), *(
            (f'`{more}`', here, [*args.set, more]) for more in args.more)], args.rounds)
        return
    camera = CameraConfig(width=args.width, height=args.height)
    config = RenderConfig(camera=camera, sun=SunConfig(azimuth_deg=60.0, elevation_deg=6.0))
    world = build_world(WorldConfig(), 1)
    track = poses(world, args.pairs)

    def row(name, wall, cpu, note=''):
        print(f'{name:28s} {wall:8.1f} ms wall {cpu:8.1f} ms CPU {1e3 / wall:8.1f} pairs/s  '
              f'{note}')
    wall, cpu, setup, device = ours(world, config, track)
    print(f'{device}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, '
          f'{args.width} x {args.height}, {len(world.rocks)} rocks, setup {setup:.1f} s')
    row('pair and depth', wall, cpu)
    if args.json:
        args.json.write_text(json.dumps({'cpu_ms': round(cpu, 1)}))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f'peak memory {peak:.2f} GiB')
    row('  next pose not known', *ours(world, config, track, ahead=False)[:2])
    others = {'10x the rocks': dataclasses.replace(
        WorldConfig(), rocks=RockConfig(abundance=0.3, max_per_m2=16.0))}
    if args.area:
        others['16x the area'] = dataclasses.replace(
            WorldConfig(), size_m=4 * WorldConfig().size_m, rocks=RockConfig())
    for name, settings in others.items():
        other = build_world(settings, 1)
        wall_other, cpu_other, setup, _ = ours(other, config, track)
        row(name, wall_other, cpu_other,
            f'{wall_other / wall:.2f} x the time, {cpu_other / cpu:.2f} x the CPU time; '
            f'{len(other.rocks)} rocks, setup {setup:.1f} s')
        del other


if __name__ == '__main__':
    main()
