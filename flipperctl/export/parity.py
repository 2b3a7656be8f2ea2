"""The comparison of an exported policy with torch on the observations of real rollouts.

In: a network in torch and its export. Out: their largest difference, or an error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.api import Perception
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ExportError
from flipperctl.policies.trained import TrainedPolicy
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import EvaluationSeeds

TOLERANCE = 1e-4
"""Largest difference of Q-values that counts as rounding, relative to the largest |Q|."""

Outputs = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], ...]]
"""Maps inputs of the network (M, F · (N + 3)) to Q-values (M, 9), and if it has a risk, to what the
network of the risk returns."""


class _RecordingPolicy(TrainedPolicy):
    """Acts like a trained policy and keeps the inputs of its network."""

    def __init__(self, module: torch.nn.Module, frames: int) -> None:
        super().__init__(module, frames)
        self.inputs: list[NDArray[np.float32]] = []

    def act(self, p: Perception) -> int:
        self.inputs.append(stacked(p.recent, self.frames))
        return super().act(p)


def rollout_observations(
    config: TrainConfig, module: torch.nn.Module, count: int
) -> NDArray[np.float32]:
    """Return at least ``count`` network inputs from the policy's own episodes, (M, F · (N + 3))."""
    env = FlipperEnv(config=config.environment())
    policy = _RecordingPolicy(module, config.network.frames)
    seeds, episode = EvaluationSeeds.of(config.seed, config.terrain), 0
    while len(policy.inputs) < count:
        play(env, policy, seeds(episode))
        episode += 1
    return np.stack(policy.inputs)


def compare(
    module: torch.nn.Module,
    exported: Outputs,
    observations: NDArray[np.float32],
    risk: torch.nn.Module | None = None,
) -> dict[str, Any]:
    """Return the largest difference of the Q-values and the agreement of the chosen actions.

    ``risk``: the network of the risk, if it was exported too; the result then has the largest
    difference of the risks.
    """
    with torch.inference_mode():
        expected = module(torch.from_numpy(observations)).numpy()  # (M, 9)
    actual, *others = exported(observations)
    if actual.shape != expected.shape:
        raise ExportError(f"the exported policy returns {actual.shape}, torch {expected.shape}")
    difference = float(np.abs(expected - actual).max())
    largest = float(np.abs(expected).max())
    limit = TOLERANCE * max(1.0, largest)
    agreement = float((expected.argmax(1) == actual.argmax(1)).mean())
    ordered = np.sort(expected, axis=1)
    decided = ordered[:, -1] - ordered[:, -2] > 2 * limit  # no tie within rounding
    differs = decided & (expected.argmax(1) != actual.argmax(1))
    if not difference <= limit or differs.any():
        raise ExportError(
            f"the exported policy disagrees with torch: Q-values differ by up to {difference:g} "
            f"(allowed {limit:g}), actions agree on {agreement:.2%} of {len(observations)} "
            "observations; nothing was written"
        )
    return {
        "observations": len(observations),
        "largest_difference": difference,
        "largest_q_value": largest,
        "allowed_difference": limit,
        "action_agreement": agreement,
        **({} if risk is None else _compared_risks(risk, others, observations)),
    }


def _compared_risks(
    risk: torch.nn.Module, others: Sequence[NDArray[np.float32]], observations: NDArray[np.float32]
) -> dict[str, float]:
    with torch.inference_mode():
        expected = [tensor.numpy() for tensor in risk(torch.from_numpy(observations))]
    shapes, wanted = ([array.shape for array in found] for found in (others, expected))
    if shapes != wanted:
        raise ExportError(f"the exported risk has the shapes {shapes}, torch {wanted}")
    both = list(zip(expected, others, strict=True))
    difference = max(float(np.abs(a - b).max()) for a, b in both)
    largest = max(float(np.abs(a).max()) for a in expected)
    limit = TOLERANCE * max(1.0, largest)
    if not difference <= limit:
        raise ExportError(
            f"the exported policy disagrees with torch: risks differ by up to {difference:g} "
            f"(allowed {limit:g}); nothing was written"
        )
    return {"largest_risk_difference": difference}
