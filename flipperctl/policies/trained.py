"""A trained network as a policy.

In: a checkpoint. Out: its network with the trained weights, and the policy that acts by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.acting import greedy
from flipperctl.agent.building import build_network
from flipperctl.agent.frames import stacked
from flipperctl.api import ACTIONS, Perception, Simulator
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.layout import require_equal_layout
from flipperctl.errors import CheckpointError, ConfigError


class TrainedPolicy:
    """Acts greedily on the Q-values of a network in ``eval()`` mode."""

    def __init__(self, module: torch.nn.Module, frames: int = 1) -> None:
        """``frames``: number of observations that the network takes as one input."""
        self.module = module
        self.frames = frames
        parameter = next(module.parameters(), torch.empty(0))
        self._device = parameter.device

    def reset(self, simulator: Simulator | None = None) -> None:
        """Begin an episode; the policy has no memory."""

    def act(self, p: Perception) -> int:
        """Return the index of the action with the largest Q-value, 0 to 8."""
        return self.act_on(p.recent)

    def act_on(self, recent: Sequence[NDArray[np.float32]]) -> int:
        """Return the action for the newest observations, each (N + 3,) in SI units."""
        return greedy(self.module, stacked(recent, self.frames), self._device)


def policy_module(checkpoint: Checkpoint) -> torch.nn.Module:
    """Return the network of a checkpoint with its trained weights, on the CPU, in ``eval()`` mode.

    It maps observations (B, F · (N + 3)) of F frames in SI units to Q-values (B, 9).

    Raises:
        CheckpointError: the network's plugin is missing, or the weights do not fit the network.
    """
    config = checkpoint.policy_config()
    try:
        module = build_network(config.network, config.perception, len(ACTIONS))
    except ConfigError as error:
        raise CheckpointError(f"{checkpoint.path}: {error}") from error
    best = checkpoint.document.kind == "best"
    weights = checkpoint.part("policy" if best else config.agent.act_with)
    try:
        require_equal_layout(weights, module.state_dict())
    except ValueError as error:
        raise CheckpointError(
            f"{checkpoint.path}: the weights do not fit network "
            f"{config.network.plugin_name!r}: {error}"
        ) from error
    module.load_state_dict(weights)
    return module.eval().requires_grad_(False)
