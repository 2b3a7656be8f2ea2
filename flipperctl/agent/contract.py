"""Checks of a network before its training: what its Q-values depend on, and the memory it needs.

Q-values depend on the input and the weights alone, not on earlier inputs, other rows of a batch, or
random numbers that a resumed run could not repeat.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch

from flipperctl.agent.frames import input_size
from flipperctl.agent.networks import (
    Distributional,
    Noise,
    build_policy,
    describe_fault,
    seeded,
)
from flipperctl.agent.replay import require, row_bytes
from flipperctl.api import Network, ObservationLayout
from flipperctl.errors import ConfigError
from flipperctl.plugging.guard import naming
from flipperctl.plugging.randomness import global_states, moved_since


def check_demand(
    network: Network,
    layout: ObservationLayout,
    *,
    rows: int,
    drawn: int,
    batch: int,
    labels: int = 0,
    privileged: int = 0,
    risk: bool = False,
) -> None:
    """Check the network, and that the replay and the batches of a training fit into memory.

    ``rows``: transitions that the replay will hold. ``drawn``: transitions drawn from it at a time;
    each update takes ``batch`` of them. ``labels`` and ``privileged``: lengths of a transition's
    label and privileged state. ``risk``: whether a risk is learnt.
    """
    with torch.random.fork_rng(devices=[]):
        build_policy(network, layout)
    inputs = input_size(network, layout)
    size = row_bytes(inputs, labels, privileged, risk=risk)
    require(
        rows * size,
        f"agent.replay_size: {rows:,} transitions of {inputs} numbers each take",
        "lower it, or use fewer bins or frames",
    )
    require(
        drawn * size,
        f"agent.batch_size: {drawn // batch} times {batch:,} transitions, which are drawn at a "
        "time, take",
        "lower it, or the settings that multiply it",
    )


_ALONE = 1e-3
"""Tolerance of Q-values whose sums are in another order, relative and absolute [-]."""
_CPU = torch.device("cpu")

Values = tuple[torch.Tensor, ...]
"""Q-values (B, 9) of a batch, and its quantiles (B, 9, K) if the network has some."""


def observations(network: Network, layout: ObservationLayout, rows: int) -> torch.Tensor:
    """Return random numbers of the magnitude of observations, (rows, frames · n)."""
    scale = torch.tensor(np.tile(layout.scale, network.frames), dtype=torch.float32)
    generator = torch.Generator().manual_seed(0)
    return torch.randn(rows, len(scale), generator=generator) * scale


@torch.no_grad()
def check_contract(network: Network, layout: ObservationLayout) -> None:
    """Build a network and check it."""
    with torch.random.fork_rng(devices=[]):
        module = build_policy(network, layout)
    # One observation and three others, of the magnitude of real ones.
    rows = observations(network, layout, 4)
    first, others = rows[:1], [rows[at : at + 1] for at in range(1, len(rows))]
    trial, noise = _Trial(network, module), Noise(module)
    # The modes of decisions: without noise, and with it if the network has some.
    modes: list[tuple[str, Callable[[], object]]] = [("in eval mode", module.eval)]
    if noise.parts:
        trial.require_noise_from_rng(noise, first)
        modes.append(("in decisions with noise", noise.acts))
    for use, begin in modes:
        begin()
        for other in others:  # of one alone, a mean over the batch may be equal by chance
            trial.require_nothing_kept(use, first, other)
    module.train()
    with torch.enable_grad():  # as the loss does
        trial.require_seeded(torch.cat([first, others[0]]), torch.cat(others))


class _Trial:
    """Calls a network and refuses what it must not do."""

    def __init__(self, network: Network, module: torch.nn.Module) -> None:
        self._network, self._module = network, module

    def _call(self, rows: torch.Tensor) -> Values:
        inputs = rows.clone()
        with naming(self._network, "forward", ConfigError):
            outputs = [self._module(inputs)]
            if isinstance(self._module, Distributional):
                outputs.append(self._module.quantiles(inputs))
        if not torch.equal(inputs, rows):
            raise self._refusal("changes its input in place; a copy of it may be changed")
        return tuple(tensor.detach().clone() for tensor in outputs)

    def require_noise_from_rng(self, noise: Noise, first: torch.Tensor) -> None:
        """Refuse noise that is drawn from another generator than the one that is given."""
        before, changes = global_states(), []
        self._module.train()
        # Equal generators must give equal noise, with other noise between them.
        for seed in (0, 1, 0):
            noise.draw(np.random.default_rng(seed))
            with torch.enable_grad(), seeded(_CPU, 0):
                changes.append(self._call(first))
        if (moved := moved_since(before)) or not _equal(changes[0], changes[2]):
            text = f"uses {moved}" if moved else "draws unequal noise from equal generators"
            raise self._refusal(f"{text}; only rng is allowed", "draw_noise")

    def require_nothing_kept(self, use: str, row: torch.Tensor, other: torch.Tensor) -> None:
        """Refuse decisions that depend on chance, on earlier ones or on others of the batch."""
        before, buffers = global_states(), _clones(self._module)
        # The same observation before and after another one.
        first, second, again = self._call(row), self._call(other), self._call(row)
        if moved := moved_since(before):
            raise self._refusal(
                f"uses {moved} {use}, so that equal observations give unequal Q-values; random "
                "numbers are allowed in the loss, where train() mode and gradients are on"
            )
        for name, tensor in self._module.state_dict().items():
            if not _same(buffers[name], tensor):
                raise self._refusal(f"changes its buffer {name!r} {use}; it must stay as it is")
        if not _equal(first, again):
            raise self._refusal(
                f"gives unequal Q-values for equal observations {use}; it must remember nothing of "
                "earlier calls, and draw no random numbers"
            )
        # Alone and in a batch, up to the rounding of sums in another order.
        together = self._call(torch.cat([row, other]))
        alone = tuple(torch.cat(pair) for pair in zip(first, second, strict=True))
        if not all(map(partial(torch.allclose, rtol=_ALONE, atol=_ALONE), together, alone)):
            raise self._refusal(
                f"gives an observation other Q-values alone than in a batch {use}; a mean over the "
                "batch, such as .mean() without dim=1, mixes them"
            )

    def require_seeded(self, batch: torch.Tensor, other: torch.Tensor) -> None:
        """Refuse a loss that depends on more than the batch and torch's own generator."""
        state, before = _clones(self._module), global_states()
        outputs = []
        # The same batch before and after another one, from equal weights and generators.
        for rows in (batch, other, batch):
            with torch.no_grad():
                self._module.load_state_dict(state)  # statistics may follow the batches
            with seeded(_CPU, 0):
                outputs.append(self._call(rows))
        if moved := moved_since(before):
            raise self._refusal(f"uses {moved} in train() mode; only torch's generator is allowed")
        if not _equal(outputs[0], outputs[2]):
            raise self._refusal(
                "gives unequal Q-values for equal observations in train() mode, though torch's "
                "generator is in equal states; other random numbers, and memory of earlier calls, "
                "are not allowed"
            )

    def _refusal(self, text: str, method: str = "forward") -> ConfigError:
        return ConfigError(describe_fault(self._module, method, text))


def _clones(module: torch.nn.Module) -> dict[str, torch.Tensor]:
    return {name: tensor.detach().clone() for name, tensor in module.state_dict().items()}


def _equal(first: Values, second: Values) -> bool:
    return all(map(_same, first, second))


def _same(first: torch.Tensor, second: torch.Tensor) -> bool:
    """Return whether two tensors are equal; NaN equals NaN."""
    return first.shape == second.shape and bool(
        ((first == second) | ((first != first) & (second != second))).all()
    )
