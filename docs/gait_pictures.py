"""How gaits differ: which feet carry, and how fast the body pitches, side by side.

    python docs/gait_pictures.py FILE.png packaged smooth

Walkers are `packaged`, and policies by name or file. All walk over the same relief.
"""

from __future__ import annotations

from pathlib import Path
import sys

from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.figures import save_figure
from lunar_rover_sim.learning.senses import Sample
from lunar_rover_sim.learning.task import physics_of, STATE_HZ, terrain
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.studies.learning import answer_of, Case, HIDDEN_SEEDS

GROUND, FROM_S, TO_S = 'highland', 4.0, 8.0
CARRIES_N = 0.15        # load on a foot


def walked(walker: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (n,) [s], loads (n, legs) [N] and pitch rates (n,) [rad/s] of a walk."""
    rover, case = load_rover(), Case(walker, GROUND, 0.0, HIDDEN_SEEDS[0])
    answer, rows = answer_of(case, rover), []
    with Simulation(terrain(case.seed, 12.8, False), rover, physics_of(GROUND)) as simulation:
        state = simulation.state
        steps = 1_000_000_000 // STATE_HZ // simulation.config.step_ns
        while state.stamp_ns < TO_S * 1e9:
            simulation.command(answer(Sample.of(state)).velocity_radps)
            state = simulation.advance(steps)
            rows.append((state.stamp_ns * 1e-9, np.linalg.norm(state.contact_force_n, axis=1),
                         state.angular_velocity_radps[1]))
    times, loads, rates = (np.array(column) for column in zip(*rows))
    shown = times >= FROM_S
    return times[shown], loads[shown], rates[shown]


def main(path: Path, walkers: list[str]) -> None:
    """Draw the walkers beside each other."""
    names = load_rover().legs.names
    figure = Figure(figsize=(4.6 * len(walkers), 4.6), layout='constrained')
    panels = figure.subplots(2, len(walkers), sharex=True, sharey='row', squeeze=False)
    for (feet, body), walker in zip(panels.T, walkers):
        times, loads, rates = walked(walker)
        for k, name in enumerate(names):
            feet.fill_between(times, k - 0.35, k + 0.35, loads[:, k] > CARRIES_N, lw=0.0)
        feet.set(title=Path(walker).stem, yticks=range(len(names)), yticklabels=names)
        feet.invert_yaxis()
        rms = float(np.sqrt(np.mean(rates ** 2)))
        body.plot(times, rates, lw=1.0, label=f'RMS {rms:.2f} rad/s')
        body.set(xlabel='time [s]')
        body.grid(alpha=0.3)
        body.legend(loc='upper right')
    panels[0][0].set_ylabel('feet that carry')
    panels[1][0].set_ylabel('pitch rate [rad/s]')
    save_figure(figure, path, StudyError)


if __name__ == '__main__':
    main(Path(sys.argv[1]), sys.argv[2:])
