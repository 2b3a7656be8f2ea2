"""The double dueling DQN: it learns from batches, whatever the environment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch

from flipperctl.agent.baseline import Baselines
from flipperctl.agent.descent import part
from flipperctl.agent.learner import Learner
from flipperctl.agent.losses import (
    mean_value_penalty,
    searched_values,
    teacher_cross_entropy,
    teacher_large_margin,
)
from flipperctl.agent.networks import difference_loss, difference_targets, naming_network
from flipperctl.agent.noise import seeded
from flipperctl.agent.replay import Batch, GroupBatch
from flipperctl.config.agent import linear
from flipperctl.errors import NonFiniteError


class D3qn(Learner):
    """A learner with the update from a batch of the replay."""

    baselines: Baselines | None = None

    def _build_beside(
        self, inputs: int, privileged: int
    ) -> list[tuple[torch.nn.Module, torch.nn.Module]]:
        if not privileged:
            return []
        self.baselines = Baselines(inputs, privileged).to(self.device)
        return [(self.baselines.online, self.baselines.target)]

    def update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch] = ()) -> float:
        """Take gradient steps of ``batch_size`` transitions each; return the last loss [-].

        ``batch`` holds the transitions of one or more steps; their targets are all computed before
        the first step. ``fraction``: completed part of the run, 0 to 1, which sets the learning
        rate and the weight of the labels. ``groups``: valued states for each step.
        """
        count = self.optimiser.steps  # equal in a resumed run
        random = seeded(self.device, self._seed, count)
        with naming_network(self.online, "forward"), random:  # only its own code can fail here
            return self._update(batch, fraction, groups)

    def _update(self, batch: Batch, fraction: float, groups: Sequence[GroupBatch]) -> float:
        s, teacher = self.settings, self._teacher
        rate = linear(s.learning_rate, s.learning_rate_end, fraction)
        batch = batch.to(self.device)
        self._noise.draw(self.noise_rng)
        self._target_noise.draw(self.noise_rng)
        with torch.no_grad():
            reward = batch.reward * s.reward_scale
            targets = (
                difference_targets(reward, batch, self.online, self.target)
                if teacher is None or teacher.td_weight or teacher.loss == "values"
                else reward
            )
            if self.baselines is not None:
                targets = self.baselines.with_next(targets, batch)
        self.online.train()
        value = 0.0
        for start in range(0, len(targets), s.batch_size):
            part = slice(start, start + s.batch_size)
            valued = groups[start // s.batch_size].to(self.device) if groups else None
            step = batch.rows(part)
            self._noise.draw(self.noise_rng)
            loss = self._loss(step, targets[part], fraction, valued)
            if not math.isfinite(value := float(loss.detach())):
                raise NonFiniteError(
                    f"the learner's loss is {value}; the largest reward of the batch "
                    f"is {float(batch.reward.abs().max()):g}"
                )
            self._descend(loss, rate)
            if self.risk is not None:
                self.risk.step(step, rate)
        self._noise.acts()
        return value

    def _difference_loss(self, batch: Batch, target: torch.Tensor) -> torch.Tensor:
        """Return the loss of the temporal difference."""
        if self.baselines is None:
            return difference_loss(self.online, batch, target)
        left, pull = self.baselines.without_present(target, batch)
        return difference_loss(self.online, batch, left) + pull

    def _loss(
        self, batch: Batch, target: torch.Tensor, fraction: float, groups: GroupBatch | None
    ) -> torch.Tensor:
        """Return the temporal-difference loss, plus the loss of what a teacher says."""
        s = self._teacher
        if s is None:
            return self._difference_loss(batch, target)
        if s.loss == "values":
            td = self._difference_loss(batch, target)
            if groups is None:
                return s.td_weight * td
            scale = self.settings.reward_scale
            found = self.online(groups.observation.flatten(0, 1)).unflatten(
                0, groups.observation.shape[:2]
            )
            searched = searched_values(found, groups.values * scale, s.clip)
            return s.td_weight * td + linear(s.weight, s.weight_end, fraction) * searched
        assert batch.label is not None  # the replay of a run with a teacher has labels
        values = self.online(batch.observation)
        if s.loss == "margin":
            imitation = teacher_large_margin(values, batch.label, s.margin)
        else:
            imitation = teacher_cross_entropy(values, batch.label, s.q_temperature)
        loss = linear(s.weight, s.weight_end, fraction) * imitation
        if not s.td_weight:
            return loss + mean_value_penalty(values)
        return s.td_weight * self._difference_loss(batch, target) + loss

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the learner's state: its networks and the optimisers' moments."""
        if self.baselines is None:
            return super().tensors()
        further = self.baselines.state_dict().items()
        return super().tensors() | {f"baselines.{name}": tensor for name, tensor in further}

    def restore(self, tensors: Mapping[str, torch.Tensor], steps: int) -> None:
        """Restore the tensors that ``tensors`` returned after ``steps`` gradient steps."""
        super().restore(tensors, steps)
        if self.baselines is not None:
            self.baselines.load_state_dict(part(tensors, "baselines"))
