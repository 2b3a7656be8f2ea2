"""The tensors of a whole run, checked against its network, optimiser and replay."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.descent import part
from flipperctl.agent.learner import Learner
from flipperctl.agent.replay import UNKNOWN, Replay
from flipperctl.api import ACTIONS
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import State
from flipperctl.checkpoint.layout import require_equal_layout
from flipperctl.errors import CheckpointError

Arrays = dict[str, NDArray[np.generic]]


def run_arrays(
    saved: Checkpoint, state: State, agent: Learner, replay: Replay
) -> tuple[Arrays, dict[int, Arrays]]:
    """Check all tensors; return the replay's arrays and the weights of the outstanding requests.

    The weights are keyed by their version.

    Raises:
        CheckpointError: a tensor is missing or unknown, or has another shape, type or range.
    """
    if state.replay_kept >= replay.capacity:
        raise CheckpointError(
            f"{saved.path}: its part replay is not valid: {state.replay_kept} kept transitions "
            f"leave no room in a replay of {replay.capacity}"
        )
    network, own = agent.online.state_dict(), agent.tensors()
    blank = {n: torch.from_numpy(array) for n, array in replay.blank(state.replay_added).items()}
    versions = {request.version for request in state.orders}
    expected: dict[str, Mapping[str, torch.Tensor]] = {
        **{name: part(own, name) for name in dict.fromkeys(key.split(".")[0] for key in own)},
        **{"replay": blank},
        **{f"weights{version}": network for version in versions},
    }
    for name, tensors in expected.items():
        try:
            require_equal_layout(saved.part(name), tensors)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part {name} is not valid: {error}") from error
    found = arrays(saved, "replay")
    bounded = [("action", 0.0, len(ACTIONS) - 1), ("discount", 0.0, 1)]
    bounded += [("label", 0.0, 1)] if "label" in found else []
    if "failing" in found:
        bounded += [("failing", UNKNOWN, 1), ("resembles", 0.0, 1)]
    for name, least, most in bounded:
        values = np.asarray(found[name], np.float64)
        if ((values < least) | (values > most)).any():
            text = f"replay.{name} lies outside of {least:g} to {most}"
            raise CheckpointError(f"{saved.path}: {text}")
    return found, {version: arrays(saved, f"weights{version}") for version in versions}


def arrays(saved: Checkpoint, part: str) -> Arrays:
    """Return the tensors of a part of a checkpoint as arrays."""
    return {name: tensor.numpy() for name, tensor in saved.part(part).items()}
