"""Where hazard cameras are on the rover, and what their frames are called."""

from __future__ import annotations

import numpy as np

from lunar_rover_sim import frames, topics
from lunar_rover_sim.camera.hazard_config import HazardConfig
from lunar_rover_sim.camera.mount import BodyMount
from lunar_rover_sim.frames import Array, matrix_from_wxyz, R_BODY_OPTICAL, se3, wxyz_from_rpy


class HazardRig:
    """A hazard camera, or a pair of them, on the rover.

    T_base_left, T_base_right: (4, 4) optical frames in base_link; of one camera, twice the same
    """

    def __init__(self, config: HazardConfig) -> None:
        self._config = config
        turn = se3(R_BODY_OPTICAL, np.zeros(3))
        left, right = self.link_poses()
        self.T_base_left, self.T_base_right = left @ turn, right @ turn

    def link_poses(self) -> tuple[Array, Array]:
        """Return T_base_camera (4, 4) of left and right: x along the optical axis, y left."""
        c = self._config
        turn = matrix_from_wxyz(wxyz_from_rpy(*np.radians(c.orientation_rpy_deg)))
        half = 0.5 * c.stereo_baseline_m * turn[:, 1]
        return se3(turn, np.array(c.position_m) + half), se3(turn, np.array(c.position_m) - half)


class HazardMount(BodyMount):
    """Carries a hazard camera."""

    def __init__(self, config: HazardConfig) -> None:
        super().__init__(HazardRig(config))


def sides(name: str, config: HazardConfig) -> tuple[str, ...]:
    """Return the names of the cameras below `hazard/`: the one, or the left and the right one."""
    return (f'{name}/left', f'{name}/right') if config.stereo else (name,)


def fixed_frames(name: str, config: HazardConfig) -> tuple[tuple[str, str, Array], ...]:
    """Return (parent, child, (4, 4) T_parent_child) of the frames of a hazard camera."""
    turn = se3(R_BODY_OPTICAL, np.zeros(3))
    result: list[tuple[str, str, Array]] = []
    for camera, T_base_link in zip(sides(name, config), HazardRig(config).link_poses()):
        optical = topics.hazard(camera)[0].frame_id
        link = optical.replace('_optical_frame', '_link')
        result += [(frames.BASE_FRAME, link, T_base_link), (link, optical, turn)]
    return tuple(result)
