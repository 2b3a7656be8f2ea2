"""The values of a trained policy, for searches that end with them.

In: a checkpoint. Out: the value of observations, with the rewards and the discount of the training.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.api import FloatArray, RobotGeometry
from flipperctl.checkpoint import read, shipped_policies
from flipperctl.config import TrainConfig
from flipperctl.errors import CheckpointError
from flipperctl.lookahead.settings import TOLERANCE, LearnedValue
from flipperctl.policies.source import load_policy
from flipperctl.policies.trained import policy_module


@contextmanager
def naming(path: str) -> Iterator[None]:
    """Begin the texts of errors about a file with ``path``, the setting that names the file."""
    try:
        yield
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error


def learned_value(name: str, path: str) -> LearnedValue:
    """Return the values of a run, a checkpoint or a shipped policy; ``path``: the setting."""
    file = load_policy(name, path, "checkpoint").file
    if file in shipped_policies().values():  # each policy that is built would read it again
        return _cached(name, path, file)
    return _read(name, path, file)


@cache
def _cached(name: str, path: str, file: Path) -> LearnedValue:
    return _read(name, path, file)


def _read(name: str, path: str, file: Path) -> LearnedValue:
    with naming(path):
        checkpoint = read(file)
        config = checkpoint.policy_config()
    if config.network.frames > 1:
        raise CheckpointError(
            f"{path}={name}: its network {config.network.plugin_name} takes "
            f"{config.network.frames} observations, of which a plan predicts one; a network of one "
            "observation is allowed"
        )
    teacher = config.teacher
    named = (checkpoint.document.config.model_extra or {}).get("teacher")
    taught = isinstance(named, Mapping) and named.get("controller") is not None  # missing here
    if (teacher.teaches or taught) and not teacher.td_weight and teacher.loss != "values":
        raise CheckpointError(
            f"{path}={name}: it only imitated its teacher, so that its values estimate no return; "
            "train with teacher.td_weight above 0, or with experiment=searched"
        )
    if config.agent.is_policy_gradient:
        raise CheckpointError(
            f"{path}={name}: it learnt by a policy gradient, so that its values order the actions "
            "and estimate no return; train with agent.learner=d3qn, or with experiment=searched"
        )
    return value_of(policy_module(checkpoint), config)


def value_of(module: torch.nn.Module, config: TrainConfig) -> LearnedValue:
    """Return the values of a network of one observation, in ``eval()`` mode, and its training."""
    scale = config.agent.reward_scale

    def value(observations: NDArray[np.float32]) -> FloatArray:
        with torch.inference_mode():
            best = module(torch.from_numpy(observations)).amax(dim=1)
        return np.asarray(best.numpy(), np.float64) / scale

    layout, sizes = config.perception.layout, dict(_sizes(config))
    return LearnedValue(value, config.rewards, config.agent.gamma, layout, sizes)


def _sizes(config: TrainConfig) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each dimension of the training's robots with its smallest and largest size [m, rad]."""
    for name in RobotGeometry.model_fields:
        own, sampled = getattr(config.robot, name), config.randomise.find("robot", name)
        low, high = (1 - TOLERANCE) * own, (1 + TOLERANCE) * own
        if sampled is not None:
            low, high = sampled.ends
        for factor, scaled in config.robot.factors.items():
            by = config.randomise.find("robot", factor)
            if by is not None and name in scaled:
                low, high = low * by.ends[0], high * by.ends[1]
        yield name, (low, high)
