"""The policy gradient: it makes more probable what earned more than was expected.

In: whole episodes whose actions were drawn with known probabilities. Out: a better policy. The
policy is softmax(Q / temperature) of the same networks as those of the double DQN, so that its
greedy form is validated, exported and driven alike.

Clipped updates: Schulman et al. 2017, "Proximal policy optimization algorithms"; advantages:
Schulman et al. 2016, "Generalized advantage estimation"; values that see the true state: Pinto et
al. 2018, "Asymmetric actor critic".
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.d3qn import Baseline
from flipperctl.agent.frames import input_size
from flipperctl.agent.learner import Learner, part
from flipperctl.agent.losses import Adam, clipped_gain, descend, divergence, flatten_parameters
from flipperctl.agent.networks import naming_network, seeded
from flipperctl.agent.replay import Batch
from flipperctl.api import Network, ObservationLayout
from flipperctl.config import Agent
from flipperctl.config.agent import linear
from flipperctl.errors import NonFiniteError

_VALUE_RATE: Final = 1e-3
"""Adam step of the values [-]."""
_VALUE_PASSES: Final = 8
"""Passes over the decisions of each of the first rounds, in which the values alone learn [-]."""
_WIDTH: Final = 256
"""Width of the layers of the values."""


def advantages(
    differences: NDArray[np.float32], discounts: NDArray[np.float32], trace: float
) -> NDArray[np.float32]:
    """Return the generalised advantages of decisions in chronological order, (T,).

    ``differences``: temporal differences r + γ·V(s') - V(s), (T,); ``discounts``: γ, or 0 at the
    end of an episode, (T,); ``trace``: λ.
    """
    found, later = np.zeros_like(differences), 0.0
    for t in range(len(differences) - 1, -1, -1):
        later = float(differences[t]) + float(discounts[t]) * trace * later
        found[t] = later
    return found


def limited(advantage: torch.Tensor, clip: float | None) -> torch.Tensor:
    """Return advantages (T,) scaled to mean 0 and variance 1.

    None of those that are scaled a first time exceeds ``clip`` (None: unlimited) when they are
    scaled again: the few decisions before a failure have most of the variance else.
    """
    scaled = _scaled(advantage)
    return scaled if clip is None else _scaled(scaled.clamp(-clip, clip))


def _scaled(advantage: torch.Tensor) -> torch.Tensor:
    return (advantage - advantage.mean()) / (advantage.std(unbiased=False) + 1e-8)


def build_values(inputs: int, privileged: int) -> Baseline:
    """Return the values of input rows with ``privileged`` numbers that only they see."""
    return Baseline(inputs, privileged, _WIDTH)


class PolicyGradient(Learner):
    """A learner with the update from the episodes that its own policy drove."""

    def __init__(
        self, network: Network, layout: ObservationLayout, settings: Agent, **further: Any
    ) -> None:
        """See ``Learner``; only the values see the privileged states."""
        super().__init__(network, layout, settings, **further)
        with torch.random.fork_rng():
            torch.manual_seed(self._seed)
            values = build_values(input_size(network, layout), further["privileged"])
        self.values = values.to(self.device)
        self._value_parameters = list(self.values.parameters())
        self._value_optimiser = Adam(flatten_parameters(self._value_parameters))
        self.anchor = copy.deepcopy(self.online).requires_grad_(False)
        """The policy that the training started with."""
        self.rounds = 0
        """Number of updates."""
        self.learnt = 0
        """Number of transitions of the run that it has learnt from."""
        self._parts |= {"values": self.values, "anchor": self.anchor}
        self._parts["value_optimiser"] = self._value_optimiser

    def update(self, batch: Batch, fraction: float, rng: np.random.Generator) -> float:
        """Improve the policy and its values by the transitions of whole episodes, in their order.

        The labels of ``batch`` are the probabilities by which its actions were drawn. ``fraction``:
        completed part of the run, 0 to 1, which sets the learning rate and the temperature;
        ``rng`` shuffles. Returns the mean squared error of the values in the last step [-].
        """
        random = seeded(self.device, self._seed, self.rounds)
        with naming_network(self.online, "forward"), random:  # only its own code can fail here
            self.online.eval()
            return self._update(batch.to(self.device), fraction, rng)

    def _update(self, batch: Batch, fraction: float, rng: np.random.Generator) -> float:
        s, g = self.settings, self.settings.policy_gradient
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        temperature = g.temperature_at(fraction)
        advantage, goal = self._advantages(batch)
        warm, moves = self.rounds < g.warm_up, True
        error = 0.0
        for _ in range(_VALUE_PASSES if warm else g.passes):
            order = torch.from_numpy(rng.permutation(len(goal))).to(self.device)
            for rows in torch.split(order, s.batch_size):
                step = batch.rows(rows)
                error = self._value_step(step, goal[rows])
                if self.risk is not None:
                    self.risk.step(step, rate)
                if moves and not warm:
                    moved = self._policy_step(step, advantage[rows], temperature, rate)
                    moves = moved <= g.divergence
        self.rounds += 1
        return error

    def _advantages(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the advantages, scaled and limited, and the values to learn, (T,)."""
        assert batch.privileged is not None  # as in every batch of such a training
        assert batch.next_privileged is not None
        with torch.no_grad():
            value = self.values(batch.observation, batch.privileged)
            after = self.values(batch.next_observation, batch.next_privileged)
            reward = batch.reward * self.settings.reward_scale
            difference = reward + batch.discount * after - value
        found = torch.from_numpy(
            advantages(
                difference.cpu().numpy(),
                batch.discount.cpu().numpy(),
                self.settings.policy_gradient.trace,
            )
        ).to(self.device)
        return limited(found, self.settings.policy_gradient.advantage_clip), found + value

    def _value_step(self, batch: Batch, goal: torch.Tensor) -> float:
        assert batch.privileged is not None
        loss = (self.values(batch.observation, batch.privileged) - goal).square().mean()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise NonFiniteError(
                f"the loss of the values is {value}; the largest reward of the batch is "
                f"{float(batch.reward.abs().max()):g}"
            )
        descend(loss, self._value_parameters, self._value_optimiser, 1.0, _VALUE_RATE)
        return value

    def _policy_step(
        self, batch: Batch, advantage: torch.Tensor, temperature: float, rate: float
    ) -> float:
        """Take a step of the policy; return its divergence from what drove, before the step."""
        g = self.settings.policy_gradient
        assert batch.label is not None  # the probabilities of the draws
        logits = torch.log_softmax(self.online(batch.observation) / temperature, dim=1)
        gain = clipped_gain(logits, batch.action, batch.label, advantage, g.clip)
        loss = -gain
        if g.anchor:
            with torch.no_grad():
                kept = torch.softmax(self.anchor.eval()(batch.observation) / temperature, dim=1)
            loss = loss + g.anchor * divergence(kept, logits)
        if not math.isfinite(value := float(loss.detach())):
            raise NonFiniteError(f"the loss of the policy is {value}")
        moved = float(divergence(batch.label, logits.detach()))
        self._descend(loss, rate)
        return moved

    @property
    def starting(self) -> tuple[torch.nn.Module, ...]:
        """The networks that begin with the weights of the training's start."""
        return *super().starting, self.anchor

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the learner's state: its networks, the optimisers' moments and counters."""
        counts = [self.rounds, self.learnt, self.optimiser.steps, self._value_optimiser.steps]
        counts.append(0 if self.risk is None else self.risk.optimiser.steps)
        return super().tensors() | {"counts.all": torch.tensor(counts, dtype=torch.int64)}

    def restore(self, tensors: Mapping[str, torch.Tensor], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned; they hold all numbers of steps."""
        self.rounds, self.learnt, *taken = part(tensors, "counts")["all"].tolist()
        super().restore(tensors, taken[0])
        self._value_optimiser.steps = taken[1]
        if self.risk is not None:
            self.risk.optimiser.steps = taken[2]
