"""Checks of a state before the renderer draws it."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.base.errors import RenderError
from lunar_rover_sim.rover.pose import leg_values, Posed, RoverPose

_FIELDS = {
    'T_world_base': ((4, 4), 'a pose is a finite 4 x 4 matrix'),
    'linear_velocity_mps': ((3,), 'a velocity is three finite numbers'),
    'angular_velocity_radps': ((3,), 'an angular velocity is three finite numbers'),
}


def checked_state(state: Posed, legs: int) -> RoverPose:
    """Return pose and motion of a state; raise RenderError if they are not valid.

    Args:
        legs: How many the rover has; a state that has no values of legs has them at rest at 0.
    """
    values = {}
    fields = {**_FIELDS,
              'joint_angle_rad': ((legs,), f'leg angles are {legs} finite numbers'),
              'joint_velocity_radps': ((legs,), f'leg velocities are {legs} finite numbers')}
    for name, (shape, rule) in fields.items():
        try:
            value = np.asarray(getattr(state, name), float)
        except AttributeError:
            raise RenderError(f'state: {type(state).__name__} is not valid; valid is a RoverState '
                              'or a RoverPose') from None
        if name.startswith('joint'):
            value = leg_values(value, legs)
        if value.shape != shape or not np.all(np.isfinite(value)):
            raise RenderError(f'{name}: {rule}')
        values[name] = value
    return RoverPose(**values)
