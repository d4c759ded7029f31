"""Networks of PyTorch and of Stable-Baselines3 as policy files."""

from __future__ import annotations

from collections.abc import Mapping
import importlib.util
from pathlib import Path
import tempfile
from typing import Any
import warnings

from lunar_rover_sim.autonomy.learning.policy_file import save_network
from lunar_rover_sim.autonomy.learning.task import RoverTask
from lunar_rover_sim.base.errors import LearningError, one_line, with_extra


def save_torch(path: str | Path, module: Any, task: RoverTask, facts: Mapping[str, Any]) -> None:
    """Write a module of PyTorch as a policy and its card.

    Args:
        path: Of the file, which ends in .onnx.
        module: Takes (1, observations) and returns (1, actions), float32, as `task.channels` and
            `task.actions` have them.
        task: It was trained on, or one with the same rover, ground, gait and ranges of commands.
        facts: As `PolicyCard.of` takes them.

    Raises:
        LearningError: As `save_network`; or PyTorch is missing or cannot export the module.
    """
    if importlib.util.find_spec('torch') is None:
        raise LearningError(f'torch: not installed; {with_extra("train")}')
    import torch
    was_training = module.training
    try:
        # The exporter of TorchScript: that of dynamo refuses the distributions of
        # Stable-Baselines3, and needs onnxscript.
        with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
            warnings.simplefilter('ignore')
            file = Path(folder) / 'network.onnx'
            torch.onnx.export(module.cpu().eval(), (torch.zeros(1, len(task.channels)),), file,
                              input_names=['observation'], output_names=['action'], dynamo=False)
            content = file.read_bytes()
    except Exception as error:      # of PyTorch, whose errors have no common class
        raise LearningError(f'{path}: PyTorch cannot export the module: '
                            f'{one_line(error)[:300]}') from None
    finally:
        module.train(was_training)
    save_network(path, content, task, facts)


def save_sb3(path: str | Path, model: Any, task: RoverTask, facts: Mapping[str, Any],
             normalised: Any = None) -> None:
    """Write the actions without noise of a model of Stable-Baselines3 as a policy and its card.

    Args:
        path: Of the file, which ends in .onnx.
        model: PPO, SAC, TQC or another whose actions are continuous.
        task: It was trained on.
        facts: As `PolicyCard.of` takes them.
        normalised: The VecNormalize of its observations, if there was one.

    Raises:
        LearningError: As `save_torch`.
    """
    import torch

    class Deterministic(torch.nn.Module):
        """From observations to actions without noise."""

        def __init__(self) -> None:
            super().__init__()
            self.policy = model.policy
            if normalised is not None:
                mean, var = normalised.obs_rms.mean, normalised.obs_rms.var + normalised.epsilon
                self.register_buffer('mean', torch.as_tensor(mean, dtype=torch.float32))
                self.register_buffer('deviation', torch.as_tensor(var, dtype=torch.float32).sqrt())

        def forward(self, observation: Any) -> Any:
            """Return actions within -1 and 1."""
            if normalised is not None:
                observation = torch.clamp((observation - self.mean) / self.deviation,
                                          -normalised.clip_obs, normalised.clip_obs)
            return torch.clamp(self.policy._predict(observation, deterministic=True), -1.0, 1.0)

    save_torch(path, Deterministic(), task, facts)
