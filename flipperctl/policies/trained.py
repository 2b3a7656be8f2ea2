"""A trained network as a policy.

In: a checkpoint. Out: its network with the trained weights, and the policy that acts by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size, stacked
from flipperctl.agent.networks import best, build_network, q_values
from flipperctl.agent.risk import Risk, RiskNetwork, uncalibrated
from flipperctl.api import ACTIONS, Perception, Simulator
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.sealed import require_equal_layout
from flipperctl.core.risk import Escape, EscapeRule, Recurrence, RiskCalibration
from flipperctl.errors import CheckpointError, ConfigError


class TrainedPolicy:
    """Acts on the Q-values of a network in ``eval()`` mode: greedily, except while it escapes."""

    def __init__(
        self,
        module: torch.nn.Module,
        frames: int = 1,
        risk: Risk | None = None,
        escape: EscapeRule | None = None,
    ) -> None:
        """``frames``: number of observations that the network takes as one input.

        ``risk``: the network of its risk on the CPU, if there is one. ``escape``: how it draws its
        actions while that warns; None: it never does.
        """
        self.module, self._risk = module, risk
        self.risk_sign = None if risk is None else risk.sign
        """When its risk is a warning; None without a risk."""
        self.risk: float | None = None
        """Risk at the last decision; None without one."""
        self._recurrence: Recurrence | None = None
        self._escape = None if escape is None else Escape(escape)
        self.frames = frames
        parameter = next(module.parameters(), torch.empty(0))
        self._device = parameter.device

    def reset(self, simulator: Simulator | None = None) -> None:
        """Begin an episode; only the risk and the escape have a memory."""
        self.risk = self._recurrence = None
        if self._escape is not None:
            self._escape.reset()

    def act(self, p: Perception) -> int:
        """Return the index of an action, 0 to 8."""
        return self.act_on(p.recent)

    def q_values(self, p: Perception) -> list[float]:
        """Return the Q-values, (9,)."""
        return q_values(self.module, stacked(p.recent, self.frames), self._device)

    def act_on(self, recent: Sequence[NDArray[np.float32]]) -> int:
        """Return the action for the newest observations, each (N + 3,) in SI units."""
        observation = stacked(recent, self.frames)
        if self._risk is not None:
            if self._recurrence is None:
                self._recurrence = Recurrence(len(recent[-1]))
            self.risk = self._risk.of_one(observation, self._recurrence.add(recent[-1]))
        values = q_values(self.module, observation, self._device)
        escape, sign = self._escape, self.risk_sign
        if escape is not None and sign is not None and escape.due(warns=sign.warns(self.risk)):
            return escape.draw(values)
        return best(values)


def policy_module(checkpoint: Checkpoint) -> torch.nn.Module:
    """Return the network of a checkpoint with its trained weights, on the CPU, in ``eval()`` mode.

    It maps observations (B, F · (N + 3)) of F frames in SI units to Q-values (B, 9).
    """
    config = checkpoint.policy_config()
    try:
        module = build_network(config.network, config.perception, len(ACTIONS))
    except ConfigError as error:
        raise CheckpointError(f"{checkpoint.path}: {error}") from error
    best = checkpoint.document.kind == "best"
    weights = checkpoint.part("policy" if best else "target")
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

    It maps observations (B, F · (N + 3)) of F frames in SI units to probabilities (B, 1).
    """
    config = checkpoint.policy_config()
    if not config.agent.risk:
        return None
    network = RiskNetwork(input_size(config.network, config.perception))
    weights = checkpoint.part("risk")
    try:
        require_equal_layout(weights, network.state_dict())
        calibration = _calibration(checkpoint, config.agent.risk_horizon)
    except ValueError as error:
        raise CheckpointError(f"{checkpoint.path}: its risk is not valid: {error}") from error
    network.load_state_dict(weights)
    return Risk(network, calibration).eval().requires_grad_(False)


def _calibration(checkpoint: Checkpoint, horizon: int) -> RiskCalibration:
    """Return the calibration of the policy's validation, or of the run's last one, if any."""
    document = checkpoint.document
    validation = document.validation
    if validation is None and document.state is not None and document.state.validations:
        validation = document.state.validations[-1]
    if validation is None:
        return uncalibrated(horizon)
    return RiskCalibration.of(validation.__pydantic_extra__)
