"""Environments as Gymnasium has them: `gymnasium.make('lunar_rover_sim/Walk-v0', ...)`.

Many in one process: `gymnasium.make_vec('lunar_rover_sim/Walk-v0', num_envs=16)`. Each rover has a
simulation of its own, and their steps run on threads: MuJoCo and the compiled soil work without
Python's lock.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
import os
from typing import Any

import gymnasium
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
import numpy as np

from lunar_rover_sim.autonomy.learning.senses import Channel, LIMIT
from lunar_rover_sim.autonomy.learning.task import checked_action, Outcome, RoverTask
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


class RoverVectorEnv(VectorEnv[Any, Any, Any]):
    """Environments that are stepped together.

    Where an episode ends, the next one has begun when `step` returns: the observation is its
    first, `info['final_obs']` and `info['final_info']` are the last of the one before.
    """

    metadata: dict[str, Any] = {'render_modes': [],
                                'autoreset_mode': AutoresetMode.SAME_STEP}

    def __init__(self, task: str, num_envs: int = 1, threads: int | None = None,
                 render_mode: str | None = None, **options: Any) -> None:
        """Make the environments of a task.

        Args:
            task: walk, gait or reach.
            num_envs: How many.
            threads: How many of them step at a time; None: as many as there are processors.
            render_mode: None; a single environment draws.
            options: Parameters of the task, the same for all.

        Raises:
            ConfigError: An option is not valid.
        """
        for name, value in (('num_envs', num_envs),
                            ('threads', 1 if threads is None else threads)):
            if type(value) is not int or value < 1:
                raise ConfigError(f'{name}: {brief(value)} is not valid; valid is >= 1')
        if render_mode is not None:
            raise ConfigError(f'render_mode: {brief(render_mode)} is not valid for several; make '
                              'one environment to see it')
        self.num_envs, self.render_mode = num_envs, None
        self.tasks = [make_task(task, options) for _ in range(num_envs)]
        first = self.tasks[0]
        self.channels, self.actions = first.channels, first.actions
        self.privileged_channels = first.privileged_channels
        self.single_observation_space = observation_space(first)
        self.single_action_space = spaces.Box(-1.0, 1.0, (len(self.actions),), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random: list[np.random.Generator] = []
        self._pool = ThreadPoolExecutor(threads or len(os.sched_getaffinity(0)))

    def reset(self, *, seed: int | list[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin all episodes.

        Args:
            seed: Of the first; the others have those that follow. Or one for each.
            options: None.
        """
        if options:
            raise ConfigError(f'options: {brief(options)} is not valid; valid is None')
        count = self.num_envs
        seeds = (list(seed) if isinstance(seed, (list, tuple))
                 else [None if seed is None else seed + k for k in range(count)])
        if len(seeds) != count or any(one is not None and one < 0 for one in seeds):
            raise ConfigError(f'seed: {brief(seed)} is not valid; valid are {count} whole numbers'
                              ' >= 0, or one')
        if not self._random:
            self._random = [np.random.default_rng(one) for one in seeds]
        else:
            self._random = [old if one is None else np.random.default_rng(one)
                            for old, one in zip(self._random, seeds)]
        found = list(self._pool.map(lambda task, rng: task.reset(rng), self.tasks, self._random))
        infos: dict[str, Any] = {}
        for k, task in enumerate(self.tasks):
            infos = self._add_info(infos, information(task), k)
        return self._batch([as_observed(*pair) for pair in zip(self.tasks, found)]), infos

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Make one decision in each.

        Raises:
            LearningError: There are not as many actions as environments, or one is not valid; none
                has stepped.
        """
        if not self._random:
            raise LearningError('step: there is no episode; call reset first')
        if np.ndim(actions) == 0 or len(actions) != self.num_envs:
            raise LearningError(f'action: {brief(actions)} is not valid; valid are '
                                f'{self.num_envs} actions')
        for action in actions:
            checked_action(action, self.actions)
        results = list(self._pool.map(self._step_one, range(self.num_envs), actions))
        infos: dict[str, Any] = {}
        for k, (_, _, info) in enumerate(results):
            infos = self._add_info(infos, info, k)
        outcomes = [outcome for _, outcome, _ in results]
        return (self._batch([observation for observation, _, _ in results]),
                np.array([outcome.reward for outcome in outcomes]),
                np.array([outcome.terminated for outcome in outcomes]),
                np.array([outcome.truncated for outcome in outcomes]), infos)

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads and release all simulations."""
        self._pool.shutdown()
        for task in self.tasks:
            task.close()

    def _step_one(self, k: int, action: Any) -> tuple[Any, Outcome, dict[str, Any]]:
        task = self.tasks[k]
        outcome = task.step(action)
        observation = as_observed(task, outcome.observation)
        info = information(task, outcome)
        if outcome.terminated or outcome.truncated:
            last = {'final_obs': observation, 'final_info': info}
            observation = as_observed(task, task.reset(self._random[k]))
            info = {**information(task), **last}
        return observation, outcome, info

    def _batch(self, observations: list[Any]) -> Any:
        if isinstance(observations[0], dict):
            return {name: np.stack([one[name] for one in observations])
                    for name in observations[0]}
        return np.stack(observations)


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
