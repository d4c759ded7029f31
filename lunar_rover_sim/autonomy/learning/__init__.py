"""Learning: Gymnasium environments on true ground, policies as files, and what runs them.

`import lunar_rover_sim.autonomy.learning` registers `lunar_rover_sim/Walk-v0`, `Gait-v0` and
`Reach-v0` where gymnasium is installed (extra `[learn]`). Policies run without it.
"""

from __future__ import annotations

import importlib.util

TASKS = ('Walk', 'Gait', 'Reach')
NAMESPACE = 'lunar_rover_sim'


def _register() -> None:
    import gymnasium
    for task in TASKS:
        name = f'{NAMESPACE}/{task}-v0'
        if name not in gymnasium.registry:
            gymnasium.register(
                name, entry_point='lunar_rover_sim.autonomy.learning.environment:RoverEnv',
                vector_entry_point='lunar_rover_sim.autonomy.learning.environment:RoverVectorEnv',
                kwargs={'task': task.lower()})


if importlib.util.find_spec('gymnasium') is not None:
    _register()
