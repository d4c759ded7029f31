"""How gaits differ: which feet carry, and how fast the body pitches, side by side.

    python docs/gait_pictures.py FILE.png packaged smooth
    python docs/gait_pictures.py FILE.webp packaged smooth feedback

Walkers are `packaged`, and policies by name or file. All walk over the same relief. A .webp is a
film of the chase camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import sys

import cv2
from matplotlib.figure import Figure
import numpy as np

from lunar_rover_sim.errors import StudyError
from lunar_rover_sim.files.figures import save_figure
from lunar_rover_sim.files.film_file import write_film
from lunar_rover_sim.learning.picture import ChasePicture
from lunar_rover_sim.learning.policy_file import Policy
from lunar_rover_sim.learning.senses import Sample
from lunar_rover_sim.learning.task import physics_of, STATE_HZ, terrain
from lunar_rover_sim.learning.tasks import make_task
from lunar_rover_sim.physics.simulation import Simulation
from lunar_rover_sim.rover.rover_file import load_rover
from lunar_rover_sim.studies.learning import answer_of, Case, HIDDEN_SEEDS, PACKAGED, SPEED_MPS

GROUND, FROM_S, TO_S = 'highland', 4.0, 8.0
FILM_HZ, FILM_TO_S, FILM_PX = 12.5, 7.0, 288
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


def filmed(walker: str) -> Iterator[np.ndarray]:
    """Yield (h, w, 3) pictures of a walk, with the walker's name."""
    options = {'forward_mps': (SPEED_MPS, SPEED_MPS), 'yaw_rate_radps': (0.0, 0.0),
               'randomise': False, 'ground': GROUND, 'episode_s': TO_S}
    policy = None if walker == PACKAGED else Policy(walker)
    name = 'gait' if policy is None else policy.card.task
    if name == 'gait':      # a constant action, whose decisions need no rate
        options['decision_hz'] = 25
    task = make_task(name, {**({} if policy is None else policy.card.options), **options})
    observation = task.reset(np.random.default_rng(HIDDEN_SEEDS[0]))
    picture, every_ns = ChasePicture(task), round(1e9 / FILM_HZ)
    while task.state.stamp_ns < FILM_TO_S * 1e9:
        observation = task.step(np.zeros(len(task.actions)) if policy is None
                                else policy.act(observation)).observation
        if task.state.stamp_ns >= FROM_S * 1e9 and task.state.stamp_ns % every_ns == 0:
            frame = cv2.resize(picture.draw()[:, 140:-140], (FILM_PX, FILM_PX),
                               interpolation=cv2.INTER_AREA)
            yield cv2.putText(frame, Path(walker).stem, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7,
                              (255, 255, 255), 1, cv2.LINE_AA)
    picture.close()
    task.close()


def main(path: Path, walkers: list[str]) -> None:
    """Draw or film the walkers beside each other."""
    if path.suffix == '.webp':
        write_film(path, (np.hstack(row) for row in zip(*map(filmed, walkers))), FILM_HZ, 40)
        return
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
