"""Random numbers inside networks: exploration noise (Fortunato et al. 2018), and torch's own.

Noise comes from the generators of the run. Layers of torch, such as its dropout, draw from torch's
global generator, which is seeded for each update and then given back as it was.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

import numpy as np
import torch

from flipperctl.agent.networks import naming_network


@runtime_checkable
class Noisy(Protocol):
    """A submodule with noise that acts in ``train()`` mode only."""

    def draw_noise(self, rng: np.random.Generator, /) -> None:
        """Draw new noise from ``rng``."""


class Noise:
    """All noisy submodules of a network; there may be none."""

    def __init__(self, module: torch.nn.Module) -> None:
        self._module = module
        self.parts = [part for part in module.modules() if isinstance(part, Noisy)]

    def draw(self, rng: np.random.Generator) -> None:
        """Draw new noise for every noisy submodule; without one, ``rng`` is not used."""
        for part in self.parts:
            with naming_network(self._module, "draw_noise"):
                part.draw_noise(rng)

    def acts(self) -> None:
        """Put the network into the mode of decisions and targets: ``eval()``, but with its noise.

        What ``train()`` mode does besides, such as dropping units, is for the loss alone.
        """
        self._module.eval()
        for part in self.parts:
            part.train()


@contextmanager
def seeded(device: torch.device, *key: int) -> Iterator[None]:
    """Let torch's global generators draw what ``key`` determines; restore them afterwards."""
    on = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=on):
        (seed,) = np.random.SeedSequence(key).generate_state(1, np.uint64).tolist()
        torch.default_generator.manual_seed(seed)
        if on:
            torch.cuda.manual_seed(seed)
        yield
