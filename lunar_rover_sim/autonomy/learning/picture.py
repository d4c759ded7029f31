"""Pictures of an episode: the chase camera, and MuJoCo's viewer."""

from __future__ import annotations

import contextlib
import os
from typing import Any

import numpy as np

from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.base.errors import ConfigError, LearningError
from lunar_rover_sim.image.camera.chase import ChaseCameraConfig, ChaseConfig, ChaseMount, SAMPLES
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.layer_pictures import gray8
from lunar_rover_sim.image.rendering.renderer import Renderer

WIDTH, HEIGHT = 640, 360
SUN = SunConfig(azimuth_deg=60.0, elevation_deg=12.0)
_DISTANCE_M = 1.2


class ChasePicture:
    """Draws a task's rover on its ground from outside, tracks included."""

    def __init__(self, task: RoverTask) -> None:
        """Prepare the camera; raise RenderError if there is no usable EGL device."""
        if task.simulation is None or task.world is None:
            raise LearningError('render: there is no episode; call reset first')
        self._task = task
        chase = ChaseConfig(enabled=True, distance_m=_DISTANCE_M,
                            camera=ChaseCameraConfig(width=WIDTH, height=HEIGHT))
        self._renderer = Renderer(task.world, task.simulation.rover, RenderConfig(sun=SUN))
        self._renderer.follow(task.simulation.overlay)
        self._mount = ChaseMount(chase, SUN.azimuth_deg, task.world)
        self._camera = self._renderer.add_camera(chase, self._mount, samples=SAMPLES)
        self._frame = 0

    def draw(self) -> np.ndarray:
        """Return (h, w, 3) uint8 of the present state."""
        state = self._task.state
        self._mount.follow(state, state.stamp_ns)
        pixels = self._camera.render(state, self._frame).left
        assert pixels is not None
        self._frame += 1
        return np.ascontiguousarray(gray8(pixels)[..., ::-1])       # of BGR

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


class Window:
    """Shows a task's rover in MuJoCo's viewer."""

    def __init__(self, task: RoverTask) -> None:
        """Open the window; raise ConfigError if there is no display."""
        if not os.environ.get('DISPLAY') and not os.environ.get('WAYLAND_DISPLAY'):
            raise ConfigError("render_mode: human: there is no display (DISPLAY is not set) for"
                              " MuJoCo's window")
        import mujoco.viewer  # it loads GLFW
        simulation = task.simulation
        if simulation is None:
            raise LearningError('render: there is no episode; call reset first')
        self._owned = contextlib.ExitStack()
        self._window: Any = self._owned.enter_context(
            mujoco.viewer.launch_passive(simulation.model, simulation.data))

    def draw(self) -> None:
        """Show the present state."""
        self._window.sync()

    def close(self) -> None:
        """Close the window."""
        self._owned.close()
