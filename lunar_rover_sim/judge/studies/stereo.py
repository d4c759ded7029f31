"""The stereo study: semi-global matching on rendered pairs, against true depth."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from lunar_rover_sim.base.errors import StudyError
from lunar_rover_sim.base.files.results import save_figure
from lunar_rover_sim.base.frames import Array, inverse
from lunar_rover_sim.ground.world.model import World
from lunar_rover_sim.image.rendering.frame import StereoFrame
from lunar_rover_sim.image.rendering.layer_pictures import (depth_picture, gray8,
                                                            signed_error_picture)
from lunar_rover_sim.image.rendering.renderer import Renderer
from lunar_rover_sim.image.rendering.snapshot import settle, standing
from lunar_rover_sim.image.stereo.depth import disparity_from_depth, DisparityMap
from lunar_rover_sim.image.stereo.error import stereo_errors, StereoErrors
from lunar_rover_sim.judge.studies.study_folder import Progress, silent
from lunar_rover_sim.rover.pose import RoverPose
from lunar_rover_sim.run.scenario import Scenario

_RADIUS = 0.15           # of the loop, over half the side of the world


def study(scenario: Scenario, frames: int, figures: Path | None = None,
          progress: Progress = silent) -> StereoErrors:
    """Draw stereo pairs along a loop through a scenario, match them, and sum up their errors.

    Args:
        frames: Number of pairs.
        figures: Folder for figures of the first and the middle pair, SCENARIO_NUMBER.png.
        progress: Called with the number of pairs done, and of all: at first with 0, once world and
            sunlight are ready.

    Raises:
        StudyError: For a figure that cannot be written.
        RenderError: If nothing can be drawn.
    """
    world = scenario.load_world()
    total = StereoErrors()
    with scenario.renderer(world) as renderer:
        matcher = scenario.matcher()
        progress(0, frames)
        for k in range(frames):
            frame, right_depth_m = _draw(renderer, _pose(world, k / frames), k)
            assert frame.left is not None and frame.right is not None
            assert frame.depth_m is not None
            rig = renderer.rig
            disparity = matcher.match(frame.picture('left'), frame.picture('right'))
            truth_px, right_truth_px = (
                disparity_from_depth(depth, rig.focal_px, rig.baseline_m)
                for depth in (frame.depth_m, right_depth_m))
            total += stereo_errors(disparity, truth_px, right_truth_px, frame.left)
            if figures is not None and k in (0, frames // 2):
                _plot(frame, disparity, truth_px, figures / f'{scenario.name}_{k:03d}.png')
            progress(k + 1, frames)
    return total


def _pose(world: World, share: float) -> Array:
    """Return T_world_base on a circle, looking ahead, so that all directions to the sun occur."""
    angle, radius = 2.0 * np.pi * share, _RADIUS * world.ground.half_extent_m
    return standing(world, radius * np.cos(angle), radius * np.sin(angle),
                    float(np.degrees(angle) + 90.0))


def _draw(renderer: Renderer, T_world_base: Array,
          number: int) -> tuple[StereoFrame, NDArray[np.float32]]:
    """Return a frame with its true depth, and the true depth of the right camera [m]."""
    pose = RoverPose(T_world_base)
    settle(renderer, pose)
    frame = renderer.render(pose, number, ('left', 'right', 'depth'))
    # Only the left camera has depth: move the rover so that it is where the right one was.
    T_base_left = renderer.rig.T_base_left
    T_left_right = inverse(T_base_left) @ renderer.rig.T_base_right
    moved = T_world_base @ T_base_left @ T_left_right @ inverse(T_base_left)
    depth_m = renderer.render(RoverPose(moved), number, ('depth',)).depth_m
    assert depth_m is not None
    return frame, depth_m


def _plot(frame: StereoFrame, disparity: DisparityMap, truth_px: NDArray[np.float32],
          path: Path) -> None:
    """Save left image, true depth, SGM depth and disparity error side by side."""
    assert frame.left is not None and frame.depth_m is not None
    error = np.where(disparity.valid & (truth_px > 0.0),
                     disparity.disparity_px - truth_px, np.nan)
    panels = [('left image', gray8(frame.picture('left'))),
              ('true depth, 0.3 to 20 m', depth_picture(frame.depth_m)),
              ('SGM depth', depth_picture(disparity.depth_m)),
              ('disparity less true disparity, -1 px blue to +1 px red',
               signed_error_picture(error, 1.0))]
    figure = Figure(figsize=(20, 4.2), layout='constrained')
    for axes, (title, picture) in zip(figure.subplots(1, 4), panels):
        axes.imshow(picture[..., ::-1])
        axes.set_title(title)
        axes.set_axis_off()
    save_figure(figure, path, StudyError, dpi=100)
