"""How two walks that start 1e-12 m apart part, over time: what curves and rocks make of rounding.

    python test/benchmarks/bench_sensitivity.py --seeds 30

On the worlds of `baseline`, in curves of 2 m, first left, then right. It prints the distance of
the pairs, and asserts nothing.
"""

from __future__ import annotations

import argparse

import numpy as np

from lunar_rover_sim.run.scenario import Scenario

MOVED_M, STATE_S = 1e-12, 0.005
SPEED_MPS, YAW_RADPS = 0.12, 0.06


def walk(seed: int, moved_m: float, duration_s: float) -> np.ndarray:
    """Return (n, 3) positions, one a state."""
    scenario = Scenario.load('baseline', [f'world.seed={seed}'])
    controller, places = scenario.gait_controller(), []
    with scenario.simulation() as simulation:
        simulation.data.qpos[0] += moved_m
        state = simulation.state
        for step in range(round(duration_s / STATE_S)):
            left = step * STATE_S < 0.5 * duration_s
            controller.set_velocity(SPEED_MPS, YAW_RADPS if left else -YAW_RADPS)
            legs = controller.update(state.stamp_ns, state.joint_angle_rad,
                                     state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(round(STATE_S / simulation.config.step_s))
            places.append(state.position_m)
    return np.array(places)


def main() -> None:
    """Print a table of the distance after each quarter of the walks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=30)
    parser.add_argument('--duration', type=float, default=20.0)
    args = parser.parse_args()
    apart = np.array([np.linalg.norm(walk(seed, 0.0, args.duration)
                                     - walk(seed, MOVED_M, args.duration), axis=1)
                      for seed in range(1, args.seeds + 1)])
    print('| after | median [m] | largest [m] | below 1e-4 m |\n|---|---|---|---|')
    for share in (0.25, 0.5, 0.75, 1.0):
        there = apart[:, round(share * apart.shape[1]) - 1]
        print(f'| {share * args.duration:g} s | {np.median(there):.2g} | {there.max():.2g} '
              f'| {(there < 1e-4).sum()} of {len(there)} |')


if __name__ == '__main__':
    main()
