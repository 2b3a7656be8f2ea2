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
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
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
    difference_loss,
    difference_targets,
    outputs,
    seeded,
)
from flipperctl.agent.replay import Batch, GroupBatch, Replay
from flipperctl.config import TrainConfig
from flipperctl.env.privileged import SIZE
from flipperctl.errors import NonFiniteError
from flipperctl.learners.pair import NetworkPair
from flipperctl.learners.settings import D3qnSettings, linear

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

    _errors: list[torch.Tensor]
    """Sizes of the temporal-difference errors of each step of the last update, (B,)."""
    baselines: Baselines | None = None
    curiosity: Curiosity | None = None

    def _build_auxiliary(
        self, inputs: int, privileged: int
    ) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
        # Curiosity is saved with the pair, but has a loss and an optimiser of its own.
        if self.settings.curiosity:
            self.curiosity = curiosity = Curiosity(
                inputs, self.actions, seed=self._seed, device=self.device
            )
            self._parts |= {
                "curiosity": curiosity.network,
                "curiosity_optimiser": curiosity.optimiser,
            }
        if not privileged:
            return []
        # The baseline shares the pair's loss, so that its weights join those of the online network.
        self._parts["baselines"] = self.baselines = Baselines(inputs, privileged).to(self.device)
        return [(self.baselines.online, self.baselines.target)]

    def update_from(
        self,
        replay: Replay,
        rng: np.random.Generator,
        fraction: float,
        valued: Callable[[int, np.random.Generator], Sequence[GroupBatch]] = lambda *_: (),
    ) -> float:
        """Take ``updates_together`` gradient steps from a replay; return the last loss [-].

        Priorities are set by the new errors. ``valued``: returns valued states for so many steps.
        """
        s, steps = self.settings, self.settings.updates_together
        size = steps * s.batch_size
        if not replay.prioritised:
            batch = replay.sample(size, rng)
            return self.update(batch, fraction, valued(steps, rng))
        # Risk and curiosity learn from transitions in their true frequencies.
        uniform = replay.sample(size, rng) if s.risk or s.curiosity else None
        rows, batch = replay.sample_by_priority(size, steps, rng, s.priority_correction)
        loss = self.update(batch, fraction, uniform=uniform)
        # The priority of an error δ is (|δ| + ε)^α (Schaul et al. 2016, Eq. 1).
        errors = torch.cat(self._errors).cpu().numpy()
        replay.set_priorities(rows, (errors + s.priority_floor) ** s.priority)
        return loss

    def update(
        self,
        batch: Batch,
        fraction: float,
        groups: Sequence[GroupBatch] = (),
        uniform: Batch | None = None,
    ) -> float:
        """Take gradient steps of ``batch_size`` transitions each; return the last loss [-].

        ``batch`` holds the transitions of one or more steps, whose targets are all computed before
        the first step. ``fraction``: completed part of the run, 0 to 1, which sets the learning
        rate and the weight of the labels. ``groups``: valued states for each step. ``uniform``: as
        many transitions of true frequencies for risk and curiosity; None: those of ``batch``.
        """
        with seeded(self.device, self._seed, self.optimiser.steps):  # equal in a resumed run
            return self._update(batch, fraction, groups, batch if uniform is None else uniform)

    def _update(
        self, batch: Batch, fraction: float, groups: Sequence[GroupBatch], uniform: Batch
    ) -> float:
        s, teacher = self.settings, self._teacher
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        batch, uniform = batch.to(self.device), uniform.to(self.device)
        self._errors = []
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

    def _difference_loss(self, batch: Batch, target: torch.Tensor) -> torch.Tensor:
        left, pull = target, None
        if self.baselines is not None:
            left, pull = self.baselines.without_present(target, batch)
        loss, errors = difference_loss(self.online, batch, left)
        self._errors.append(errors)
        return loss if pull is None else loss + pull

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
    # The transitions of all updates in a row are drawn at a time.
    drawn = settings.updates_together * settings.batch_size
    check_demand(
        config.network,
        config.perception,
        rows=min(settings.replay_size, decisions),
        drawn=drawn,
        batch=settings.batch_size,
        labels=outputs("turns", len(config.robot.joints)) if config.teacher.teaches else 0,
        privileged=SIZE if settings.privileged(config) else 0,
        risk=settings.risk,
    )
