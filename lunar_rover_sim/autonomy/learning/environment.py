"""One environment as Gymnasium has it: `gymnasium.make('lunar_rover_sim/Walk-v0', ...)`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
from gymnasium import spaces
import numpy as np

from lunar_rover_sim.autonomy.learning.senses import Channel, LIMIT
from lunar_rover_sim.autonomy.learning.task import Outcome, RoverTask
from lunar_rover_sim.autonomy.learning.tasks import make_task
from lunar_rover_sim.base.errors import brief, ConfigError, LearningError
from lunar_rover_sim.image.camera.chase import ChaseCameraConfig, ChaseConfig, ChaseMount, SAMPLES
from lunar_rover_sim.image.illumination.config import SunConfig
from lunar_rover_sim.image.rendering.config import RenderConfig
from lunar_rover_sim.image.rendering.layer_pictures import gray8
from lunar_rover_sim.image.rendering.renderer import Renderer

RENDER_MODE = 'rgb_array'


class RoverEnv(gymnasium.Env[Any, np.ndarray]):
    """A rover on its ground, and a task.

    Observations and actions are numbers of about 1; `channels` and `actions` say what they are, in
    which units and by which scales. `info` has the privileged observations, the reason of an
    ending, and how many episodes ended by which.

    Attributes:
        channels: Name, unit and scale of each number of an observation.
        actions: Those of an action.
        privileged_channels: Those of a privileged observation.
    """

    metadata: dict[str, Any] = {'render_modes': [RENDER_MODE], 'render_fps': 10}

    def __init__(self, task: str, render_mode: str | None = None, **options: Any) -> None:
        """Make the environment of a task.

        Args:
            task: walk, gait or reach.
            render_mode: rgb_array, the chase camera, or None.
            options: Parameters of the task, as `WalkConfig` has them.

        Raises:
            ConfigError: An option is not valid.
        """
        if render_mode not in (None, RENDER_MODE):
            raise ConfigError(f'render_mode: {brief(render_mode)} is not valid; valid is '
                              f'{RENDER_MODE}, or None')
        self.render_mode = render_mode
        self.task = make_task(task, options)
        self.channels, self.actions = self.task.channels, self.task.actions
        self.privileged_channels = self.task.privileged_channels
        self.observation_space = observation_space(self.task)
        self.action_space = spaces.Box(-1.0, 1.0, (len(self.actions),), np.float32)
        self._picture: ChasePicture | None = None

    def reset(self, *, seed: int | None = None,
              options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the same seed gives the same episode, bit by bit, on one machine."""
        super().reset(seed=seed)
        if options:
            raise ConfigError(f'options: {brief(options)} is not valid; valid is None')
        self._end_picture()
        return as_observed(self.task, self.task.reset(self.np_random)), information(self.task)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make one decision.

        Raises:
            LearningError: The action has another shape, or is not finite.
        """
        outcome = self.task.step(action)
        return (as_observed(self.task, outcome.observation), outcome.reward, outcome.terminated,
                outcome.truncated, information(self.task, outcome))

    def render(self) -> Any:
        """Return (h, w, 3) uint8 of the chase camera.

        Raises:
            RenderError: There is no usable EGL device.
        """
        if self.render_mode is None or self.task.simulation is None:
            return None
        if self._picture is None:
            self._picture = ChasePicture(self.task)
        return self._picture.draw()

    def close(self) -> None:
        """Release simulation and picture."""
        self._end_picture()
        self.task.close()

    def _end_picture(self) -> None:
        if self._picture is not None:
            self._picture.close()
            self._picture = None


def observation_space(task: RoverTask) -> spaces.Space[Any]:
    """Return the space of what a task shows."""
    def box(channels: Sequence[Channel]) -> spaces.Box:
        return spaces.Box(-LIMIT, LIMIT, (len(channels),), np.float32)

    if not task.config.privileged:
        return box(task.channels)
    return spaces.Dict({'policy': box(task.channels),
                        'privileged': box(task.privileged_channels)})


def as_observed(task: RoverTask, observation: np.ndarray) -> Any:
    """Return an observation as the space has it."""
    if not task.config.privileged:
        return observation
    return {'policy': observation, 'privileged': task.privileged()}


def information(task: RoverTask, outcome: Outcome | None = None) -> dict[str, Any]:
    """Return the info of a reset or a step."""
    info: dict[str, Any] = {'privileged': task.privileged()}
    if outcome is not None and outcome.ending is not None:
        info['reason'] = outcome.ending.words
        info['endings'] = dict(task.counts)
    return info


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
