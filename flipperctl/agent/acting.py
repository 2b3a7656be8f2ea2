"""A decision from a Q-network's values."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.building import blamed, told
from flipperctl.api import ACTIONS
from flipperctl.errors import NonFiniteError, PluginFailedError

_CPU = torch.device("cpu")


def greedy(
    module: torch.nn.Module, observation: NDArray[np.float32], device: torch.device = _CPU
) -> int:
    """The action of the largest Q-value of a network on ``device``; the first of equal ones.

    ``observation``: what the network sees, (frames · (N + 3),).

    Raises:
        NonFiniteError: a Q-value is not a finite number.
        PluginFailedError: the network's code failed.
    """
    try:
        with torch.inference_mode():
            output = module(torch.from_numpy(observation).to(device).unsqueeze(0))
        (values,) = output.tolist()
        best, total = int(values.index(max(values))), float(sum(values))
    except BaseException as error:
        raise blamed(error, module, "forward") from error
    if len(values) != len(ACTIONS):
        text = f"gave {len(values)} Q-values for an observation; {len(ACTIONS)} are allowed"
        raise PluginFailedError(told(module, "forward", text))
    if not math.isfinite(total):
        raise NonFiniteError(
            told(module, "forward", f"gave Q-values that are not finite, such as {total}")
        )
    return best
