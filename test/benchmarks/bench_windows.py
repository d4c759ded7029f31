"""Windows of a site: is the walk that in one large window, and one pose the same picture?

    python test/benchmarks/bench_windows.py [walk | images | film] [--ground regolith]
        [--seeds 1 2 3] [--duration 60]

`walk`: a rover walks back and forth over the place where windows change, by itself in windows and
in one window large enough for all of it; prints whether all states are equal bit for bit, how
often the window changed, and the share of the time that passed in the steps in which it did.
`images`: poses between two windows are drawn from both; prints the share of pixels within one
grey level, to 10 m and of all.
`film`: frames of a straight way over a change; prints how much each differs from the one before.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.ground.world.site import Site
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import standing
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

STATE_S = 0.005
WIDE_M = 76.8
TURN_DEG = 40.0
FRAMES, STEP_M = 24, 0.02


def walk(scenario: Scenario, world: World, duration_s: float) -> tuple[np.ndarray, int, float]:
    """Return the states of a walk, how often the window changed, and the share of time for it."""
    gait, states, changes, waited = scenario.gait_controller(), [], 0, 0.0
    with scenario.simulation(world) as simulation:
        state, steps = simulation.state, round(STATE_S / scenario.physics_node.step_s)
        begun = time.perf_counter()
        for k in range(round(duration_s / STATE_S)):
            # A third ahead, a third back, and ahead again.
            third = int(3.0 * k * STATE_S / duration_s)
            gait.set_velocity(-0.12 if third == 1 else 0.12, 0.0)
            legs = gait.update(state.stamp_ns, state.joint_angle_rad, state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            before, start = simulation.world, time.perf_counter()
            state = simulation.advance(steps)
            if simulation.world is not before:
                changes += 1
                waited += time.perf_counter() - start
            states.append(np.concatenate([np.ravel(getattr(state, field.name))
                                          for field in dataclasses.fields(state)]))
        return np.array(states), changes, waited / (time.perf_counter() - begun)


def walks(ground: str, seeds: list[int], duration_s: float) -> None:
    """Print a line for each seed."""
    for seed in seeds:
        # Just before the change, so that a walk crosses it.
        settings = ['physics_node.start.x_m=9.2', 'physics_node.start.y_m=0.5',
                    f'physics_node.ground.model={ground}']
        scenario = Scenario.load('site', settings, seed=seed)
        wide = Scenario.load('site', [*settings, f'world.size_m={WIDE_M}'], seed=seed)
        found, changes, share = walk(scenario, scenario.load_world(), duration_s)
        # Without a hash it is no window of a site: it stays.
        whole = dataclasses.replace(wide.load_world(), hash='')
        once, _, _ = walk(wide, whole, duration_s)
        print(f'{ground}, seed {seed}, {duration_s:g} s: {changes} changes, '
              f'{"equal bit for bit" if np.array_equal(found, once) else "DIFFERENT"}, '
              f'{100.0 * share:.1f} % of the time in changes', flush=True)


def images(seeds: list[int]) -> None:
    """Print a line for each seed."""
    for seed in seeds:
        scenario = Scenario.load('site', ['render_node.sensor.exposure_mode=fixed'], seed=seed)
        world = scenario.load_world()
        site = Site.of(world)
        windows = [world, site.window((site.step_m, 0.0))]
        states = [RoverPose(standing(world, 0.5 * site.step_m + x, y, yaw)) for x, y, yaw in (
            (0.0, 0.0, 0.0), (1.5, 2.0, TURN_DEG), (-1.0, -2.0, 3 * TURN_DEG),
            (0.5, 1.0, 5 * TURN_DEG), (-2.0, 3.0, 7 * TURN_DEG))]
        drawn = []
        with Renderer(world, scenario.rover, scenario.render_node, seed) as renderer:
            for window in windows:
                if renderer.world is not window:
                    renderer.enter(window)
                drawn.append([renderer.render(state, 0, ('left', 'depth')) for state in states])
        near = np.array([frame.depth_m < 10.0 for frame in drawn[0]])
        same = np.array([np.abs(a.left.astype(int) - b.left) <= 1 for a, b in zip(*drawn)])
        print(f'seed {seed}, {len(states)} poses: {100.0 * same[near].mean():.2f} % of pixels to '
              f'10 m within one level, {100.0 * same.mean():.2f} % of all', flush=True)


def film(seeds: list[int]) -> None:
    """Print for each seed how much a frame differs from the one before, [grey levels]."""
    for seed in seeds:
        scenario = Scenario.load('site', ['render_node.sensor.exposure_mode=fixed'], seed=seed)
        world = scenario.load_world()
        site = Site.of(world)
        begin_m, frames = 0.5 * site.step_m - 0.5 * STEP_M * FRAMES, []
        with Renderer(world, scenario.rover, scenario.render_node, seed) as renderer:
            for k in range(FRAMES):
                if k == FRAMES // 2:
                    renderer.enter(site.window((site.step_m, 0.0)))
                pose = RoverPose(standing(world, begin_m + STEP_M * k, 0.4, 0.5 * TURN_DEG))
                frames.append(renderer.render(pose, k, ('left',)).left.astype(float))
        moved = np.array([np.abs(b - a).mean() for a, b in zip(frames, frames[1:])])
        changed = FRAMES // 2 - 1
        print(f'seed {seed}, {FRAMES} frames {100 * STEP_M:g} cm apart: {moved[changed]:.1f} at '
              f'the change of the window, {moved.min():.1f} to {moved.max():.1f} from others, '
              f'{moved[changed - 1]:.1f} and {moved[changed + 1]:.1f} beside it', flush=True)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('what', nargs='?', choices=('walk', 'images', 'film'))
    parser.add_argument('--ground', choices=('rigid', 'regolith'), default='regolith')
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2, 3])
    parser.add_argument('--duration', type=float, default=60.0)
    given = parser.parse_args()
    if given.what in (None, 'walk'):
        walks(given.ground, given.seeds, given.duration)
    if given.what in (None, 'images'):
        images(given.seeds)
    if given.what in (None, 'film'):
        film(given.seeds)


if __name__ == '__main__':
    main()
