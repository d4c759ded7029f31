"""Environments of this package as those of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv


class Sb3Vector(VecEnv):
    """A `RoverVectorEnv` for Stable-Baselines3, which begins episodes anew in the same way."""

    def __init__(self, task: str, count: int, **options: Any) -> None:
        name = f'lunar_rover_sim.autonomy.learning:lunar_rover_sim/{task}-v0'
        self.envs = gymnasium.make_vec(name, num_envs=count, **options)
        super().__init__(count, self.envs.single_observation_space, self.envs.single_action_space)
        self._returns, self._lengths = np.zeros(count), np.zeros(count, int)

    def seed(self, seed: int | None = None) -> list[None]:
        self._seed = seed
        return [None] * self.num_envs

    def reset(self) -> np.ndarray:
        observations, _ = self.envs.reset(seed=getattr(self, '_seed', None))
        self._seed = None
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        self._returns += rewards
        self._lengths += 1
        done, infos = terminated | truncated, []
        for k in range(self.num_envs):
            one: dict[str, Any] = {'TimeLimit.truncated': bool(truncated[k])}
            if done[k]:
                one['terminal_observation'] = info['final_obs'][k]
                one['episode'] = {'r': self._returns[k], 'l': self._lengths[k], 't': 0.0}
                self._returns[k], self._lengths[k] = 0.0, 0
            infos.append(one)
        return observations, rewards, done, infos

    def close(self) -> None:
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.envs, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None,
                   **kwargs: Any) -> list[Any]:
        return [getattr(self.envs, method_name)(*args, **kwargs)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs
