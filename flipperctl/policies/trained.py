"""Trained networks of checkpoints, and values for searches.

In: a checkpoint. Out: its network with the trained weights and its risk, and the value of
observations with the rewards and the discount of the training.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.agent.networks import build_policy, one_thread
from flipperctl.agent.risk import Risk, RiskNetwork, uncalibrated
from flipperctl.api import FloatArray, LearnedValue, RobotGeometry
from flipperctl.api.controllers import TOLERANCE
from flipperctl.checkpoint import Checkpoint, read_policy
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.core.risk import RiskCalibration
from flipperctl.errors import CheckpointError, ConfigError


def policy_module(checkpoint: Checkpoint) -> torch.nn.Module:
    """Return the network of a checkpoint with its trained weights, on the CPU, in ``eval()`` mode.

    It maps observations (B, F · n) of F frames in SI units to Q-values (B, 3^J) or rates (B, J).
    """
    config = checkpoint.policy_config()
    try:
        module = build_policy(config.network, config.perception, config.actions)
    except ConfigError as error:
        raise CheckpointError(f"{checkpoint.path}: {error}") from error
    # The best checkpoint holds the validated weights; in others, the target network acts.
    weights = checkpoint.part("policy" if checkpoint.document.kind == "best" else "target")
    try:
        require_equal_layout(weights, module.state_dict())
    except ValueError as error:
        raise CheckpointError(
            f"{checkpoint.path}: the weights do not fit network "
            f"{config.network.plugin_name!r}: {error}"
        ) from error
    module.load_state_dict(weights)
    return module.eval().requires_grad_(False)


def policy_risk(checkpoint: Checkpoint) -> Risk | None:
    """Return the network of a policy's risk with its calibration; None if it learnt none.

    It maps observations (B, F · n) of F frames in SI units to probabilities (B, 1).
    """
    config, document = checkpoint.policy_config(), checkpoint.document
    if (settings := config.agent.failure_risk) is None:
        return None
    network = RiskNetwork(input_size(config.network, config.perception))
    weights = checkpoint.part("risk")
    # The policy's validation calibrates it, or the run's last validation, if there is any.
    validations = document.state.validations if document.state else (document.validation,)
    calibration = uncalibrated(settings.horizon)
    try:
        require_equal_layout(weights, network.state_dict())
        if validations and (validation := validations[-1]):
            calibration = RiskCalibration.of(validation.__pydantic_extra__)
    except ValueError as error:
        raise CheckpointError(f"{checkpoint.path}: its risk is not valid: {error}") from error
    network.load_state_dict(weights)
    # A robot that moves by far less than this in each decision stands.
    stride = config.robot.track_speed * config.robot.decision_period
    return Risk(network, calibration, stride).eval().requires_grad_(False)


@contextmanager
def naming(path: str) -> Iterator[None]:
    """Begin the texts of errors about a file with ``path``, the setting that names the file."""
    try:
        yield
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from error


def read_value(file: Path, name: str, path: str) -> LearnedValue:
    """Return the values of a checkpoint, which the setting at ``path`` calls ``name``."""
    with naming(path):
        checkpoint = read_policy(file)
        config = checkpoint.policy_config()
    network, teacher = config.network, config.teacher
    named = (checkpoint.document.config.model_extra or {}).get("teacher")
    taught = isinstance(named, Mapping) and named.get("controller") is not None  # missing here
    # A plan predicts a single observation, and its end needs an estimate of a return.
    if network.frames > 1:
        fault = (
            f"its network {network.plugin_name} takes {network.frames} observations, of which a "
            "plan predicts one; a network of one observation is allowed"
        )
    elif (teacher.teaches or taught) and not teacher.td_weight and teacher.loss != "values":
        fault = (
            "it only imitated its teacher, so that its values estimate no return; train with "
            "teacher.td_weight above 0, or with experiment=searched"
        )
    elif config.agent.value_scale is None:
        fault = (
            f"it learnt by agent={config.agent.plugin_name}, so that its outputs order the actions "
            "and estimate no return; train with agent=d3qn, or with experiment=searched"
        )
    else:
        return value_of(policy_module(checkpoint), config)
    raise CheckpointError(f"{path}={name}: {fault}")


read_value_once = cache(read_value)


def value_of(module: torch.nn.Module, config: TrainConfig) -> LearnedValue:
    """Return the values of a network of one observation, in ``eval()`` mode, and its training."""
    scale = config.agent.value_scale
    assert scale is not None  # of a learner that estimates returns

    def value(observations: NDArray[np.float32]) -> FloatArray:
        with one_thread():
            best = module(torch.from_numpy(observations)).amax(dim=1)
        return np.asarray(best.numpy(), np.float64) / scale

    layout, sizes = config.perception.layout, dict(_sizes(config))
    return LearnedValue(value, config.rewards, config.agent.gamma, layout, sizes)


def _sizes(config: TrainConfig) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield each dimension of the training's robots with its smallest and largest size [m, rad]."""
    for name in RobotGeometry.model_fields:
        size, sampled = getattr(config.robot, name), config.randomise.find("robot", name)
        # Sampled robots count up to the ends of their range, others within a tolerance.
        low, high = (1 - TOLERANCE) * size, (1 + TOLERANCE) * size
        if sampled is not None:
            low, high = sampled.ends
        for factor, scaled in config.robot.factors.items():
            by = config.randomise.find("robot", factor)
            if by is not None and name in scaled:
                low, high = low * by.ends[0], high * by.ends[1]
        yield name, (low, high)
