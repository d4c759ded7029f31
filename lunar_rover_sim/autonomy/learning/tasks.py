"""The tasks by their names."""

from __future__ import annotations

from typing import Any

from lunar_rover_sim.autonomy.learning.gait_task import Gait, GaitTaskConfig
from lunar_rover_sim.autonomy.learning.randomisation import Randomisation
from lunar_rover_sim.autonomy.learning.reach import Reach, ReachConfig
from lunar_rover_sim.autonomy.learning.task import RoverTask, TaskConfig
from lunar_rover_sim.autonomy.learning.walk import Walk, WalkConfig
from lunar_rover_sim.base.errors import ConfigError, nearest

TASKS: dict[str, tuple[type[RoverTask], type[TaskConfig]]] = {
    'walk': (Walk, WalkConfig), 'gait': (Gait, GaitTaskConfig), 'reach': (Reach, ReachConfig)}


def task_config(name: str, options: dict[str, Any]) -> TaskConfig:
    """Return the parameters of a task from plain options.

    `randomise` is a mapping of ranges, or False for ranges without width.

    Raises:
        ConfigError: There is no such task or option, or a value is not valid.
    """
    if name not in TASKS:
        raise ConfigError(f'task: {name!r} is not valid; {nearest(name, TASKS)}')
    options = dict(options)
    given = options.get('randomise')
    if given is False:
        options['randomise'] = Randomisation.none().to_mapping()
    elif isinstance(given, Randomisation):
        options['randomise'] = given.to_mapping()
    elif given is True:
        del options['randomise']
    return TASKS[name][1].from_mapping(options, name)


def make_task(name: str, options: dict[str, Any]) -> RoverTask:
    """Return a task; arguments and errors as those of `task_config`."""
    config = task_config(name, options)
    return TASKS[name][0](config)
