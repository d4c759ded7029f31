"""How two walks that start 1e-12 m apart part, over time: what a soil law makes of rounding.

    python test/benchmarks/bench_sensitivity.py --seeds 10 --duration 5 -o growth.csv
    python test/benchmarks/bench_sensitivity.py --draw before.csv after.csv -o growth.png

On the worlds of `baseline`; `--eight` walks in curves of 2 m, left and right, instead of straight
on. Run from another checkout, it measures that one.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys

import numpy as np

sys.path.insert(0, os.getcwd())

from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

MOVED_M, STATE_S, SAMPLE = 1e-12, 0.005, 10
YAW_RADPS = 0.06


def walk(seed: int, moved_m: float, args: argparse.Namespace) -> np.ndarray:
    """Return (n, 3) positions, one each 50 ms."""
    ground = ([f'physics_node.ground.model={args.ground}'] if args.ground == 'rigid' else
              ['physics_node.ground.model=regolith', f'physics_node.ground.preset={args.ground}'])
    scenario = Scenario.load('baseline', [*ground, f'world.seed={seed}'])
    controller, places = scenario.gait_controller(), []
    with scenario.simulation() as simulation:
        simulation.data.qpos[0] += moved_m
        state = simulation.state
        for step in range(round(args.duration / STATE_S)):
            left = step * STATE_S < 0.5 * args.duration
            controller.set_velocity(0.12, (YAW_RADPS if left else -YAW_RADPS) * args.eight)
            legs = controller.update(state.stamp_ns, state.joint_angle_rad,
                                     state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(round(STATE_S / simulation.config.step_s))
            if step % SAMPLE == SAMPLE - 1:
                places.append(state.position_m)
    return np.array(places)


def measure(args: argparse.Namespace) -> None:
    """Write the distance of each pair over time, a column each."""
    seeds = range(args.first, args.first + args.seeds)
    apart = [np.linalg.norm(walk(seed, 0.0, args) - walk(seed, MOVED_M, args), axis=1)
             for seed in seeds]
    with open(args.output, 'w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file, lineterminator='\n')
        rows.writerow(['time_s', *(f'seed_{seed}_m' for seed in seeds)])
        for k, values in enumerate(np.transpose(apart)):
            rows.writerow([f'{(k + 1) * SAMPLE * STATE_S:.2f}', *(f'{v:.3g}' for v in values)])
    print('| after | median [m] | largest [m] | below 1e-4 m |\n|---|---|---|---|')
    for share in (0.25, 0.5, 0.75, 1.0):
        there = np.array([values[round(share * len(values)) - 1] for values in apart])
        print(f'| {share * args.duration:g} s | {np.median(there):.2g} | {there.max():.2g} '
              f'| {(there < 1e-4).sum()} of {len(there)} |')


def draw(args: argparse.Namespace) -> None:
    """Draw two or more tables, one colour each."""
    import matplotlib
    matplotlib.use('agg')
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout='constrained')
    for path, colour in zip(args.draw, ('tab:red', 'tab:blue', 'tab:gray')):
        table = np.genfromtxt(path, delimiter=',', skip_header=1)
        name = os.path.splitext(os.path.basename(path))[0].replace('_', ' ')
        axes.semilogy(table[:, 0], np.maximum(table[:, 1:], 1e-14), color=colour, alpha=0.6,
                      linewidth=0.8)
        axes.plot([], [], color=colour, label=name)
    axes.axhline(MOVED_M, color='black', linestyle=':', linewidth=0.8)
    axes.set(xlabel='time [s]', ylabel='distance of the two rovers [m]', ylim=(1e-14, 1.0))
    axes.legend(loc='center right')
    figure.savefig(args.output, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--ground', default='highland')
    parser.add_argument('--first', type=int, default=1)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--duration', type=float, default=5.0)
    parser.add_argument('--eight', action='store_true')
    parser.add_argument('--draw', nargs='+', metavar='CSV')
    parser.add_argument('-o', '--output', required=True)
    args = parser.parse_args()
    draw(args) if args.draw else measure(args)


if __name__ == '__main__':
    main()
