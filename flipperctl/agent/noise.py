"""Networks that explore by noise of their own (Fortunato et al. 2018)."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import torch

from flipperctl.agent.building import blamed


@runtime_checkable
class Noisy(Protocol):
    """A part of a network that keeps noise, which acts in ``train()`` mode only."""

    def draw_noise(self, rng: np.random.Generator, /) -> None:
        """Take new noise."""


class Noise:
    """All noise of a network; there may be none."""

    def __init__(self, module: torch.nn.Module) -> None:
        self._module = module
        self._parts = [part for part in module.modules() if isinstance(part, Noisy)]

    def draw(self, rng: np.random.Generator) -> None:
        """New noise everywhere; takes nothing from ``rng`` if there is none."""
        for part in self._parts:
            try:
                part.draw_noise(rng)
            except BaseException as error:
                raise blamed(error, self._module, "draw_noise") from error
