"""Learners and batches that several test files use."""

from typing import Any, ClassVar

import torch

from flipperctl.agent.replay import Batch
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Teacher, resolver
from flipperctl.learners import D3qn
from flipperctl.learners.double_q import DoubleQ

LAYOUT = ObservationLayout()
ACTIONS = 9


class Foreign(Network):
    """Builds the module of its settings."""

    plugin_name: ClassVar[str] = "foreign"
    module: Any
    window: int = 1

    @property
    def frames(self) -> int:
        return self.window

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return the module of the settings."""
        return self.module


class Ramp(Network):
    """Its Q-values rise from action to action for every observation."""

    plugin_name: ClassVar[str] = "ramp"

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a layer whose biases are the Q-values."""
        layer = torch.nn.Linear(layout.size, n_actions)
        torch.nn.init.zeros_(layer.weight)
        layer.bias.data = torch.arange(n_actions, dtype=torch.float32)
        return layer


def learner(
    network: str = "at_d3qn", seed: int = 0, teacher: Teacher | None = None, **settings: Any
) -> DoubleQ:
    built = resolver.create("network", network, "network")
    assert isinstance(built, Network)
    return DoubleQ(built, LAYOUT, D3qn(**settings), seed=seed, teacher=teacher)


def fixed_batch(size: int = 64, frames: int = 1) -> Batch:
    generator = torch.Generator().manual_seed(0)
    seeded = {"generator": generator}
    return Batch(
        observation=torch.randn(size, frames * LAYOUT.size, **seeded),
        action=torch.arange(size) % ACTIONS,
        reward=torch.randn(size, **seeded),
        next_observation=torch.randn(size, frames * LAYOUT.size, **seeded),
        discount=torch.full((size,), 0.5),
    )
