"""The feedback of `feedback.py` as a policy that PPO of Stable-Baselines3 trains."""

from __future__ import annotations

from typing import Any

from feedback import count, layer
import numpy as np
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
import torch
from torch import nn

from lunar_rover_sim.autonomy.learning.task import RoverTask


class Phases(BaseFeaturesExtractor):
    """Adds the products of pairs of some observations: those of leg phases, for the critic.

    What a walk returns depends on where its legs are to one another. A critic that has to find
    that out itself explains too little of it for the first gradients to be right.
    """

    def __init__(self, space: Any, columns: list[int]) -> None:
        pairs = [(a, b) for k, a in enumerate(columns) for b in columns[k:]]
        super().__init__(space, space.shape[0] + len(pairs))
        self.left, self.right = ([pair[k] for pair in pairs] for k in range(2))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return observations, and the products behind them."""
        return torch.cat([observation, observation[:, self.left] * observation[:, self.right]], 1)


class Feedback(nn.Module):
    """Observations → mean actions; its parameters are the numbers of a feedback, at first 0."""

    def __init__(self, basis: np.ndarray) -> None:
        super().__init__()
        self.register_buffer('basis', torch.as_tensor(basis, dtype=torch.float32))
        self.numbers = nn.Parameter(torch.zeros(len(basis)))

    def layer(self) -> torch.Tensor:
        """Return weights and, in the last column, biases, (legs, observations + 1)."""
        return torch.einsum('n,nlo->lo', self.numbers, self.basis)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return mean actions."""
        layer = self.layer()
        return nn.functional.linear(observation, layer[:, :-1], layer[:, -1])


class FeedbackPolicy(ActorCriticPolicy):
    """A feedback, a critic of its own, and noise of one number a leg that holds until it is reset.

    Stable-Baselines3 resets it every `sde_sample_freq` decisions.
    """

    def __init__(self, *args: Any, basis: np.ndarray, **options: Any) -> None:
        self._basis = basis
        super().__init__(*args, **options)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = Feedback(self._basis)
        self.log_std = nn.Parameter(torch.full((1, self._basis.shape[1]), self.log_std_init))
        self.action_dist.sample_weights(self.log_std)
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1.0),
                                              **self.optimizer_kwargs)

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        seen = latent_pi[:, :self._basis.shape[2] - 1]
        return self.action_dist.proba_distribution(self.action_net(seen), self.log_std,
                                                   torch.ones_like(seen[:, :1]))


def policy_options(task: RoverTask) -> dict[str, Any]:
    """Return the options of a `FeedbackPolicy` for a task."""
    phases = [k for k, one in enumerate(task.channels) if one.name.startswith('spoke_')]
    return {'basis': basis_of(task), 'net_arch': {'pi': [], 'vf': [64, 64]},
            'features_extractor_class': Phases, 'features_extractor_kwargs': {'columns': phases}}


def basis_of(task: RoverTask) -> np.ndarray:
    """Return what each number adds to weights and biases, (numbers, legs, observations + 1)."""
    return np.array([np.column_stack(layer(task, unit)) for unit in np.eye(count(task))])
