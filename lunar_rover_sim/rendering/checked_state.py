"""What the renderer asks of a state before it draws it."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.errors import RenderError
from lunar_rover_sim.rover.pose import Posed, RoverPose

_FIELDS = {
    'T_world_base': ((4, 4), 'a pose is a finite 4 x 4 matrix'),
    'joint_angle_rad': ((4,), 'leg angles are four finite numbers'),
    'linear_velocity_mps': ((3,), 'a velocity is three finite numbers'),
    'angular_velocity_radps': ((3,), 'an angular velocity is three finite numbers'),
    'joint_velocity_radps': ((4,), 'leg velocities are four finite numbers'),
}


def checked_state(state: Posed) -> RoverPose:
    """Return pose and motion of a state; raise RenderError if they are not valid."""
    values = {}
    for name, (shape, rule) in _FIELDS.items():
        try:
            value = np.asarray(getattr(state, name), float)
        except AttributeError:
            raise RenderError(f'state: {type(state).__name__} is not valid; valid is a RoverState '
                              'or a RoverPose') from None
        if value.shape != shape or not np.all(np.isfinite(value)):
            raise RenderError(f'{name}: {rule}')
        values[name] = value
    return RoverPose(**values)
