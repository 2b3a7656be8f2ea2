"""A trained network as a controller, and controllers from a description of a few words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from flipperctl.agent.acting import greedy
from flipperctl.agent.building import build_network
from flipperctl.agent.frames import stacked
from flipperctl.api import ACTIONS, ObservationLayout, Perception, Policy, Simulator
from flipperctl.checkpoint import Checkpoint, read
from flipperctl.checkpoint.layout import require_equal_layout
from flipperctl.config import resolver
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.exported import ExportedPolicy, is_exported
from flipperctl.policies.plugin import PluginPolicy


class QPolicy:
    """Greedy in the Q-values of a network, which is in ``eval()`` mode."""

    def __init__(self, module: torch.nn.Module, frames: int = 1) -> None:
        """``frames``: observations that the network takes in at once."""
        self.module = module
        self.frames = frames
        parameter = next(module.parameters(), torch.empty(0))
        self._device = parameter.device

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode; a network knows only what it perceives."""

    def act(self, p: Perception) -> int:
        """The action of the largest Q-value."""
        return greedy(self.module, stacked(p.recent, self.frames), self._device)


def policy_module(checkpoint: Checkpoint) -> torch.nn.Module:
    """The network of a checkpoint with its trained weights, on the CPU.

    Raises:
        CheckpointError: the weights do not fit the network.
    """
    config = checkpoint.config()
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


@dataclass(frozen=True)
class ControllerSource:
    """Where a controller comes from; small enough to be handed to another process."""

    checkpoint: Path | None = None
    """Or a file of ``flipperctl export onnx``."""
    settings: dict[str, Any] | None = None
    """``name`` and fields of a controller plugin."""

    def label(self) -> str:
        """What tables and files call it."""
        if self.checkpoint is not None:
            return str(self.checkpoint)
        return str((self.settings or {})["name"])

    def make(self, layout: ObservationLayout) -> Policy:
        """The controller.

        Raises:
            CheckpointError: the policy was trained on another observation layout.
        """
        if self.checkpoint is None:
            return PluginPolicy(resolver.create("controller", self.settings, "controller"))
        bins, bin_width, policy = _opened(self.checkpoint)
        if (bins, bin_width) != (layout.bins, layout.bin_width):
            raise CheckpointError(
                f"{self.checkpoint}: the policy was trained on {bins} bins of {bin_width:g} m; "
                "perception.bins and perception.bin_width ask for "
                f"{layout.bins} of {layout.bin_width:g} m"
            )
        return policy


def _opened(file: Path) -> tuple[int, float, Policy]:
    """The number and width of the bins that a policy takes, and the policy."""
    if is_exported(file):
        exported = ExportedPolicy(file)
        return exported.interface.bins, exported.interface.bin_width, exported
    checkpoint = read(file)
    config = checkpoint.config()
    policy = QPolicy(policy_module(checkpoint), config.network.frames)
    return config.perception.bins, config.perception.bin_width, policy
