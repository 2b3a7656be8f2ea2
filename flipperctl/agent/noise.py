"""Exploration noise inside networks (Fortunato et al. 2018)."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import torch

from flipperctl.agent.building import naming_network


@runtime_checkable
class Noisy(Protocol):
    """A submodule with noise that acts in ``train()`` mode only."""

    def draw_noise(self, rng: np.random.Generator, /) -> None:
        """Draw new noise from ``rng``."""


class Noise:
    """All noisy submodules of a network; there may be none."""

    def __init__(self, module: torch.nn.Module) -> None:
        self._module = module
        self._parts = [part for part in module.modules() if isinstance(part, Noisy)]

    def draw(self, rng: np.random.Generator) -> None:
        """Draw new noise for every noisy submodule; without one, ``rng`` is not used."""
        for part in self._parts:
            with naming_network(self._module, "draw_noise"):
                part.draw_noise(rng)
