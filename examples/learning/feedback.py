"""Linear feedback on `Walk`: from what a leg and the body feel to the speed of that leg."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.autonomy.learning.walk import RESIDUAL
from lunar_rover_sim.base.errors import LearningError

OF_LEG = ('spoke_sin', 'spoke_cos', 'speed', 'torque', 'lead')
OF_BODY = ('rate_y', 'up_x', 'command_forward')
# Of the other sign for legs on the right.
OF_SIDE = ('rate_x', 'up_y', 'rate_z', 'command_yaw_rate')


def count(task: RoverTask) -> int:
    """Return of how many numbers a feedback consists."""
    return (max(task.rover.legs.rows()) + 1) * (1 + len(OF_LEG) + len(OF_BODY) + len(OF_SIDE))


def layer(task: RoverTask, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weights (legs, observations) and biases (legs,) of a feedback.

    Legs of one row, from front to rear, have the same numbers, mirrored from left to right.
    """
    legs = task.rover.legs
    action = getattr(task.config, 'action', '')
    if action != RESIDUAL:
        raise LearningError(f'action: {action!r} is not valid for feedback, which is added to the '
                            f'speeds of a gait; valid is {RESIDUAL}')
    columns = {channel.name: k for k, channel in enumerate(task.channels)}
    weight, bias = np.zeros((len(legs.names), len(columns))), np.zeros(len(legs.names))
    by_row = np.asarray(numbers).reshape(max(legs.rows()) + 1, -1)
    for k, (name, row, left) in enumerate(zip(legs.names, legs.rows(), legs.on_left)):
        of_leg, of_body, of_side = np.split(by_row[row, 1:], np.cumsum(
            [len(OF_LEG), len(OF_BODY)]))
        bias[k] = by_row[row, 0]
        weight[k, [columns[f'{one}/{name}'] for one in OF_LEG]] = of_leg
        weight[k, [columns[one] for one in OF_BODY]] = of_body
        weight[k, [columns[one] for one in OF_SIDE]] = of_side if left else -of_side
    return weight, bias
