"""Whether the tensors of a checkpoint are those that a network and a run are made of."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS
from flipperctl.errors import CheckpointError
from flipperctl.run.checkpoint import Checkpoint
from flipperctl.run.document import State

Arrays = dict[str, NDArray[np.generic]]


def require_equal_layout(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]
) -> None:
    """Names, shapes and types of the tensors are those expected, and all numbers are finite.

    A number may be infinite where the expected one is (a mask, say).

    Raises:
        ValueError: they are not; the text names the first that differs.
    """
    if lacking := sorted(expected.keys() - found.keys()):
        raise ValueError(f"{lacking[0]} is missing")
    if further := sorted(found.keys() - expected.keys()):
        raise ValueError(f"there is no tensor {further[0]!r:.60}")
    for name, tensor in found.items():
        wanted = expected[name]
        if tensor.shape != wanted.shape or tensor.dtype != wanted.dtype:
            raise ValueError(f"{name} is {_said(tensor)}; {_said(wanted)} is needed")
        if not bool((tensor.isfinite() | ~wanted.cpu().isfinite()).all()):
            raise ValueError(f"{name} holds numbers that are not finite")


def run_arrays(
    saved: Checkpoint, state: State, agent: D3qn, replay: Replay
) -> tuple[Arrays, dict[int, Arrays]]:
    """The replay's arrays and the weights of each order's version, after a check of all tensors.

    Raises:
        CheckpointError: a tensor is missing, too many, or of another shape, type or range.
    """
    network = agent.online.state_dict()
    blank = {n: torch.from_numpy(array) for n, array in replay.blank(state.replay_added).items()}
    versions = {order.version for order in state.orders}
    expected: dict[str, Mapping[str, torch.Tensor]] = {
        **{"online": network, "target": network},
        **{"optimiser": agent.optimiser.moments, "replay": blank},
        **{f"weights{version}": network for version in versions},
    }
    for part, tensors in expected.items():
        try:
            require_equal_layout(saved.part(part), tensors)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part {part} is wrong: {error}") from error
    found = _arrays(saved, "replay")
    for name, most in (("action", len(ACTIONS) - 1), ("discount", 1)):
        if ((found[name] < 0) | (found[name] > most)).any():  # type: ignore[operator]
            raise CheckpointError(f"{saved.path}: replay.{name} lies outside of 0 to {most}")
    return found, {version: _arrays(saved, f"weights{version}") for version in versions}


def _arrays(saved: Checkpoint, part: str) -> Arrays:
    return {name: tensor.numpy() for name, tensor in saved.part(part).items()}


def _said(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"
