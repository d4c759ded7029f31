"""Film walkers side by side, over the same relief.

    python docs/gait_film.py FILE.webp packaged smooth feedback

Walkers are `packaged`, and policies by name or file.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import sys

import cv2
import numpy as np

from lunar_rover_sim.autonomy.learning.picture import ChasePicture
from lunar_rover_sim.autonomy.learning.policy_file import Policy
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.base.files.film_file import write_film
from lunar_rover_sim.judge.studies.learning import HIDDEN_SEEDS, PACKAGED, SPEED_MPS

GROUND, FROM_S, TO_S = 'highland', 4.0, 7.0
RATE_HZ, SIZE_PX = 12.5, 288


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
    picture, every_ns = ChasePicture(task), round(1e9 / RATE_HZ)
    while task.state.stamp_ns < TO_S * 1e9:
        observation = task.step(np.zeros(len(task.actions)) if policy is None
                                else policy.act(observation)).observation
        if task.state.stamp_ns >= FROM_S * 1e9 and task.state.stamp_ns % every_ns == 0:
            frame = cv2.resize(picture.draw()[:, 140:-140], (SIZE_PX, SIZE_PX),
                               interpolation=cv2.INTER_AREA)
            yield cv2.putText(frame, Path(walker).stem, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7,
                              (255, 255, 255), 1, cv2.LINE_AA)
    picture.close()
    task.close()


def main(path: Path, walkers: list[str]) -> None:
    """Film the walkers beside each other."""
    write_film(path, (np.hstack(row) for row in zip(*map(filmed, walkers))), RATE_HZ, 40)


if __name__ == '__main__':
    main(Path(sys.argv[1]), sys.argv[2:])
