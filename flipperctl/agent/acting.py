"""The greedy decision of a Q-network."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.building import describe_fault, naming_network
from flipperctl.api import ACTIONS
from flipperctl.errors import NonFiniteError, PluginFailedError

_CPU = torch.device("cpu")


def greedy(
    module: torch.nn.Module, observation: NDArray[np.float32], device: torch.device = _CPU
) -> int:
    """Return the action with the largest Q-value, the first one of equals; see ``q_values``."""
    return best(q_values(module, observation, device))


def best(values: Sequence[float]) -> int:
    """Return the action with the largest Q-value, the first one of equals."""
    return values.index(max(values))


def q_values(
    module: torch.nn.Module, observation: NDArray[np.float32], device: torch.device = _CPU
) -> list[float]:
    """Return the Q-values of one observation, (9,).

    ``module`` is on ``device``. ``observation``: input row of the network, (frames · (N + 3),) in
    SI units.

    Raises:
        NonFiniteError: a Q-value is not a finite number.
        PluginFailedError: the network's code failed, or returned a wrong number of Q-values.
    """
    with naming_network(module, "forward"):
        with torch.inference_mode():
            output = module(torch.from_numpy(observation).to(device).unsqueeze(0))
        (values,) = output.tolist()
        total = float(sum(values))
    if len(values) != len(ACTIONS):
        text = f"returned {len(values)} Q-values for an observation; {len(ACTIONS)} are needed"
        raise PluginFailedError(describe_fault(module, "forward", text))
    if not math.isfinite(total):
        raise NonFiniteError(
            describe_fault(
                module, "forward", f"returned Q-values that are not finite: their sum is {total}"
            )
        )
    found: list[float] = values
    return found
