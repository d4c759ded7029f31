"""How fast physics steps: `python test/benchmarks/bench_physics.py [--large | --soft]`.

Compares, side by side and interleaved so that other load hits all alike:
- our state every 5 steps against the same steps in one `mj_step(m, d, n)` call;
- the default world with its rocks against its ground alone;
- with --large, a world of 100 times the cells (needs about 6 GB);
- with --soft, only this: physics with gait on `baseline`, on soft ground against rigid.
Times are processor time of the one thread, the least of several rounds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys
import time

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from physics_scene import make_world, rough_heights, simulate  # noqa: E402

from lunar_rover_sim.ground.world.build import build_world  # noqa: E402
from lunar_rover_sim.ground.world.config import WorldConfig  # noqa: E402
from lunar_rover_sim.rover.physics.simulation import Simulation  # noqa: E402
from lunar_rover_sim.run.scenario import Scenario  # noqa: E402

STEPS = 1000
ROUNDS = 15
SPEED_RADPS = 2.1  # about 1 Hz of phase: the rover tumbles forward on its spokes


def at_once(simulation: Simulation) -> float:
    """Return the seconds per step of one call of MuJoCo."""
    simulation.reset()
    simulation.command([SPEED_RADPS] * 4)
    start = time.process_time()
    mujoco.mj_step(simulation.model, simulation.data, STEPS)
    return (time.process_time() - start) / STEPS


def with_states(simulation: Simulation) -> float:
    """Return the seconds per step with a full state every 5 steps."""
    simulation.reset()
    simulation.command([SPEED_RADPS] * 4)
    start = time.process_time()
    for _ in range(STEPS // 5):
        simulation.advance(5)
    return (time.process_time() - start) / STEPS


def large_world(n: int):
    """Return rough ground of n x n samples, made of repeated tiles."""
    tile = rough_heights()
    repeats = -(-n // len(tile))
    return make_world(np.tile(tile.astype(np.float32), (repeats, repeats))[:n, :n])


def walk(scenario: Scenario, simulation: Simulation) -> np.ndarray:
    """Return the seconds of each 0.1 s of a walk of 3 s with gait from the start on."""
    controller, state, seconds = scenario.gait_controller(), simulation.reset(), []
    for _ in range(30):
        start = time.process_time()
        for _ in range(20):
            controller.set_velocity(0.12, 0.0)
            legs = controller.update(state.stamp_ns, state.joint_angle_rad,
                                     state.joint_velocity_radps)
            simulation.command(legs.velocity_radps)
            state = simulation.advance(5)
        seconds.append(time.process_time() - start)
    return np.array(seconds)


def compare_grounds() -> dict[str, float]:
    """Print and return how fast walks on rigid and soft ground are, by the least of each piece."""
    scenarios = {model: Scenario.load('baseline', [f'physics_node.ground.model={model}'])
                 for model in ('rigid', 'regolith')}
    simulations = {model: scenario.simulation() for model, scenario in scenarios.items()}
    least = {model: np.full(30, np.inf) for model in scenarios}
    for _ in range(ROUNDS):
        for model, scenario in scenarios.items():
            least[model] = np.minimum(least[model], walk(scenario, simulations[model]))
    rigid, soft = (3.0 / least[model].sum() for model in scenarios)
    print(f'rigid {rigid:.1f}, soft {soft:.1f} x real time, soft over rigid {rigid / soft:.2f}')
    return {'rigid': round(rigid, 1), 'soft': round(soft, 1), 'ratio': round(rigid / soft, 2)}


def compare_worlds(large: bool) -> dict[str, float]:
    """Print a table of worlds; return times real time of the default one."""
    world = build_world(WorldConfig(), seed=1)
    bare = make_world(world.ground.heights_m, world.ground.cell_m)
    cases = {f'{world.ground.n}^2, {len(world.rocks)} rocks': simulate(world),
             f'{world.ground.n}^2, no rocks': simulate(bare),
             'rough 2049^2, no rocks': simulate(large_world(2049))}
    if large:
        cases['rough 20481^2, no rocks'] = simulate(large_world(20481))
    once = dict.fromkeys(cases, np.inf)
    full = dict.fromkeys(cases, np.inf)
    for _ in range(ROUNDS):
        for name, simulation in cases.items():
            once[name] = min(once[name], at_once(simulation))
            full[name] = min(full[name], with_states(simulation))
    print(f'{"world":30} {"mj_step [us]":>13} {"ours [us]":>10} {"ratio":>6} {"real time":>10}')
    for name, simulation in cases.items():
        print(f'{name:30} {once[name] * 1e6:13.1f} {full[name] * 1e6:10.1f}'
              f' {full[name] / once[name]:6.2f} {simulation.config.step_s / full[name]:9.1f}x')
    first = next(iter(cases))
    return {'rocks': len(world.rocks),
            'real_time': round(cases[first].config.step_s / full[first], 1)}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--large', action='store_true', help='a world of 100 times the cells')
    parser.add_argument('--soft', action='store_true', help='soft against rigid ground only')
    parser.add_argument('--json', type=Path, help='file of the values')
    args = parser.parse_args()
    values = compare_grounds() if args.soft else compare_worlds(args.large)
    if args.json:
        args.json.write_text(json.dumps(values))


if __name__ == '__main__':
    main()
