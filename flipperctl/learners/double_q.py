"""The double dueling DQN: it learns from batches, whatever the environment.

How much an episode still returns depends mostly on ground that the robot does not perceive yet. For
the network that acts this is noise, larger than the differences between its actions. A baseline
therefore sees the privileged state during the training and learns that part, which is subtracted
from the targets of all actions alike. The greedy action does not depend on it, and policies do not
contain it. (Actors and critics with different inputs: Pinto et al. 2018, "Asymmetric actor critic";
baselines that depend on the input of a process: Mao et al. 2019.)
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import torch

from flipperctl.agent.contract import check_demand
from flipperctl.agent.curiosity import Curiosity
from flipperctl.agent.losses import (
    mean_value_penalty,
    searched_values,
    teacher_cross_entropy,
    teacher_large_margin,
)
from flipperctl.agent.networks import (
    difference_errors,
    difference_loss,
    difference_targets,
    seeded,
)
from flipperctl.agent.replay import Batch, GroupBatch
from flipperctl.api import ACTIONS
from flipperctl.config import TrainConfig
from flipperctl.env.privileged import SIZE
from flipperctl.errors import NonFiniteError
from flipperctl.learners.pair import NetworkPair
from flipperctl.learners.settings import D3qnSettings, linear

_PRIORITY: Final = 0.6
"""Exponent of an error in the probability that an update learns from it [-] (α of Schaul et al.
2016)."""
_CORRECTION: Final = 0.5
"""Exponent of that probability in the weight of the loss [-] (their β, constant): 1 would take all
of the preference back in the mean."""
_SMALLEST: Final = 0.02
"""Added to an error, so that none is never learnt from, in scaled rewards [-]."""
_LARGEST: Final = 1e9
"""In place of an error that is not finite: it is chosen, and then refused by its loss."""
PULL: Final = 0.01
"""Weight of the baseline's mean squared output in the loss [-]. What the observation tells then
becomes part of the acting network's values, whose mean would otherwise be arbitrary."""
_WIDTH: Final = 128


class Baseline(torch.nn.Module):
    """Maps an observation and the privileged state to a value for all actions."""

    def __init__(self, observation: int, privileged: int, width: int = _WIDTH) -> None:
        """``observation``, ``privileged``: lengths of the rows; ``width`` of the hidden layers."""
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(observation + privileged, width),
            torch.nn.ReLU(),
            torch.nn.Linear(width, width),
            torch.nn.ReLU(),
            torch.nn.Linear(width, 1),
        )

    def forward(self, observation: torch.Tensor, privileged: torch.Tensor) -> torch.Tensor:
        """Return the values, (B,), of rows (B, …)."""
        values: torch.Tensor = self.layers(torch.cat([observation, privileged], dim=1))
        return values.squeeze(1)


class Baselines(torch.nn.Module):
    """The baseline that learns, and its target, which follows it slowly."""

    def __init__(self, observation: int, privileged: int) -> None:
        """``observation``, ``privileged``: lengths of the rows."""
        super().__init__()
        self.online = Baseline(observation, privileged)
        self.target = copy.deepcopy(self.online).requires_grad_(False).eval()

    def with_next(self, targets: torch.Tensor, batch: Batch) -> torch.Tensor:
        """Return targets (B, …) of the acting network with the baseline of the next state."""
        assert batch.next_privileged is not None  # as every batch of such a training
        value = batch.discount * self.target(batch.next_observation, batch.next_privileged)
        return targets + _as_column(value, targets)

    def without_present(
        self, targets: torch.Tensor, batch: Batch
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the targets (B, …) without the baseline's part, and the loss of its pull to 0."""
        assert batch.privileged is not None  # as every batch of such a training
        value = self.online(batch.observation, batch.privileged)
        return targets - _as_column(value, targets), PULL * value.square().mean()


def _as_column(value: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Return values (B,) in a shape that broadcasts to targets (B,) or (B, K)."""
    return value if targets.ndim == 1 else value.unsqueeze(1)


class DoubleQ(NetworkPair):
    """A pair with the update from a batch of the replay."""

    settings: D3qnSettings

    baselines: Baselines | None = None
    curiosity: Curiosity | None = None

    def _build_auxiliary(
        self, inputs: int, privileged: int
    ) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
        # Curiosity is saved with the pair, but has a loss and an optimiser of its own.
        if self.settings.curiosity:
            self.curiosity = curiosity = Curiosity(inputs, seed=self._seed, device=self.device)
            self._parts |= {
                "curiosity": curiosity.network,
                "curiosity_optimiser": curiosity.optimiser,
            }
        if not privileged:
            return []
        # The baseline shares the pair's loss, so that its weights join those of the online network.
        self._parts["baselines"] = self.baselines = Baselines(inputs, privileged).to(self.device)
        return [(self.baselines.online, self.baselines.target)]

    @property
    def candidates(self) -> int:
        """Transitions drawn for each one that an update learns from [-]; 1 with a teacher."""
        return self.settings.candidates if self._teacher is None else 1

    def update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch] = ()) -> float:
        """Take gradient steps of ``batch_size`` transitions each; return the last loss [-].

        ``batch`` holds ``candidates`` times the transitions of one or more steps; their targets
        are all computed before the first step. ``fraction``: completed part of the run, 0 to 1,
        which sets the learning rate and the weight of the labels. ``groups``: valued states for
        each step.
        """
        with seeded(self.device, self._seed, self.optimiser.steps):  # equal in a resumed run
            return self._update(batch, fraction, groups)

    def _update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch]) -> float:
        s, teacher = self.settings, self._teacher
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        batch = batch.to(self.device)
        # New noise in both networks for the targets; each step below draws new noise for its loss.
        self._noise.draw(self.noise_rng)
        self._target_noise.draw(self.noise_rng)
        # The targets of all steps come from one pass, before the first step changes a weight.
        with torch.no_grad():
            reward = batch.reward * s.reward_scale
            if self.curiosity is not None:
                reward = reward + s.curiosity * self.curiosity.reward(batch)
            # With a teacher's labels alone (td_weight 0) nothing uses the value of the next state.
            chooser = self.online if s.double else self.target
            targets = (
                difference_targets(reward, batch, chooser, self.target)
                if teacher is None or teacher.td_weight or teacher.loss == "values"
                else reward
            )
            if self.baselines is not None:
                targets = self.baselines.with_next(targets, batch)
            # The risk and the curiosity learn from the uniform draw, whose frequencies are true.
            uniform = batch
            if self.candidates > 1:
                batch, targets = self._prioritised(batch, targets)
        # Dropout and batch statistics act in the loss, and nowhere else.
        self.online.train()
        value = 0.0
        for start in range(0, len(targets), s.batch_size):
            part = slice(start, start + s.batch_size)
            valued = groups[start // s.batch_size].to(self.device) if groups else None
            step = batch.rows(part)
            self._noise.draw(self.noise_rng)
            loss = self._loss(step, targets[part], fraction, valued)
            # A loss that is not finite must not reach the weights.
            if not math.isfinite(value := float(loss.detach())):
                raise NonFiniteError(
                    f"the learner's loss is {value}; the largest reward of the batch "
                    f"is {float(batch.reward.abs().max()):g}"
                )
            self._descend(loss, rate)
            # The risk and the curiosity have losses and optimisers of their own.
            if self.risk is not None:
                self.risk.step(uniform.rows(part), rate)
            if self.curiosity is not None:
                self.curiosity.step(uniform.rows(part), rate)
        # Back to the mode in which the policy drives and computes targets.
        self._noise.acts()
        return value

    def _prioritised(self, batch: Batch, targets: torch.Tensor) -> tuple[Batch, torch.Tensor]:
        """Choose the transitions to learn from, larger errors more often, and weight their losses.

        Prioritised replay (Schaul et al. 2016, "Prioritized experience replay") remembers each
        transition's last error. Here the errors of a random part of the replay are computed anew.
        """
        # Priorities follow the error of the acting network, without the baseline's part.
        left = targets
        if self.baselines is not None:
            left, _ = self.baselines.without_present(targets, batch)
        errors = difference_errors(self.online, batch, left).nan_to_num(_LARGEST, posinf=_LARGEST)
        # Drawn without replacement, with probabilities proportional to (|δ| + ε)^α.
        chances = (errors + _SMALLEST) ** _PRIORITY
        rows = torch.multinomial(chances, len(targets) // self.candidates)
        # Importance weights (N·p)^-β, of mean 1 so that the size of a step stays.
        weight = (chances.mean() / chances[rows]) ** _CORRECTION
        return replace(batch.rows(rows), weight=weight / weight.mean()), targets[rows]

    def _difference_loss(self, batch: Batch, target: torch.Tensor) -> torch.Tensor:
        if self.baselines is None:
            return difference_loss(self.online, batch, target)
        left, pull = self.baselines.without_present(target, batch)
        return difference_loss(self.online, batch, left) + pull

    def _loss(
        self, batch: Batch, target: torch.Tensor, fraction: float, groups: GroupBatch | None
    ) -> torch.Tensor:
        """Return the temporal-difference loss, plus the loss of what a teacher says."""
        teacher = self._teacher
        if teacher is None:
            return self._difference_loss(batch, target)
        weight = linear(teacher.weight, teacher.weight_end, fraction)
        # Searched values: states of a group are compared with each other, in scaled rewards.
        if teacher.loss == "values":
            td = self._difference_loss(batch, target)
            if groups is None:
                return teacher.td_weight * td
            values = self.online(groups.observation.flatten(0, 1))
            values = values.unflatten(0, groups.observation.shape[:2])
            scaled = groups.values * self.settings.reward_scale
            searched = searched_values(values, scaled, teacher.clip)
            return teacher.td_weight * td + weight * searched
        # Labels of actions: a margin (DQfD), or the cross-entropy of softmax(Q / temperature).
        assert batch.label is not None  # the replay of a run with a teacher has labels
        values = self.online(batch.observation)
        if teacher.loss == "margin":
            imitation = teacher_large_margin(values, batch.label, teacher.margin)
        else:
            imitation = teacher_cross_entropy(values, batch.label, teacher.q_temperature)
        loss = weight * imitation
        # Labels fix differences between actions alone; the penalty fixes the mean of the values.
        if not teacher.td_weight:
            return loss + mean_value_penalty(values)
        return teacher.td_weight * self._difference_loss(batch, target) + loss


def check_memory(settings: D3qnSettings, config: TrainConfig, decisions: int) -> None:
    """Check that the network, the replay of ``decisions`` and the batches fit into memory."""
    # Targets of all updates in a row, and candidates of which one is kept, are drawn at a time.
    drawn = settings.candidates * settings.updates_together * settings.batch_size
    check_demand(
        config.network,
        config.perception,
        len(ACTIONS),
        rows=min(settings.replay_size, decisions),
        drawn=drawn,
        batch=settings.batch_size,
        labels=len(ACTIONS) if config.teacher.teaches else 0,
        privileged=SIZE if settings.privileged(config) else 0,
        risk=settings.risk,
    )
