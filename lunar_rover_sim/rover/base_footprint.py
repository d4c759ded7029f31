"""base_footprint: the frame on the level of the lowest foot, below base_link (REP-120)."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim.frames import Array, se3
from lunar_rover_sim.rover.description import RoverDescription


def footprint_pose(rover: RoverDescription, R_world_base: Array,
                   T_base_link: dict[str, Array]) -> Array:
    """Return T_base_footprint (4, 4): no roll, no pitch, the yaw of base_link.

    R_world_base: (3, 3) orientation of base_link
    T_base_link: leg → (4, 4), as `visual.link_poses` returns them

    The origin lies vertically below (above) that of base_link, at the height of the lowest point
    of the spheres at the tips of the spokes.
    """
    legs = rover.legs
    tips = (legs.spoke_length_m - legs.tip_radius_m) * np.array(legs.spoke_directions())
    down = np.concatenate([tips @ T_base_link[leg][:3, :3].T + T_base_link[leg][:3, 3]
                           for leg in legs.names]) @ R_world_base[2]
    height_m = float(down.min()) - legs.tip_radius_m
    forward = R_world_base[:2, 0] / np.linalg.norm(R_world_base[:2, 0])
    level = np.array([[forward[0], -forward[1], 0.0], [forward[1], forward[0], 0.0],
                      [0.0, 0.0, 1.0]])
    return se3(R_world_base.T @ level, R_world_base.T @ [0.0, 0.0, height_m])
